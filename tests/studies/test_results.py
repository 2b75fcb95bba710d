"""Results survive files, of earlier versions, too; repetitions are put together and counted once where they are one."""

from pathlib import Path

import numpy as np
import pytest

from cloak_core.core.evaluation.results import NOBODY, read_results
from cloak_core.core.evaluation.statistics import success_record, summarize
from cloak_core.files.errors import InputError
from tests.studies.made_evaluation import CONTROLS, made_results


def test_results_survive_a_file(tmp_path: Path) -> None:
    results = made_results(specs=("a", "b"))
    results.images["person"] = "Ada"  # a column of a source of views
    results.save(tmp_path / "scores.npz")
    back = read_results(tmp_path / "scores.npz")
    assert back.detectors == results.detectors and back.background_names == results.background_names
    assert set(back.trials["person"]) == {"Ada"} and back.trials.equals(results.trials)
    assert back.boxes.drop(columns=["x1", "y1", "x2", "y2"]).equals(
        results.boxes.drop(columns=["x1", "y1", "x2", "y2"])
    )
    for spec in back.detectors:
        for control in (*CONTROLS, NOBODY):
            assert np.array_equal(back.scores(spec, control), results.scores(spec, control))


def test_a_file_without_elevations_and_overlaps_is_read(tmp_path: Path) -> None:
    made_results().save(tmp_path / "new.npz")
    absent = ("trials_elevation", "boxes_iou", "operating_points", "bare_background")
    arrays = {k: v for k, v in np.load(tmp_path / "new.npz").items() if k not in absent}
    np.savez(tmp_path / "old.npz", **arrays)
    back = read_results(tmp_path / "old.npz")
    new, old = (success_record(one, one.rows("builtin", "logo")) for one in (made_results(), back))
    assert new["ap50_95"] is not None and old["ap50_95"] is None and old["ap50"] == new["ap50"] > 0
    assert back.trials["elevation"].isna().all()
    assert "by_elevation" not in summarize(back)["detectors"]["builtin"]


def test_damaged_results_are_named(tmp_path: Path) -> None:
    path = tmp_path / "scores.npz"
    np.savez(path, a=np.zeros(3))
    with pytest.raises(InputError, match=r"scores\.npz: not a cloak measurement"):
        read_results(path)
    np.savez(path, format=np.array("cloak measurement 1"))
    with pytest.raises(InputError, match=r"scores.npz: .* is missing"):
        read_results(path)
