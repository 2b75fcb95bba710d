"""The command line's manners: exit codes, one line for bad input, JSON alone on standard output."""

import re
import shlex
import subprocess
import sys

import numpy as np
import pytest

from cloak_core import cli
from cloak_core.commands.help import options_of
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.scenes import write_scene


@pytest.fixture
def scene(tmp_path):
    vertices = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]], np.float32)
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    return write_scene(tmp_path / "scene", Bodies(vertices=vertices, triangles=triangles, name="tetrahedron"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "line", ["zoo list", "scene sample --out there", "logo select --scene sample --region chest --out it.npy"]
)
def test_what_needs_no_torch_starts_without_it(tmp_path, line):
    """torch takes two seconds to load."""
    script = "import sys\nfrom cloak_core.cli import main\ntry:\n    main(sys.argv[1:])\nexcept SystemExit as end:\n"
    script += "    assert not end.code and 'torch' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", script, *line.split()], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_part_of_what_is_needed(cloak):
    for line, needs in (
        ("train --scene sample", "needs --logo, --out"),
        ("print --out x", "needs RUN_FOLDER"),
        ("train --scen x", "unknown option --scen; did you mean --scene?"),
        ("logo transfer --to x", "needs --from, --logo, --out"),
        ("detectors check --detector x", "unknown: --detector; needs SPEC"),
    ):
        assert needs in cloak(*line.split())[2]


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(cli.COMMANDS))
def test_every_command_has_help_json_and_an_example_that_is_a_command(name, capsys, monkeypatch):
    text = help_text(name, capsys, monkeypatch)
    assert "--json" in text and (cli.load(name).__doc__ or "").strip().splitlines()[0][:30] in text
    assert not re.search(r"\(default[^)]*\)\.? \(default", " ".join(text.split()))
    told = f"{text} {cli.load(name).then} {cli.load(name).next_why}"
    assert not re.search(r"\b(tools|tests|examples|benchmarks)/", told), "no wheel has these"
    assert "docs/" not in f"{cli.load(name).next_why}"
    example = re.search(r"Example:\n((?:.*\\\n)*.*)\n", text)[1]
    words = cli.find(shlex.split(example.replace("\\\n", " "))[1:])
    assert words[0] == name and cli.parse(*words)
    if name in ("train", "evaluate", "reproduce", "demo", "sweep", "detectors check", "logo heatmap"):
        assert "--threads" in text and "--device" in text, "it computes"
        assert "--seed" in text or name == "logo heatmap"  # which draws nothing


def help_text(name, capsys, monkeypatch, option="--help-all"):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        cli.parse(name, [option])
    return capsys.readouterr().out


def test_help_is_short_and_says_what_options_share_in_one_wording():
    """Each text is counted once: under 4,000 words for all commands."""
    options = [option for name in cli.COMMANDS for option in options_of(cli.load(name))]
    texts = {option.words for option in options}
    texts |= {cli.load(name).__doc__ for name in cli.COMMANDS}
    assert 3000 < sum(len(text.split()) for text in texts) < 4000
    assert len(options_of(cli.load("train"))) <= 72
    wordings = {f: {o.words for o in options if o.flag == f} for f in {o.flag for o in options}}
    for flag in ("--people", "--scene", "--seed", "--device", "--threads", "--shift", "--hide", "--threshold"):
        assert len(wordings[flag]) == 1, wordings[flag]
    assert len({o.words.removesuffix(" Repeatable.") for o in options if o.words.startswith("Detector: ")}) == 1


def test_a_defect_keeps_its_traceback(monkeypatch, scene):
    def broken(_):
        raise RuntimeError("a defect")

    monkeypatch.setattr("cloak_core.commands.scene.describe", broken)
    with pytest.raises(RuntimeError, match="a defect"):
        cli.main(["scene", "info", str(scene)])
