"""`cloak setup`: real environments and real pip, a tiny wheel instead of the trainer, no network."""

import json
import os
import subprocess
import zipfile
from pathlib import Path

import pytest

from cloak_core.cli import main
from cloak_core.commands import about
from cloak_core.files.errors import InputError


def make_wheel(folder: Path, *needs: str) -> Path:
    """A wheel with a program `cloak` in it."""
    path = folder / "cloak_core-0.1-py3-none-any.whl"
    about = "cloak_core-0.1.dist-info"
    files = {"cloak_core/__init__.py": "def main(): print('hello')\n"}
    files[f"{about}/METADATA"] = "\n".join(
        ["Metadata-Version: 2.1", "Name: cloak-core", "Version: 0.1", *(f"Requires-Dist: {need}" for need in needs)]
    )
    files[f"{about}/WHEEL"] = "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    files[f"{about}/entry_points.txt"] = "[console_scripts]\ncloak = cloak_core:main\n"
    files[f"{about}/RECORD"] = "".join(f"{name},,\n" for name in (*files, f"{about}/RECORD"))
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return path


@pytest.fixture
def offline(monkeypatch) -> None:
    """Pip asks no index, and there is room."""
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    for name in ("PIP_INDEX_URL", "PIP_EXTRA_INDEX_URL", "PIP_FIND_LINKS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(about, "GIGABYTES", 0.0)


@pytest.mark.slow
def test_an_environment_with_a_program_is_made(offline, tmp_path):
    place = tmp_path / "trainer"
    result = about.Setup(into=place, source=str(make_wheel(tmp_path))).run()
    assert subprocess.check_output([result["program"]], text=True, env={}) == "hello\n"
    with pytest.raises(InputError, match="exists already"):
        about.Setup(into=place, source=str(make_wheel(tmp_path))).run()


@pytest.mark.long
def test_what_fails_leaves_nothing_and_is_named(offline, tmp_path, monkeypatch):
    place, wheel = tmp_path / "trainer", make_wheel(tmp_path, "no-such-thing")
    with pytest.raises(InputError, match="the package index has no suitable no-such-thing"):
        about.Setup(into=place, source=str(wheel)).run()
    assert not place.exists()
    monkeypatch.delenv("PIP_NO_INDEX")
    monkeypatch.setenv("PIP_RETRIES", "1")
    monkeypatch.setenv("PIP_INDEX_URL", "http://127.0.0.1:9/simple")
    with pytest.raises(InputError, match="the package index cannot be reached"):
        about.Setup(into=place, source=str(wheel)).run()
    assert not place.exists()


def test_bad_sources_and_too_little_room_are_said_before_anything_is_written(tmp_path, monkeypatch):
    (tmp_path / "notes.txt").touch()
    for source, words in (
        (str(tmp_path), "no pyproject.toml in it"),
        (str(tmp_path / "notes.txt"), "neither a wheel"),
        (str(tmp_path / "none.whl"), "no such file"),
    ):
        with pytest.raises(InputError, match=words):
            about.Setup(into=tmp_path / "trainer", source=source).run()
    with pytest.raises(InputError, match="/nowhere/at/all: No such file"):
        about.Setup(into=Path("/nowhere/at/all/trainer")).run()
    monkeypatch.setattr(about, "GIGABYTES", 1e9)
    with pytest.raises(InputError, match=r"takes about 1000000000.0 GB, but .* GB are free there"):
        about.Setup(into=tmp_path / "trainer").run()
    assert not (tmp_path / "trainer").exists()


def test_setup_says_what_this_trainer_is(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["setup", "--json"])
    about = json.loads(capsys.readouterr().out)
    assert set(about) == {"cloak", "torch", "python", "device", "program"} and about["torch"][0].isdigit()
