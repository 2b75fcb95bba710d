"""`--init`: going on from given colours."""

from pathlib import Path

import numpy as np
import pytest

from cloak_core.exchange.face_lists import write_colors
from cloak_core.files.errors import InputError
from tests.core.fakes import back_logo, box_bodies
from tests.core.test_training import run


@pytest.mark.slow
def test_a_run_goes_on_from_another_runs_colours_or_from_a_file(tmp_path: Path) -> None:
    first = run(tmp_path / "first")
    close = {"steps": 1, "lr": 1e-6}
    for name, init in (("run", tmp_path / "first"), ("file", tmp_path / "first" / "colors.npy")):
        np.testing.assert_allclose(run(tmp_path / name, init=str(init), **close).colors, first.colors, atol=1e-4)
    assert np.abs(run(tmp_path / "anew", **close).colors - first.colors).max() > 0.01


@pytest.mark.slow
def test_resuming_needs_the_same_first_colours(tmp_path: Path) -> None:
    write_colors(tmp_path / "c.npy", np.full((16, 3), 0.25))
    done = run(tmp_path / "run", init=str(tmp_path / "c.npy"))
    (tmp_path / "c.npy").rename(tmp_path / "moved.npy")
    again = run(tmp_path / "run", resume=True, init=str(tmp_path / "moved.npy"))
    assert np.array_equal(again.colors, done.colors)
    write_colors(tmp_path / "moved.npy", np.full((16, 3), 0.75))
    for init in (str(tmp_path / "moved.npy"), None):
        with pytest.raises(InputError, match=r"start(\.sha256)? = "):
            run(tmp_path / "run", resume=True, init=init)


def test_colours_that_do_not_fit(tmp_path: Path) -> None:
    write_colors(tmp_path / "c.npy", np.zeros((3, 3)))
    run(tmp_path / "back", logo=back_logo(box_bodies()), angles="180")
    (tmp_path / "empty").mkdir()
    for init, says in (
        ("c.npy", "colours for 3 faces, but the logo has 16"),
        ("back", "was trained on another logo"),
        ("empty", "not a run folder"),
        ("absent", "no such file"),
    ):
        with pytest.raises(InputError, match=says):
            run(tmp_path / "run", init=str(tmp_path / init))
    assert not (tmp_path / "run").exists()
