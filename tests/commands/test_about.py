"""Version, help and completion; what a typing error of a command or an option gets."""

import json
import shutil
import subprocess

import pytest

from cloak_core import __version__, cli
from cloak_core.commands.about import Completion
from tests.commands.test_mistakes import LEAKED


def test_version_says_what_it_is_made_of(cloak) -> None:
    code, out, _ = cloak("version")
    assert code == 0 and out.startswith(f"cloak {__version__}\n") and "torch " in out
    record = json.loads(cloak("version", "--json")[1])
    assert record["version"] == __version__ and {"python", "system", "torch", "numba"} <= set(record)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("trian", "unknown command 'trian'; did you mean train?"),
        ("train --stpes 3 --logo chest --out x", "train: unknown option --stpes; did you mean --steps? (cloak train"),
        ("train --tv_wieght=3 --logo chest --out x", "unknown option --tv-wieght; did you mean --tv-weight?"),
        ("train --tensorboard --logo chest --out x", "train: this version has no --tensorboard; use --log tensorboard"),
        ("train --zzzz --logo chest --out x", "train: unknown option --zzzz (cloak train --help)"),
        ("train --steps abc --logo chest --out x", "train: --steps: 'abc' is not a whole number (cloak train --help)"),
        ("train --seed None --logo chest --out x", "--seed: 'None' is not a whole number"),
        ("train --lr x --logo chest --out x", "--lr: 'x' is not a number"),
        ("evaluate runs --size 64", "evaluate: --shift: 50 px would move the body out of 64 px images"),
        ("evaluate net.onnx", "net.onnx: a detector, not a run folder: name the run, and --detector net.onnx"),
        ("harden net.onnx --out x", "net.onnx"),
    ],
)  # fmt: skip
def test_typing_errors_get_one_line_that_helps(line, words, cloak, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = cloak(*line.split())
    assert code == 2 and not out and len(err.splitlines()) == 1 and words in err
    assert not any(leaked in err for leaked in LEAKED)


@pytest.fixture(scope="module")
def bash() -> str:
    return Completion(shell="bash").run()["script"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("tr", {"train", "transfer"}),
        ("scene im", {"import", "import-smpl", "import-anny"}),
        ("train --st", {"--steps"}),
        ("zoo list --js", {"--json"}),
        ("wear x --detec", {"--detector"}),
    ],
)
def test_bash_completes_commands_and_options(typed, offered, bash, tmp_path) -> None:
    (tmp_path / "cloak.bash").write_text(bash)
    words = ["cloak", *typed.split()]
    lines = f"COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}; _cloak; echo ${{COMPREPLY[@]}}"
    done = subprocess.run(
        [shutil.which("bash"), "-c", f"source {tmp_path / 'cloak.bash'}; {lines}"], capture_output=True, text=True
    )
    assert set(done.stdout.split()) == offered, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_every_command_and_option_is_completed(shell, cloak) -> None:
    script = cloak("completion", shell)[1]
    for name in cli.COMMANDS:
        assert all(word in script for word in name.split())
    assert ("-l black-box-queries " in script) if shell == "fish" else ("--black-box-queries " in script)
    if shutil.which(shell):
        subprocess.run([shutil.which(shell), "-n"], input=script, text=True, check=True)
