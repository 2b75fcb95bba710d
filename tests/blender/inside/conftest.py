"""One Blender per process, the extension installed into a private folder, torch forbidden."""

import importlib
import importlib.abc
import json
import os
import pkgutil
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest


class NoTorch(importlib.abc.MetaPathFinder):
    """Fails whoever imports torch in Blender's process: it crashes Blender at exit."""

    asked: list[str] = []  # noqa: RUF012

    def find_spec(self, name: str, path: object, target: object = None) -> None:
        if name.split(".")[0] in ("torch", "torchvision"):
            self.asked.append(name)
            raise AssertionError(f"{name} imported inside Blender")


sys.meta_path.insert(0, NoTorch())

import bpy  # noqa: E402

EXTENSION = Path(os.environ["CLOAK_EXTENSION"])
ROOT = Path(os.environ["CLOAK_ROOT"])
MODULE = "bl_ext.user_default.cloak"
STUB = Path(__file__).parent / "stub"
LOGO_FACES = [10, 20, 30, 333]
"""Of the fixture `ready`."""


def blender_command(script: Path, *arguments: object) -> list[str]:
    """Another Blender of this kind, without a window, that runs a script."""
    words = ["--", *map(str, arguments)]
    if bpy.app.binary_path:
        options = ["-b", "--factory-startup", "--python-exit-code", "9", "-P", str(script)]
        return [bpy.app.binary_path, *options, *words]
    return [sys.executable, str(script), *words]


def install() -> None:
    """Let tests import the installed extension as `cloak`."""
    # The repository's own packages must not be found: what is tested is what was installed.
    sys.path[:] = [place for place in sys.path if Path(place or ".").resolve() != ROOT]
    bpy.ops.extensions.package_install_files(filepath=str(EXTENSION), repo="user_default", enable_on_install=True)
    sys.modules["cloak"] = importlib.import_module(MODULE)
    # Every module, so that one that needs what was not shipped fails here.
    for found in pkgutil.walk_packages(sys.modules["cloak"].__path__, f"{MODULE}."):
        sys.modules[found.name.replace(MODULE, "cloak", 1)] = importlib.import_module(found.name)


install()

from cloak.blender import colors, faces  # noqa: E402
from cloak.result import render_check  # noqa: E402
from cloak.session import session  # noqa: E402
from cloak.trainer import jobs  # noqa: E402
from cloak.trainer.program import preferences  # noqa: E402


@pytest.fixture(autouse=True)
def fresh_file():
    """An empty scene before each test, no torch and no running job after it."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    yield
    jobs.shut_down()
    assert not NoTorch.asked
    assert not [name for name in sys.modules if name.split(".")[0] == "torch"]


def make_launcher(folder: Path, path: list[Path], python: str = sys.executable) -> Path:
    """A "Python" that has a trainer: this interpreter with `path` in front of its modules."""
    folder.mkdir(parents=True, exist_ok=True)
    launcher = folder / "python"
    places = os.pathsep.join(map(str, path))
    launcher.write_text(f'#!/bin/sh\nPYTHONPATH="{places}" exec "{python}" "$@"\n')
    launcher.chmod(0o755)
    return launcher


@pytest.fixture
def stub(tmp_path: Path) -> Path:
    """The stub trainer's Python, under a path with spaces and letters beyond ASCII; chosen in the preferences."""
    launcher = make_launcher(tmp_path / "Bücher & Straße 素材", [STUB])
    preferences().program = str(launcher)
    yield launcher
    preferences().program = ""


@pytest.fixture(scope="session")
def real_trainer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The project's own trainer."""
    return make_launcher(tmp_path_factory.mktemp("real"), [ROOT], os.environ["CLOAK_TRAINER"])


@pytest.fixture
def coarse_renders(monkeypatch: pytest.MonkeyPatch) -> None:
    """A render check has one sample a pixel, which takes a tenth of a render's time."""
    monkeypatch.setattr(render_check, "Plan", partial(render_check.Plan, samples=1))


