"""Trials, results and statistics: what is drawn, what survives a file, and the definitions of success, by hand."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cloak_core.core.evaluation.precision import average_precision
from cloak_core.core.evaluation.results import NOBODY, Results, make_results, read_results
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.evaluation.statistics import (
    false_alarms,
    outcome_record,
    rate,
    success_record,
    summarize,
)
from cloak_core.core.evaluation.trials import COLUMNS, draw_trials, make_trials
from cloak_core.files.errors import InputError
from tests.studies.made_evaluation import CONTROLS, made_results

CLEAN = [0.9, 0.5, 0.9, 0.9, 0.9, 0.1]
NO_BOXES = {name: np.zeros(0) for name in ("detector", "control", "image", "score", "hit", "iou")}


def hand_made(
    clean: list[float] = CLEAN, own: float | None = None, boxes: dict | None = None, **columns: object
) -> Results:
    """Six images: body 0 at angles -10 and 0, body 1 likewise; one detector; logo and own clothing."""
    trials = make_trials([0, 0, 0, 1, 1, 1], [-10, 0, 0, -10, 0, 0], 6.0, 2.2, np.arange(6), np.zeros((6, 2)))
    # Exactly 0.6 is not above the threshold: success.
    logo = [0.1, 0.6, 0.7, 0.2, 0.9, 0.3]
    on = [0.0, 0.6, 0.2, 0.2, 0.9, 0.3]
    score, score_on = np.array([[logo, clean]], np.float32), np.array([[on, clean]], np.float32)
    bare, names = np.array([[0.1, 0.9, 0.61, 0.6]], np.float32), {"body_names": "ab", "background_names": "012345"}
    trials, told = trials.assign(**columns), (bare, boxes or NO_BOXES)
    return make_results({"one": own}, ("logo", "clothing"), trials, score, score_on, *told, **names)


def record(results: Results) -> dict:
    return success_record(results, results.rows("one", "logo"), 0.6)


def test_definitions_of_success() -> None:
    told = record(hand_made())
    assert told["success"] == pytest.approx(4 / 6, abs=1e-6)
    assert told["success_iou"] == pytest.approx(5 / 6, abs=1e-6)
    # Found clean: images 0, 2, 3, 4; gone under the logo: 0 and 3.
    assert (told["conditional"], told["n_conditional"]) == (0.5, 4)
    assert told["n"] == 6
    assert told["ci95"][0] < 4 / 6 < told["ci95"][1]


def test_success_at_the_detectors_own_threshold_stands_beside() -> None:
    results = hand_made(own=0.15)
    told = record(results)
    assert told["success"] == pytest.approx(4 / 6, abs=1e-6)
    assert told["success_own"] == pytest.approx(float((results.scores("one", "logo") <= 0.15).mean()), abs=1e-6)
    assert told["success_own"] < told["success"]
    assert told["ci95_own"][0] <= told["success_own"] <= told["ci95_own"][1]
    assert summarize(results, 0.6, 100)["detectors"]["one"]["logo"]["success_own"] == told["success_own"]
    assert summarize(hand_made(), 0.6, 100)["detectors"]["one"]["logo"]["success_own"] is None


def test_summary_has_contract_keys_and_is_json() -> None:
    summary = summarize(hand_made(), 0.6, resamples=100)
    json.dumps(summary, allow_nan=False)
    rates = summary["detectors"]["one"]
    assert list(rates["by_angle"]) == ["-10", "0"] and "by_distance" not in rates
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
    told = record(hand_made(clean=[0.1] * 6))
    assert told["conditional"] is None
    assert told["ci95_conditional"] == [None, None]
    assert told["n_conditional"] == 0


def test_average_precision_by_hand() -> None:
    """Six bodies. Boxes by score: hit, false, hit: precision 1 up to recall 1/6, then 2/3 up to 2/6: 17 of COCO's 101
    recalls each. The last box overlaps too little for 0.75 and more."""
    boxes = {"detector": np.zeros(3), "control": np.zeros(3), "image": np.arange(3)}
    boxes |= {"score": np.array([0.9, 0.8, 0.7]), "hit": np.array([True, False, True]), "iou": np.array([1, 0.2, 0.74])}
    results = hand_made(boxes=boxes)
    logo = results.rows("one", "logo")
    assert average_precision(results, logo) == pytest.approx(17 * (1 + 2 / 3) / 101)
    assert average_precision(results, logo, overlaps=(0.75,)) == pytest.approx(17 / 101)
    both = average_precision(results, logo), average_precision(results, logo, overlaps=(0.75,))
    assert average_precision(results, logo, overlaps=(0.5, 0.75)) == pytest.approx(np.mean(both))
    assert average_precision(results, results.rows("one", "clothing")) == 0.0
    assert average_precision(results, logo[logo["image"] == 2]) == 1.0  # of the one image with a box on its body


def test_what_became_of_the_person() -> None:
    """Images without a reported person: 0, 1, 3 and 5, of which 1 and 5 report something else on the body."""
    results = hand_made(own=0.25)
    assert set(outcome_record(results.rows("one", "logo"), 0.6).values()) == {None}  # the detector does not tell
    rows = results.rows("one", "logo").assign(other=[0.1, 0.9, 0.9, 0.6, 0.9, 0.7], other_name=list("abcabb"))
    told = outcome_record(rows, 0.6)
    assert told["renamed"] == told["gone"] == pytest.approx(2 / 6, abs=1e-6) and told["named"] == {"b": 2}
    assert told["renamed_own"] == told["gone_own"] == pytest.approx(1 / 6, abs=1e-6)  # of images 0 and 3


def test_photographs_share_people_and_photographs() -> None:
    """A source of views without poses and backgrounds brings its own columns; what it does not have is left out."""
    columns = {"person": list("uuvvww"), "photograph": list("xxyyzz")}
    absent = {"pose": -1, "background": -1, "angle": np.float32(np.nan)}
    people, bodies = hand_made(**columns, **absent), hand_made()
    told = summarize(people)["detectors"]["one"]
    assert told["by_angle"] == told["by_body"] == {} and told["logo"]["n"] == 6
    wide, narrow = told["logo"]["ci95"], summarize(bodies)["detectors"]["one"]["logo"]["ci95"]
    assert wide != narrow
    rows = people.rows("one", "logo")
    assert rate(rows, np.ones(6, bool)).low == rate(rows, np.ones(6, bool), ("person", "photograph", "training")).low
    assert false_alarms(people, "one") == 0.5


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


def test_trials_cover_the_grid_and_deal_backgrounds_evenly() -> None:
    def draw(seed: int) -> pd.DataFrame:
        settings = EvaluateSettings(distances=(2.2, 3.0), images_per_view=5, seed=seed)
        return draw_trials(3, (-10.0, 10.0), 7, 4, settings)

    trials = draw(0)
    assert len(trials) == 3 * 2 * 2 * 5 and tuple(trials) == COLUMNS
    assert trials.groupby(["pose", "angle", "distance"]).size().tolist() == [5] * 12
    dealt = np.bincount(trials["background"], minlength=7)
    assert dealt.max() - dealt.min() <= 1
    shifts = ["shift_x", "shift_y"]
    assert trials[shifts].abs().max().max() <= 50 and trials["outfit"].nunique() == 4
    assert trials.equals(draw(0)) and not trials[shifts].equals(draw(1)[shifts])


def test_trials_at_several_elevations_and_only_so_many_of_them() -> None:
    places = {"distances": (2.2, 4.0), "elevations": (0.0, 15.0, 30.0), "images_per_view": 2}
    whole = draw_trials(3, (0.0, 10.0), 7, 4, EvaluateSettings(**places))
    assert len(whole) == 72 and whole.groupby(["pose", "angle", "distance", "elevation"]).ngroups == 36
    some = draw_trials(3, (0.0, 10.0), 7, 4, EvaluateSettings(most_images=20, **places))
    assert len(some) == 20 and some["elevation"].nunique() == 3
    dealt = np.bincount(some["background"], minlength=7)
    assert dealt.max() - dealt.min() <= 1
    with pytest.raises(InputError, match="--elevations"):
        EvaluateSettings(elevations=(0.0, 91.0))
