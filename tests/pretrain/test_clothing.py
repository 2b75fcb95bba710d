import numpy as np
import pytest

from cloak_core.sources.bodies.people.skeleton import Pose
from tools.pretrain.clothing.draping import outside
from tools.pretrain.clothing.gaits import CYCLES

GRID = np.array([[4 * i + j, 4 * i + 4 + j, 4 * i + 5 + j, 4 * i + 1 + j] for i in range(3) for j in range(3)])
"""Quads of a square sheet of 4 x 4 vertices."""


def angles(pose: Pose) -> np.ndarray:
    limbs = (pose.left_leg, pose.right_leg, pose.left_arm, pose.right_arm)
    return np.array([value for limb in limbs for value in vars(limb).values()], float)


@pytest.mark.parametrize("motion", CYCLES)
def test_a_cycle_ends_where_it_begins_and_never_jumps(motion: str) -> None:
    poses = np.stack([angles(CYCLES[motion](phase)) for phase in np.linspace(0, 1, 97)])
    assert np.allclose(poses[0], poses[-1])
    assert np.abs(np.diff(poses, axis=0)).max() < 10 and np.ptp(poses, axis=0).max() > 5


def test_cloth_is_pushed_out_of_what_is_beneath_it_and_no_farther() -> None:
    flat = np.stack([*np.meshgrid(np.arange(4.0), np.arange(4.0), indexing="ij"), np.zeros((4, 4))], -1).reshape(-1, 3)
    flat[:, :2] *= 0.02
    cloth = flat - np.array([0, 0, 0.01])
    cloth[5, 2] = 0.03
    pushed = outside(cloth[None], flat[None], GRID)[0]
    assert np.allclose(np.delete(pushed[:, 2], 5), 0.004) and pushed[5, 2] == 0.03
    assert np.array_equal(pushed[:, :2], cloth[:, :2])
