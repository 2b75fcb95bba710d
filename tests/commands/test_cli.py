"""The command line's manners: exit codes, one line for bad input, JSON alone on standard output."""

import contextlib
import io
import json
import re
import shlex
import subprocess
import sys
from functools import cache

import numpy as np
import pytest

from cloak_core import cli
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.scenes import write_scene


def cloak(*arguments: object, **options: object) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "cloak_core", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, **options)


@pytest.fixture
def bad(capsys):
    """Return the one line with which bad input is refused; test_streams.py sees a process end so."""

    def refused(*arguments: object) -> str:
        with pytest.raises(SystemExit) as end:
            cli.main([*map(str, arguments)])
        said = capsys.readouterr()
        assert end.value.code == 2, said.err
        lines = said.err.strip().splitlines()
        assert len(lines) == 1 and lines[0].startswith("cloak: ") and not said.out
        return lines[0]

    return refused


@pytest.fixture
def scene(tmp_path):
    vertices = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]], np.float32)
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    return write_scene(tmp_path / "scene", Bodies(vertices=vertices, triangles=triangles, name="tetrahedron"))


@pytest.mark.slow
def test_json_alone_on_standard_output(scene):
    done = cloak("scene", "info", scene, "--json")
    assert done.returncode == 0
    record = json.loads(done.stdout)
    assert (record["poses"], record["vertices"], record["triangles"], record["faces"]) == (1, 4, 4, 4)
    assert len(record["topology"]) == 64


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nonsense",), "unknown command 'nonsense'"),
        (("scene", "nonsense"), "unknown command 'scene nonsense'"),
        (("scene", "info"), "scene info: .*scene"),
        (("scene", "info", "x", "--nonsense"), "--nonsense"),
        (("scene", "info", "absent"), "absent: no such scene"),
        (("scene", "import", "absent.obj", "--out", "x"), "absent.obj"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(arguments, words, bad):
    assert re.search(words, bad(*arguments))


DO_SOMETHING_BARE = {
    "demo", "version", "zoo list", "zoo reproduce", "detectors list", "bench growth", "bench stability", "bench step",
    "bench detectors", "bench gpu", "setup",
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(cli.COMMANDS) - DO_SOMETHING_BARE))
def test_the_bare_form_of_a_command_says_what_it_needs(name, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(name.split())
    said = capsys.readouterr()
    assert end.value.code == 2 and not said.out and len(said.err.splitlines()) == 1
    assert f"usage: cloak {name}" in said.err and f"(cloak {name} --help)" in said.err


@pytest.mark.parametrize("words", ["", "scene", "logo", "export", "zoo", "detectors", "bench"])
def test_the_bare_form_of_a_group_lists_its_commands(words, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(words.split())
    assert end.value.code == 2 and "usage: cloak COMMAND" in capsys.readouterr().out


@pytest.mark.slow
def test_a_part_of_what_is_needed(capsys):
    for line, needs in (
        ("train --scene sample", "needs --logo, --out"),
        ("print --out x", "needs RUN_FOLDER"),
        ("train --scen x", "unknown option --scen; did you mean --scene?"),
        ("logo transfer --to x", "needs --from, --logo, --out"),
        ("detectors check --detector x", "unknown: --detector; needs SPEC"),
    ):
        with pytest.raises(SystemExit):
            cli.main(line.split())
        assert needs in capsys.readouterr().err


def test_nothing_is_overwritten(scene, bad):
    assert "exists already" in bad("scene", "sample", "--out", scene)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(cli.COMMANDS))
def test_every_command_has_help_json_and_an_example_that_is_a_command(name):
    text = help_text(name, "--help", 80)
    assert "--json" in text and (cli.load(name).__doc__ or "").strip().splitlines()[0][:30] in text
    assert not re.search(r"\(default[^)]*\)\.? \(default", " ".join(text.split()))
    example = re.search(r"Example:\n((?:.*\\\n)*.*)\n", text)[1]
    words = cli.find(shlex.split(example.replace("\\\n", " "))[1:])
    assert words[0] == name and cli.parse(*words)
    if name in ("train", "evaluate", "reproduce", "demo", "sweep", "detectors check", "logo heatmap"):
        shown = {flag.split()[0] for flags in help_of(name).values() for flag in flags}
        assert {"--threads", "--device"} <= shown, "it computes"
        assert "--seed" in shown or name == "logo heatmap"  # which draws nothing


@pytest.mark.slow
def test_help_of_training_is_short():
    text = help_text("train", "--help", 80)
    assert sum(line.startswith("  --") for line in text.splitlines()) == 22 and "--help-all" in text


@pytest.mark.slow
def test_help_names_every_command():
    done = cloak("--help")
    assert done.returncode == 0
    assert all(f"cloak {name}" in done.stdout for name in cli.COMMANDS)
    assert all(f"\n{group}:\n" in done.stdout for group in cli.GROUPS)


def flags_of(text: str) -> dict[str, list[str]]:
    """The options that a help shows, by the heading they stand under."""
    found: dict[str, list[str]] = {}
    for line in text.splitlines():
        if line.startswith("  --"):
            found[next(reversed(found))].append(line.strip().split("  ")[0])
        elif heading := re.match(r"(\w[\w ]*):( |$)", line):
            found[heading[1]] = []
    return {heading: flags for heading, flags in found.items() if flags}


def help_of(name: str) -> dict[str, list[str]]:
    return flags_of(help_text(name, "--help-all", 120))


@cache
def help_text(name: str, option: str, columns: int) -> str:
    """What a command's help says; once a process, for it takes half a second."""
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patched, contextlib.redirect_stdout(said), pytest.raises(SystemExit) as end:
        patched.setenv("COLUMNS", str(columns))
        cli.parse(name, [option])
    assert end.value.code == 0
    return said.getvalue()


@pytest.mark.slow
def test_help_has_headings_and_choices():
    shown = help_of("train")
    assert [*shown][:3] == ["Options", "Detectors", "The run"] and [*shown][-1] == "Computing"
    assert "--preset {paper,reference,best,transfer,photographs}" in shown["Options"]
    assert {"--outfits {random,first}", "--samples {1,4,16,64}", "--distance LOW:HIGH"} <= set(shown["Views"])
    assert {"--optimizer {sgd,adam,mi}", "--lr X"} <= set(shown["Optimiser"])
    assert list(help_of("evaluate")) == ["Options", "Detectors", "Evaluation", "Computing"]


@pytest.mark.slow
def test_help_does_not_wait_for_torch():
    code = """
import sys
from cloak_core import cli

for words in (["--help"], *([name, "--help"] for name in ("train", "evaluate", "reproduce", "sweep", "demo"))):
    try:
        cli.main(words)
    except SystemExit:
        print("torch" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert [line for line in done.stdout.splitlines() if line in ("True", "False")] == ["False"] * 6, done.stderr


def test_a_defect_keeps_its_traceback(monkeypatch, scene):
    def broken(_):
        raise RuntimeError("a defect")

    monkeypatch.setattr("cloak_core.commands.scene.describe", broken)
    with pytest.raises(RuntimeError, match="a defect"):
        cli.main(["scene", "info", str(scene)])
