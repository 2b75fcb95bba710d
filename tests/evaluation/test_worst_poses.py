"""Success by pose, and the worst poses as pictures."""

from pathlib import Path

import numpy as np
import pytest

from cloak_core.evaluation.pictures import WORST, worst_trials
from cloak_core.evaluation.report.page import make_report
from cloak_core.evaluation.report.plots import success_by_body
from tests.evaluation.made_evaluation import make_measurement, write_run

MANY = tuple(f"pose {i:03}" for i in range(60))


def test_the_worst_ten_in_order_each_in_its_surest_image() -> None:
    measurement = make_measurement(bodies=MANY)
    score, pose = measurement.score[0, 0], measurement.trials.pose
    score[:] = 0.1
    for rank, body in enumerate((7, 3, 30, 41)):
        score[np.flatnonzero(pose == body)[: 8 - 2 * rank]] = 0.9
    score[np.flatnonzero(pose == 3)[2]] = 0.97
    worst = worst_trials(measurement, 0, 0.6)
    assert [int(pose[trial]) for trial, _ in worst] == [7, 3, 30, 41]
    assert [success for _, success in worst] == [0.6, 0.7, 0.8, 0.9]
    assert score[worst[1][0]] == np.float32(0.97)
    score[:] = 0.9
    assert len(worst_trials(measurement, 0, 0.6)) == WORST == 10


@pytest.mark.slow
def test_the_report_shows_them(tmp_path: Path) -> None:
    text = make_report(write_run(tmp_path / "run", measurement=make_measurement(bodies=MANY[:6]))).read_text("utf-8")
    assert "Of 6 bodies in their poses" in text and "success 25" in text
    few = make_report(write_run(tmp_path / "few", measurement=make_measurement())).read_text("utf-8")
    assert "bodies in their poses" not in few


def test_many_bodies_make_a_curve_of_bounded_size() -> None:
    figure = success_by_body(make_measurement(bodies=MANY), 0, 0.6)
    assert figure.get_figheight() < 6
    for line in figure.axes[0].lines:
        assert len(line.get_ydata()) == 60 and (np.diff(line.get_ydata()) >= 0).all()
