"""The tutorial, from start to end, exactly as printed."""

import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from tests.docs.blocks import FENCED, ROOT, lines, words

PAGE = ROOT / "docs" / "tutorial.md"
FIGURE = re.compile(r"\d+(?:\.\d+)?")


def shown_after(line: str) -> str | None:
    """What the page says a command printed: the box of text right behind its own."""
    boxes = [(m[1], m[2].strip(), m.end(), m.start()) for m in FENCED.finditer(PAGE.read_text("utf-8"))]
    for (kind, text, end, _), (next_kind, printed, _, start) in pairwise(boxes):
        if kind == "sh" and text == line and next_kind == "text" and start - end < 3:
            return printed
    return None


@pytest.mark.long
def test_the_tutorial_runs_exactly_as_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the page shows of their output is what they print, figures aside."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    compared = 0
    for line in lines(PAGE):
        program, *options = words(line)
        assert program == "cloak", f"{line}: what a reader types here is not tested"
        command = [sys.executable, "-m", "cloak_core", *options]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, line + "\n" + done.stderr
        if printed := shown_after(line):
            assert FIGURE.sub("0", printed) == FIGURE.sub("0", done.stdout.strip()), line
            compared += 1
    assert compared, "the page shows no output any more"
    assert list((tmp_path / "mine" / "previews").glob("*.png"))
    assert (tmp_path / "mine" / "report.html").stat().st_size > 10_000
    assert (tmp_path / "cloak.glb").read_bytes()[:4] == b"glTF"
