"""Which images a report shows, also of an evaluation of a handful; success by pose, and the worst poses as pictures."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from cloak_core.products.run_report import make_report
from cloak_core.studies.report.pictures import (
    ANGLES,
    BODIES,
    WORST,
    gallery_trials,
    worst_trials,
    write_shot,
)
from cloak_core.studies.report.plots import success_by_body
from tests.core.fakes import RedDetector
from tests.studies.made_evaluation import made_results, write_run

MANY = tuple(f"pose {i:03}" for i in range(60))


def trials(pose: np.ndarray | list[int], angle: np.ndarray | list[float]) -> pd.DataFrame:
    """As far as a gallery looks at them."""
    return pd.DataFrame({"pose": pose, "angle": np.array(angle, np.float32)})


def test_each_body_is_shown_at_each_angle() -> None:
    poses, angles = np.repeat(np.arange(3), 10), np.tile(np.repeat(np.arange(5) * 5.0 - 10, 2), 3)
    shown = gallery_trials(trials(poses, angles))
    assert len(shown) == BODIES * ANGLES
    assert shown == sorted(shown) and set(np.diff(shown)) == {2}  # the first of the two at each angle


def test_the_worst_ten_in_order_each_in_its_surest_image() -> None:
    score = np.full((1, 4, 20 * len(MANY)), 0.1, np.float32)
    pose = made_results(bodies=MANY, score=score).trials["pose"].to_numpy()
    for rank, body in enumerate((7, 3, 30, 41)):
        score[0, 0, np.flatnonzero(pose == body)[: 8 - 2 * rank]] = 0.9
    score[0, 0, np.flatnonzero(pose == 3)[2]] = 0.97
    rows = made_results(bodies=MANY, score=score).rows("builtin", "logo")
    worst = worst_trials(rows, 0.6)
    assert [int(pose[trial]) for trial, _ in worst] == [7, 3, 30, 41]
    assert [success for _, success in worst] == [0.6, 0.7, 0.8, 0.9]
    assert score[0, 0, worst[1][0]] == np.float32(0.97)
    score[:] = 0.9
    assert len(worst_trials(made_results(bodies=MANY, score=score).rows("builtin", "logo"), 0.6)) == WORST == 10


def test_a_picture_has_the_boxes_above_each_detectors_own_threshold(tmp_path: Path) -> None:
    low, high = RedDetector(), RedDetector()
    image = torch.full((1, 3, 32, 32), 0.5)
    score = write_shot(tmp_path / "a.jpg", image, {"low": low})["scores"]["low"]
    low.operating_point, high.operating_point = score - 0.1, score + 0.1
    boxes = write_shot(tmp_path / "b.jpg", image, {"low": low, "high": high})["boxes"]
    assert boxes["low"] and not boxes["high"]


@pytest.mark.long
def test_the_report_shows_them(tmp_path: Path) -> None:
    text = make_report(write_run(tmp_path / "run", results=made_results(bodies=MANY[:6]))).read_text("utf-8")
    assert "Of 6 bodies in their poses" in text and "success 25" in text
    few = make_report(write_run(tmp_path / "few", results=made_results())).read_text("utf-8")
    assert "bodies in their poses" not in few


def test_many_bodies_make_a_curve_of_bounded_size() -> None:
    figure = success_by_body(made_results(bodies=MANY), "builtin", 0.6)
    assert figure.get_figheight() < 6
    for line in figure.axes[0].lines:
        assert len(line.get_ydata()) == 60 and (np.diff(line.get_ydata()) >= 0).all()
