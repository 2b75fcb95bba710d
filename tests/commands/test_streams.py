"""Standard output and error that are full, closed, or lack characters: one line at most, and a fitting exit code."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cloak_core import __version__, cli

ASCII = {"PYTHONIOENCODING": "ascii", "LC_ALL": "C", "PYTHONUTF8": "0"}


def cloak(line: str, **options: object) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "cloak_core", *line.split()]
    return subprocess.run(command, stderr=subprocess.PIPE, check=False, cwd=Path(__file__).parents[2], **options)


@pytest.mark.parametrize("line", ["--version", "scene info sample:train[0:1] --json", "scene info --help"])
def test_a_full_disk_is_one_line(line: str) -> None:
    with open("/dev/full", "w") as full:
        done = cloak(line, stdout=full)
    said = done.stderr.decode()
    assert done.returncode == 2, said
    assert said == "cloak: standard output: cannot be written (No space left on device)\n"


@pytest.mark.parametrize("line", ["--help", "scene info sample:train[0:1]"])
def test_a_reader_who_has_had_enough_is_no_error(line: str) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "wb") as pipe:
        done = cloak(line, stdout=pipe)
    assert (done.returncode, done.stderr) == (0, b"")


def test_an_output_that_is_a_device_is_left_alone(capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(["logo", "select", "--scene", "sample:train", "--region", "chest", "--out", "/dev/full"])
    assert end.value.code == 2 and "/dev/full" in capsys.readouterr().err
    assert Path("/dev/full").is_char_device()


@pytest.mark.slow
def test_a_terminal_without_the_characters(tmp_path: Path) -> None:
    """Help, results and errors hold characters beyond ASCII."""
    environment = os.environ | ASCII
    helped = cloak("train --help", env=environment, stdout=subprocess.PIPE)
    assert helped.returncode == 0 and not helped.stderr and helped.stdout.isascii()
    refused = cloak("train --nonsense", env=environment, stdout=subprocess.PIPE)
    assert refused.returncode == 2 and len(refused.stderr.splitlines()) == 1 and b"---" not in refused.stderr
    absent = cloak("scene info \N{GREATER-THAN OR EQUAL TO}", env=environment, stdout=subprocess.PIPE)
    assert absent.returncode == 2 and absent.stderr.isascii() and len(absent.stderr.splitlines()) == 1


@pytest.mark.parametrize("line", ["--version --json", "--json --version"])
def test_the_version_as_json(line: str, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(line.split())
    assert not end.value.code and json.loads(capsys.readouterr().out) == {"version": __version__}


@pytest.mark.parametrize("line", ["--help --json", "--json --help", "train --help --json"])
def test_help_is_help(line: str, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(line.split())
    assert not end.value.code and "usage: cloak" in capsys.readouterr().out


def test_a_line_break_in_a_path_makes_no_second_line(tmp_path: Path) -> None:
    (tmp_path / "two\nlines").mkdir()
    command = """
import logging, sys, warnings
from cloak_core import cli
from cloak_core.commands.base import warn
sys.argv = ["cloak", "scene", "info", "two\\nlines"]
cli.prepare_streams()
warn("one\\ntwo")
warnings.warn("three\\nfour", stacklevel=1)
logging.getLogger("cloak").warning("%s: skipped", "five\\nsix")
cli.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
    )  # fmt: skip
    lines = done.stderr.splitlines()
    assert done.returncode == 2 and len(lines) == 4, done.stderr
    assert all(line.startswith("cloak: ") for line in lines)
