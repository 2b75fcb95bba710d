"""Which images a report shows, also of an evaluation of a handful."""

import numpy as np

from cloak_core.evaluation.measurement import Trials
from cloak_core.evaluation.pictures import ANGLES, BODIES, gallery_trials


def trials(pose: np.ndarray | list[int], angle: np.ndarray | list[float]) -> Trials:
    """As far as a gallery looks at them."""
    made = object.__new__(Trials)
    object.__setattr__(made, "pose", np.array(pose, np.int64))
    object.__setattr__(made, "angle", np.array(angle, np.float32))
    return made


def test_each_body_is_shown_at_each_angle() -> None:
    poses, angles = np.repeat(np.arange(3), 10), np.tile(np.repeat(np.arange(5) * 5.0 - 10, 2), 3)
    shown = gallery_trials(trials(poses, angles))
    assert len(shown) == BODIES * ANGLES
    assert shown == sorted(shown) and set(np.diff(shown)) == {2}  # the first of the two at each angle


def test_where_an_angle_lacks_a_body_the_nearest_is_shown_once() -> None:
    shown = gallery_trials(trials([0, 0, 1, 2], [-10, 4, 0, 10]))
    assert shown == [0, 1, 2, 3]  # of -10, 0, 4 and 10 degrees, the second body has 0 alone, the third 10
