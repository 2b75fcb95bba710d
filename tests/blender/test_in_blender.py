"""Runs the add-on's own tests (inside/) against the built and installed extension, under every Blender there is.

Blender as a Python package and torch cannot live in one process (it crashes at exit), so the files of inside/ get
processes of their own, under a Python that has bpy: this one when it has, those in .venv-blender*
(tools/setup_blender.sh makes them), and those named in CLOAK_BPY_PYTHONS. This Python is the one that trains.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.shared_folders import fill_once

ROOT = Path(__file__).resolve().parents[2]
INSIDE = Path(__file__).parent / "inside"
GROUPS = 4
"""A process that has Blender and the extension takes more than a second to start."""
LONG = sorted(path.name for path in INSIDE.glob("test_real_*.py"))
"""With real trainings, and one with files of CLOAK_SHARED: minutes."""
SHORT = sorted({path.name for path in INSIDE.glob("test_*.py")} - set(LONG))


def groups_of_files() -> list:
    """Return one parameter for each process: the names of its files."""
    short = [pytest.param(SHORT[i::GROUPS], id="+".join(SHORT[i::GROUPS])) for i in range(GROUPS)]
    marks = [pytest.mark.long, pytest.mark.timeout(1600)]
    return short + [pytest.param([name], id=name, marks=marks) for name in LONG]


RUN_PYTEST = "import os, pytest, sys; code = pytest.main(sys.argv[1:]); sys.stdout.flush(); os._exit(code)"
"""The bpy package may wait for ever at a regular exit."""
_PROBE = "import importlib.util as u, sys; sys.exit(not all(u.find_spec(m) for m in ('bpy', 'pytest')))"


def bpy_pythons() -> list[str]:
    """Every Python here that has bpy and pytest."""
    places = [sys.executable, *map(str, sorted(ROOT.glob(".venv-blender*/bin/python")))]
    places += filter(None, os.environ.get("CLOAK_BPY_PYTHONS", "").split(os.pathsep))
    return [place for place in dict.fromkeys(places) if _has_bpy(place)]


def _has_bpy(python: str) -> bool:
    if not os.access(python, os.X_OK):
        return False
    return subprocess.run([python, "-c", _PROBE], capture_output=True, check=False).returncode == 0


PYTHONS = bpy_pythons()


@pytest.fixture(scope="session")
def extension(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The extension as `make extension` builds it, validated by Blender's own tool."""
    folder = fill_once(tmp_path_factory, "dist", build)
    (path,) = folder.glob("*.zip")
    return path


def build(out: Path) -> None:
    command = [PYTHONS[0], str(ROOT / "tools" / "build_extension.py"), "--out", str(out)]
    environment = os.environ | {"CLOAK_TRAINER": sys.executable}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr


def test_built_twice_it_is_the_same_zip(extension: Path, tmp_path: Path) -> None:
    build(tmp_path)
    assert (tmp_path / extension.name).read_bytes() == extension.read_bytes()


def test_a_blender_is_there() -> None:
    assert PYTHONS, "no Python with bpy: run tools/setup_blender.sh, or name some in CLOAK_BPY_PYTHONS"


@pytest.mark.parametrize("files", groups_of_files())
@pytest.mark.parametrize("python", PYTHONS, ids=lambda python: Path(python).parents[1].name)
def test_add_on(python: str, files: list[str], extension: Path, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    seconds = 1500 if files[0] in LONG else 550
    if files[0] in LONG:
        request.getfixturevalue("shared")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "PYTEST"))}
    environment |= {
        "CLOAK_EXTENSION": str(extension),
        "CLOAK_TRAINER": sys.executable,
        "CLOAK_ROOT": str(ROOT),
        "CLOAK_SHARED": os.environ.get("CLOAK_SHARED", str(ROOT.parent / "shared")),
        "BLENDER_USER_RESOURCES": str(tmp_path / "blender"),
        "OMP_NUM_THREADS": "1",
        "LC_ALL": "C.UTF-8",
    }
    options = ["-c", str(INSIDE / "pytest.ini"), "--rootdir", str(INSIDE), "-p", "no:cacheprovider", "-q"]
    command = [python, "-c", RUN_PYTEST, *options, *(str(INSIDE / file) for file in files)]
    command.append(f"--basetemp={tmp_path / 'tmp'}")
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=seconds, check=False)
    summary = done.stdout.strip().splitlines()[-1] if done.stdout.strip() else ""
    assert done.returncode == 0, f"{done.stdout[-8000:]}\n{done.stderr[-4000:]}"
    assert "skipped" not in summary, summary
