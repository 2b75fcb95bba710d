"""Trials: every view, evenly dealt, and drawn by the seed."""

import numpy as np
import pandas as pd
import pytest

from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.evaluation.trials import COLUMNS, draw_trials
from cloak_core.files.errors import InputError


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
