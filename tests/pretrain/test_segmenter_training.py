"""The patch segmenter's training: its images, its loss, and a file that loads."""

from pathlib import Path

import pytest
import torch

from cloak_core.detectors.defended.masking import SIDE, PatchSegmenter, load_segmenter
from cloak_core.files.errors import InputError
from tools.pretrain.segmenter_training import SegmenterSettings, Shown, loss, train_segmenter


@pytest.mark.slow
def test_masks_lie_on_the_cloak_and_on_pasted_patches_alone() -> None:
    bare = Shown(SegmenterSettings(batch=2, patched=0.0)).batch(0)
    patched = Shown(SegmenterSettings(batch=2, patched=1.0)).batch(0)
    images, masks = bare
    assert images.shape == (3, 3, SIDE, SIDE) and masks.shape == (3, 1, SIDE, SIDE)
    assert masks[:2].any() and not masks[2].any()  # the last one wears its own clothes
    added = patched[1] & ~masks
    assert added.flatten(1).any(1).all()
    changed = (patched[0] != images).any(1, keepdim=True)
    assert not (changed & ~patched[1]).any()


def test_the_loss_is_least_for_what_the_mask_says() -> None:
    masks = torch.zeros(1, 1, 32, 32, dtype=torch.bool)
    masks[:, :, 8:24, 8:16] = True
    right = torch.where(masks[:, :, ::4, ::4], 8.0, -8.0)
    assert float(loss(right, masks)) < 0.05 < float(loss(torch.zeros_like(right), masks))
    assert float(loss(-right, masks)) > float(loss(torch.zeros_like(right), masks))


@pytest.mark.slow
def test_what_is_written_loads_and_says_what_it_is_worth(tmp_path: Path) -> None:
    path = tmp_path / "own.safetensors"
    result = train_segmenter(path, steps=1, batch=2, judged=1)
    assert 0 <= result["found"] <= 1 and 0 <= result["clean"] <= 1
    network = load_segmenter(path)
    assert isinstance(network, PatchSegmenter) and not network.training
    assert network(torch.rand(1, 3, 100, 120)).shape[1] == 1


def test_another_networks_weights_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.safetensors"
    path.write_bytes(b"\x00" * 64)
    with pytest.raises(InputError, match="not the weights of a patch segmenter"):
        load_segmenter(path)
