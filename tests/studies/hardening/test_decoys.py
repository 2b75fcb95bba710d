"""Decoys: cloth where nobody is, in the picture's frame, off the people in it, and never twice the same."""

from itertools import repeat

import numpy as np
import pytest
import torch

from cloak_core.studies.hardening.decoys import TEXTURE, draw_decoy, random_texture

SIZE = 96
GREY = torch.full((3, SIZE, SIZE), 0.5)


def red() -> np.ndarray:
    texture = np.zeros((3, TEXTURE, TEXTURE), np.float32)
    texture[0] = 1
    return texture


def test_a_decoy_changes_a_part_of_the_picture_and_depends_on_the_draw_alone() -> None:
    drawn = [draw_decoy(GREY, repeat(red()), np.random.default_rng(seed)) for seed in range(12)]
    changed = [float((one != GREY).any(0).float().mean()) for one in drawn]
    assert sum(share > 0.01 for share in changed) >= 10 and min(changed) < 0.5
    assert all(0 <= one.min() and one.max() <= 1 for one in drawn)
    assert torch.equal(drawn[3], draw_decoy(GREY, repeat(red()), np.random.default_rng(3)))
    assert not torch.equal(drawn[3], drawn[4])
    # Cloth is red in the picture's own light, wherever it lies.
    cloth = drawn[3][:, (drawn[3] != GREY).any(0)]
    assert cloth[0].mean() > 0.4 and cloth[1:].max() < 0.5


def test_people_in_the_picture_are_kept_clear() -> None:
    box = [20.0, 10.0, 60.0, 90.0]
    for seed in range(30):
        shown = draw_decoy(GREY, repeat(red()), np.random.default_rng(seed), keep_clear=[box])
        hidden = (shown != GREY).any(0)[10:91, 20:61].float().mean()
        assert hidden <= 0.11


@pytest.mark.parametrize("seed", range(24))
def test_patterns_fill_their_texture(seed: int) -> None:
    texture = random_texture(np.random.default_rng(seed), lambda: torch.rand(3, 64, 48))
    assert texture.shape == (3, TEXTURE, TEXTURE) and texture.dtype == np.float32
    assert texture.min() >= 0 and texture.max() <= 1
