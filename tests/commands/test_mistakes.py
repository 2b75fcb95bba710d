"""Every command bare and with typical mistakes: one line that a person understands, exit code 2, nothing written."""

from pathlib import Path

import pytest

from cloak_core.cli import COMMANDS
from tools.mistakes import READS, RUNS_BARE, mistakes

LEAKED = ("{None}", "INT", "FLOAT", "NoneType", "literal", "instantiated", "argument", "Traceback", "Error", "[Errno")
LONGEST = 500


def test_every_command_is_among_them() -> None:
    assert READS.keys() == COMMANDS.keys() and set(RUNS_BARE) < COMMANDS.keys()


@pytest.mark.long
@pytest.mark.parametrize("name", COMMANDS)
def test_each_mistake_gets_one_line_and_exit_code_2(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes.txt").write_text("Not what was asked for.\n")
    made = mistakes(name)
    assert len(made) >= 5 + (name not in RUNS_BARE)
    for mistake in made:
        assert mistake.code == 2 and mistake.said.startswith("cloak: "), mistake
        assert mistake.kind != "bare" or f"usage: cloak {name}" in mistake.said, mistake
        assert len(mistake.said.splitlines()) == 1 and len(mistake.said) <= LONGEST, mistake
        assert not any(word in mistake.said for word in LEAKED), mistake
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"], "something was written"
