"""Loops that are compiled ahead: a training that comes after compiles nothing."""

from pathlib import Path

import pytest

from cloak_core.core.logo import load_logo
from cloak_core.core.settings import make_settings
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.studies.first_view import compile_loops
from cloak_core.studies.trainings.training import train
from tests.core.fakes import RedDetector, noise_backgrounds

event = pytest.importorskip("numba.core.event")
pytestmark = pytest.mark.slow


class Compiled(event.Listener):
    """The loops that numba compiles meanwhile."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def on_start(self, started: object) -> None:
        self.names.append(started.data["dispatcher"].py_func.__qualname__)

    def on_end(self, ended: object) -> None:
        pass


@pytest.mark.parametrize("changes", [{}, {"pattern": "tile"}, {"samples": 1}, {"contrast": "1", "noise": 0.0}])
def test_a_training_compiles_nothing_afterwards(tmp_path: Path, changes: dict) -> None:
    assert compile_loops() > 0
    bodies = load_scene("sample[0:1]")
    settings = make_settings("best", steps=2, batch=2, size=64, translation=5, **changes)
    with event.install_listener("numba:compile", Compiled()) as compiled:
        train(
            settings, bodies, load_logo(bodies, region="chest"), [RedDetector()], noise_backgrounds(), tmp_path / "run"
        )
    assert not compiled.names
