import numpy as np
import pytest
import torch

from cloak_core.attack.heatmap import heatmap, pick
from cloak_core.detectors.protocol import Detections
from cloak_core.files.errors import InputError
from cloak_core.scene.geometry import face_areas
from tests.attack.fakes import SIDE, BrokenDetector, TinyDetector, box_bodies, noise_backgrounds

FACES = 6 * SIDE * SIDE


class TopRowDetector(TinyDetector):
    """The mean of the image's upper half, as a score: linear, so the heat is known."""

    def forward(self, images: torch.Tensor) -> Detections:
        height = images.shape[2]
        scores = images[:, :, : height // 2].mean(dim=(1, 2, 3))[:, None]
        return Detections(torch.zeros(len(images), 1, 4), scores)


def test_heat_is_where_the_detector_looks():
    bodies = box_bodies(1)
    heat = heatmap(bodies, TopRowDetector(), noise_backgrounds(), [0.0], size=64)
    assert heat.shape == (FACES,) and heat.dtype == np.float32
    front = heat[: SIDE * SIDE].reshape(SIDE, SIDE)  # columns x, rows y
    assert (front[:, SIDE // 2 :] > 0).all() and (front[:, 0] == 0).all()
    assert (heat[SIDE * SIDE : 2 * SIDE * SIDE] == 0).all()  # the far side
    # Each covered pixel of the upper half gives its three channels 1 / (3 * 32 * 64), times light of at most 0.8.
    assert 0 < heat.sum() < 0.8 * 3 * 32 * 64 / (3 * 32 * 64)


def test_heat_is_the_mean_over_views():
    bodies, backgrounds = box_bodies(2), noise_backgrounds()
    heat = lambda poses, angles: heatmap(
        bodies.select_poses(poses), TopRowDetector(), backgrounds, angles, size=64, backgrounds_per_view=2
    )
    both = heat([0, 1], [0.0, 20.0])
    apart = [heat([pose], [angle]) for pose in (0, 1) for angle in (0.0, 20.0)]
    assert not np.allclose(apart[0], apart[3])
    assert np.allclose(both, np.mean(apart, axis=0), atol=1e-7)


def test_pick_takes_the_asked_share_of_the_area():
    bodies = box_bodies(1)
    heat = np.random.default_rng(0).uniform(0.1, 1, FACES).astype(np.float32)
    areas = face_areas(bodies)
    for share in (0.05, 0.2, 0.7, 1.0):
        ids = pick(heat, bodies, share)
        assert ids.dtype == np.int64 and (np.diff(ids) > 0).all()
        assert areas[ids].sum() / areas.sum() == pytest.approx(share, abs=areas.max() / areas.sum())
        others = np.setdiff1d(np.arange(FACES), ids)
        density = heat / areas
        assert not len(others) or density[ids].min() >= density[others].max()


def test_pick_leaves_out_what_was_never_seen():
    heat = np.zeros(FACES, np.float32)
    heat[:5] = 1
    assert list(pick(heat, box_bodies(1), 1.0)) == [0, 1, 2, 3, 4]


def test_bad_input():
    bodies = box_bodies(1)
    with pytest.raises(InputError, match="--pick"):
        pick(np.ones(FACES, np.float32), bodies, 0.0)
    with pytest.raises(InputError, match="--pick"):
        pick(np.ones(FACES, np.float32), bodies, float("nan"))
    with pytest.raises(InputError, match="3 faces"):
        pick(np.ones(3, np.float32), bodies, 0.5)
    with pytest.raises(InputError, match="zero everywhere"):
        pick(np.zeros(FACES, np.float32), bodies, 0.5)
    with pytest.raises(InputError, match="not finite"):
        heatmap(bodies, BrokenDetector(0), noise_backgrounds(), [0.0], size=64)
    black_box = TinyDetector()
    black_box.differentiable = False
    with pytest.raises(InputError, match="no gradients"):
        heatmap(bodies, black_box, noise_backgrounds(), [0.0])
