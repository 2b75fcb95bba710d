"""Rates: the definitions of success, by hand on a few images, and what JSON gets where nothing is defined."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_evaluation import make_measurement

from cloak_core.evaluation.measurement import Boxes, Measurement, Trials, draw_trials, read_measurement
from cloak_core.evaluation.rates import average_precision, rate_record, summarize
from cloak_core.evaluation.settings import EvaluateSettings
from cloak_core.files.errors import InputError


def hand_made() -> Measurement:
    """Six images: body 0 at angles -10 and 0, body 1 likewise; one detector; logo and own clothing."""
    trials = Trials(
        pose=np.array([0, 0, 0, 1, 1, 1]),
        angle=np.array([-10, 0, 0, -10, 0, 0], np.float32),
        elevation=np.full(6, 6.0, np.float32),
        distance=np.full(6, 2.2, np.float32),
        background=np.arange(6),
        shift=np.zeros((6, 2), np.int64),
        outfit=np.zeros(6, np.int64),
    )
    # Exactly 0.6 is not above the threshold: success.
    logo = [0.1, 0.6, 0.7, 0.2, 0.9, 0.3]
    on = [0.0, 0.6, 0.2, 0.2, 0.9, 0.3]
    clean = [0.9, 0.5, 0.9, 0.9, 0.9, 0.1]
    nothing = np.zeros(0, np.int64)
    return Measurement(
        specs=("one",),
        controls=("logo", "clothing"),
        body_names=("a", "b"),
        background_names=tuple("012345"),
        trials=trials,
        score=np.array([[logo, clean]], np.float32),
        score_on=np.array([[on, clean]], np.float32),
        bare=np.array([[0.1, 0.9, 0.61, 0.6]], np.float32),
        boxes=Boxes(nothing, nothing, nothing, np.zeros(0, np.float32), np.zeros(0, bool), np.zeros(0)),
    )


def test_definitions_of_success() -> None:
    record = rate_record(hand_made(), 0, 0, threshold=0.6)
    assert record["success"] == pytest.approx(4 / 6, abs=1e-6)
    assert record["success_iou"] == pytest.approx(5 / 6, abs=1e-6)
    # Found clean: images 0, 2, 3, 4; gone under the logo: 0 and 3.
    assert (record["conditional"], record["n_conditional"]) == (0.5, 4)
    assert record["n"] == 6
    assert record["ci95"][0] < 4 / 6 < record["ci95"][1]


def test_success_at_the_detectors_own_threshold_stands_beside() -> None:
    measurement = hand_made()
    record = rate_record(measurement, 0, 0, threshold=0.6, own=0.15)
    assert record["success"] == pytest.approx(4 / 6, abs=1e-6)
    assert record["success_own"] == pytest.approx(float((measurement.score[0, 0] <= 0.15).mean()), abs=1e-6)
    assert record["success_own"] < record["success"]
    assert record["ci95_own"][0] <= record["success_own"] <= record["ci95_own"][1]
    summary = summarize(measurement, 0.6, resamples=100, operating_points={"one": 0.15})
    assert summary["detectors"]["one"]["logo"]["success_own"] == record["success_own"]
    assert summarize(measurement, 0.6, resamples=100)["detectors"]["one"]["logo"]["success_own"] is None


def test_summary_has_contract_keys_and_is_json() -> None:
    summary = summarize(hand_made(), 0.6, resamples=100)
    json.dumps(summary, allow_nan=False)
    rates = summary["detectors"]["one"]
    assert list(rates["by_angle"]) == ["-10", "0"]
    assert rates["by_angle"]["-10"]["success"] == 1.0
    assert {name: s["n"] for name, s in rates["by_body"].items()} == {"a": 3, "b": 3}
    assert rates["clothing"]["conditional"] == 0.0
    assert summary["false_alarms"] == {"one": 0.5}
    assert rates["by_threshold"]["0.1"] == {
        "logo": pytest.approx(1 / 6, abs=1e-6),
        "clothing": pytest.approx(1 / 6, abs=1e-6),
    }
    assert rates["by_threshold"]["0.9"]["logo"] == 1.0


def test_nothing_found_clean_gives_null() -> None:
    measurement = hand_made()
    score = measurement.score.copy()
    score[:, 1] = 0.1
    record = rate_record(replace(measurement, score=score), 0, 0, threshold=0.6)
    assert record["conditional"] is None
    assert record["ci95_conditional"] == [None, None]
    assert record["n_conditional"] == 0


def test_average_precision_by_hand() -> None:
    """Six bodies. Boxes by score: hit, false, hit: precision 1 up to recall 1/6, then 2/3 up to 2/6: 17 of COCO's 101
    recalls each. The last box overlaps too little for 0.75 and more."""
    zeros = np.zeros(3, np.int64)
    score, hit = np.array([0.9, 0.8, 0.7], np.float32), np.array([True, False, True])
    boxes = Boxes(zeros, zeros, np.array([0, 1, 2]), score, hit, np.array([1.0, 0.2, 0.74]))
    measurement = replace(hand_made(), boxes=boxes)
    assert average_precision(measurement, 0, 0) == pytest.approx(17 * (1 + 2 / 3) / 101)
    assert average_precision(measurement, 0, 0, overlaps=(0.75,)) == pytest.approx(17 / 101)
    both = average_precision(measurement, 0, 0), average_precision(measurement, 0, 0, overlaps=(0.75,))
    assert average_precision(measurement, 0, 0, overlaps=(0.5, 0.75)) == pytest.approx(np.mean(both))
    assert average_precision(measurement, 0, 1) == 0.0
    assert average_precision(measurement, 0, 0, np.arange(6) == 2) == 1.0  # of the one image with a box on its body


def test_trials_cover_the_grid_and_deal_backgrounds_evenly() -> None:
    def draw(seed: int) -> Trials:
        settings = EvaluateSettings(distances=(2.2, 3.0), images_per_view=5, seed=seed)
        return draw_trials(3, (-10.0, 10.0), 7, 4, settings)

    trials = draw(0)
    assert len(trials) == 3 * 2 * 2 * 5
    views, counts = np.unique(np.stack([trials.pose, trials.angle, trials.distance]), axis=1, return_counts=True)
    assert views.shape[1] == 12 and set(counts) == {5}
    dealt = np.bincount(trials.background, minlength=7)
    assert dealt.max() - dealt.min() <= 1
    assert np.abs(trials.shift).max() <= 50 and len(np.unique(trials.outfit)) == 4
    assert np.array_equal(trials.shift, draw(0).shift) and not np.array_equal(trials.shift, draw(1).shift)


def test_trials_at_several_elevations_and_only_so_many_of_them() -> None:
    places = {"distances": (2.2, 4.0), "elevations": (0.0, 15.0, 30.0), "images_per_view": 2}
    whole = draw_trials(3, (0.0, 10.0), 7, 4, EvaluateSettings(**places))
    views = np.stack([whole.pose, whole.angle, whole.distance, whole.elevation])
    assert len(whole) == 72 and np.unique(views, axis=1).shape[1] == 36
    some = draw_trials(3, (0.0, 10.0), 7, 4, EvaluateSettings(most_images=20, **places))
    assert len(some) == 20 and len(np.unique(some.elevation)) == 3
    dealt = np.bincount(some.background, minlength=7)
    assert dealt.max() - dealt.min() <= 1
    measured = replace(hand_made(), trials=replace(hand_made().trials, elevation=np.array([0, 0, 9] * 2, np.float32)))
    by_elevation = summarize(measured)["detectors"]["one"]["by_elevation"]
    assert {key: rates["n"] for key, rates in by_elevation.items()} == {"0": 4, "9": 2}
    with pytest.raises(InputError, match="--elevations"):
        EvaluateSettings(elevations=(0.0, 91.0))


def test_a_file_without_elevations_and_overlaps_is_read(tmp_path: Path) -> None:
    make_measurement().save(tmp_path / "new.npz")
    arrays = {k: v for k, v in np.load(tmp_path / "new.npz").items() if k not in ("trials_elevation", "boxes_iou")}
    np.savez(tmp_path / "old.npz", **arrays)
    back = read_measurement(tmp_path / "old.npz")
    new, old = (rate_record(one, 0, 0) for one in (make_measurement(), back))
    assert new["ap50_95"] is not None and old["ap50_95"] is None and old["ap50"] == new["ap50"] > 0
    assert np.isnan(back.trials.elevation).all() and "by_elevation" not in summarize(back)["detectors"][back.specs[0]]


def test_measurement_survives_a_file(tmp_path: Path) -> None:
    measurement = make_measurement()
    measurement.save(tmp_path / "scores.npz")
    back = read_measurement(tmp_path / "scores.npz")
    assert back.specs == measurement.specs and back.background_names == measurement.background_names
    assert np.array_equal(back.score, measurement.score) and np.array_equal(back.boxes.hit, measurement.boxes.hit)
    assert np.array_equal(back.trials.shift, measurement.trials.shift)


def test_damaged_measurement_is_named(tmp_path: Path) -> None:
    path = tmp_path / "scores.npz"
    np.savez(path, a=np.zeros(3))
    with pytest.raises(InputError, match=r"scores\.npz: not a cloak measurement"):
        read_measurement(path)
    np.savez(path, format=np.array("cloak measurement 1"))
    with pytest.raises(InputError, match=r"scores.npz: .* is missing"):
        read_measurement(path)
