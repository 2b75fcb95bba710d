import numpy as np
import pytest

from cloak_core.files.errors import InputError
from cloak_core.studies.trainings.heatmap import heatmap
from tests.core.fakes import SIDE, BrokenDetector, Says, TinyDetector, box_bodies, noise_backgrounds

FACES = 6 * SIDE * SIDE


def test_heat_is_where_the_detector_looks():
    bodies = box_bodies(1)
    upper_half = Says(lambda images: images[:, :, :32].mean(dim=(1, 2, 3)))  # linear, so the heat is known
    heat = heatmap(bodies, upper_half, noise_backgrounds(), [0.0], size=64)
    assert heat.shape == (FACES,) and heat.dtype == np.float32
    front = heat[: SIDE * SIDE].reshape(SIDE, SIDE)  # columns x, rows y
    assert (front[:, SIDE // 2 :] > 0).all() and (front[:, 0] == 0).all()
    assert (heat[SIDE * SIDE : 2 * SIDE * SIDE] == 0).all()  # the far side
    # Each covered pixel of the upper half gives its three channels 1 / (3 * 32 * 64), times light of at most 0.8.
    assert 0 < heat.sum() < 0.8 * 3 * 32 * 64 / (3 * 32 * 64)


def test_bad_input():
    bodies = box_bodies(1)
    with pytest.raises(InputError, match="not finite"):
        heatmap(bodies, BrokenDetector(0), noise_backgrounds(), [0.0], size=64)
    black_box = TinyDetector()
    black_box.differentiable = False
    with pytest.raises(InputError, match="no gradients"):
        heatmap(bodies, black_box, noise_backgrounds(), [0.0])