def wait_for(condition: Callable[[], object], seconds: float = 60) -> None:
    """Let time pass, as Blender's timer would, until the condition holds."""
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, session.job and session.job.describe()
        jobs.tick()
        time.sleep(0.01)


def run_job(seconds: float = 60) -> jobs.Job:
    """Let all jobs end; returns the last."""
    wait_for(lambda: jobs.tick() is None, seconds)
    return session.job


@pytest.fixture
def ready(stub: Path, tmp_path: Path) -> bpy.types.Object:
    """A body with a logo, and settings for a short run into a folder with a difficult name."""
    from made import make_egg

    obj = make_egg()
    faces.new_logo(obj, "Brust/Ärmel", np.isin(np.arange(len(obj.data.polygons)), LOGO_FACES))
    settings = bpy.context.scene.cloak
    settings.output = str(tmp_path / "Läufe und mehr")
    settings.steps = 20
    return obj


def folder_of(obj: bpy.types.Object) -> Path:
    """The body's run folder."""
    return Path(bpy.path.abspath(obj.cloak.run))


def elsewhere(folder: Path, *lines: str) -> subprocess.CompletedProcess:
    """Let another Blender, which has the add-on and the same trainer, run a script."""
    script = folder / "elsewhere.py"
    python = f"bpy.context.preferences.addons[{MODULE!r}].preferences.program = {preferences().program!r}"
    first = ("import bpy, os, time", f"bpy.ops.preferences.addon_enable(module={MODULE!r})", python)
    imports = (f"from {MODULE}.trainer import jobs", f"from {MODULE}.session import session")
    script.write_text("\n".join((*first, *imports, *lines)))
    return subprocess.run(blender_command(script), capture_output=True, text=True, timeout=250, check=False)


TRAIN_THERE = """
bpy.ops.cloak.train_start()
while session.job.progress.step < 2:
    jobs.tick(); time.sleep(0.01)
print("trainer is process", session.job._process.pid, flush=True)
"""


def red_faces(obj: bpy.types.Object) -> list[int]:
    """The faces in the stub's trained colour."""
    return np.flatnonzero((np.abs(colors.written_colors(obj) - [1, 0, 0]) < 1e-5).all(1)).tolist()


@pytest.fixture
def dressed(stub: Path, tmp_path: Path) -> bpy.types.Object:
    """A body that wears a run's colours."""
    from made import body_of_a_run

    obj, run = body_of_a_run(tmp_path, [10, 20, 333])
    (run / "config.json").write_text(json.dumps({"format": "cloak run", "detectors": [{"spec": "builtin"}]}))
    bpy.ops.cloak.result_load()
    return obj


@pytest.fixture
def clothed(tmp_path):
    """An egg whose upper faces wear a cloth, and the squares."""
    from cloths_made import cloth_run, random_squares
    from made import make_egg

    obj, squares = make_egg(), random_squares()
    obj.data.materials.append(bpy.data.materials.new("Skin"))
    ids = np.flatnonzero([p.center.z > 0.5 for p in obj.data.polygons])
    obj.cloak.run = str(cloth_run(tmp_path, obj, ids, squares))
    bpy.ops.cloak.result_load()
    return obj, ids, squares


class Layout:
    """What a panel draws on, without a window: notes every text, icon and operator."""

    def __init__(self, said: list[str]) -> None:
        self.__dict__.update(said=said)

    def __getattr__(self, name: str):
        return self._note

    def __setattr__(self, name: str, value: object) -> None:
        """Looks, and the properties of the last button."""

    def _note(self, *words: object, text: str = "", **options: object) -> "Layout":
        self.said.append(text or next((word for word in words if isinstance(word, str)), ""))
        return Layout(self.said)


def drawn(panel: type) -> list[str]:
    """What a panel draws now."""
    parts = {
        name: part for kind in reversed(panel.__mro__[:2]) for name, part in vars(kind).items() if name[:2] != "__"
    }
    said: list[str] = []
    plain = type("Drawn", (), parts | {"layout": Layout(said), "unfinished": panel.unfinished})
    plain().draw(bpy.context)
    return said
