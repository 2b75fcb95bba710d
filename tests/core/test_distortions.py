"""Crop, margin, blur, and JPEG, each against a plain twin or an independent implementation."""

import io

import numpy as np
import pytest
import torch
from PIL import Image, ImageFilter

from cloak_core.core.distortions import Distortion, blurred, draw_window, through_jpeg, windowed
from tests.core.fakes import tiny_batcher, tiny_settings


def smooth_images(count: int = 2, size: int = 48) -> torch.Tensor:
    small = torch.rand(count, 3, 6, 6, generator=torch.Generator().manual_seed(0))
    return torch.nn.functional.interpolate(small, size=(size, size), mode="bicubic").clamp(0, 1)


def as_picture(image: torch.Tensor) -> Image.Image:
    return Image.fromarray((image * 255).round().byte().permute(1, 2, 0).numpy())


@pytest.mark.parametrize("quality", [20, 50, 90])
def test_jpeg_is_what_libjpeg_does(quality: int):
    images = smooth_images(1) + 0.05 * torch.randn(1, 3, 48, 48, generator=torch.Generator().manual_seed(1))
    images = (images.clamp(0, 1) * 255).round() / 255
    file = io.BytesIO()
    as_picture(images[0]).save(file, "JPEG", quality=quality, subsampling=0)
    expected = torch.from_numpy(np.array(Image.open(file))).permute(2, 0, 1) / 255
    ours = through_jpeg(images, torch.tensor([float(quality)]))[0]
    change = (expected - images[0]).abs().mean()
    # libjpeg rounds to bytes before the transform, so that here and there a coefficient rounds the other way.
    assert (ours - expected).abs().mean() < 0.35 * change


def test_jpeg_of_sizes_that_blocks_do_not_fill_and_its_gradient():
    images = smooth_images(2, 45).requires_grad_()
    out = through_jpeg(images, torch.tensor([10.0, 95.0]))
    assert out.shape == images.shape
    assert (out[0] - images[0]).abs().mean() > 2 * (out[1] - images[1]).abs().mean()
    out.sum().backward()
    assert torch.isfinite(images.grad).all() and images.grad.abs().mean() > 0.5


def test_blur_is_a_gaussian():
    images = smooth_images()
    soft = blurred(images, torch.tensor([0.0, 1.0]))
    torch.testing.assert_close(soft[0], images[0])
    expected = np.array(as_picture(images[1]).filter(ImageFilter.GaussianBlur(1))) / 255
    assert np.abs(soft[1].permute(1, 2, 0).numpy() - expected)[4:-4, 4:-4].max() < 0.02


@pytest.mark.parametrize("window", [None, (0.8, 0.1, -0.15), (1.4, -0.3, 0.2)])
def test_boxes_move_with_the_images(window):
    images, box = torch.full((1, 3, 80, 60), 0.5), torch.tensor([[21.0, 30.0, 40.0, 52.0]])
    images[:, :, 30:52, 21:40] = 1
    distortion = Distortion(None if window is None else torch.tensor([window]))
    seen = (distortion(images)[0, 0] > 0.75).nonzero()
    expected = [seen[:, 1].min(), seen[:, 0].min(), seen[:, 1].max() + 1, seen[:, 0].max() + 1]
    assert (distortion.boxes(box, 80, 60)[0] - torch.tensor(expected)).abs().max() <= 0.75


def test_a_window_crops_or_leaves_a_margin():
    images = smooth_images(2)
    crop = torch.tensor([[0.5, 0.5, -0.5]]).expand(2, 3)  # the upper right quarter
    quarter = torch.nn.functional.interpolate(images[:, :, :24, 24:], size=48, mode="bilinear", align_corners=False)
    torch.testing.assert_close(windowed(images, crop)[:, :, 3:-3, 3:-3], quarter[:, :, 3:-3, 3:-3], atol=2e-3, rtol=0)
    margin = windowed(images, torch.tensor([[2.0, -1.0, -1.0]]).expand(2, 3))  # the image in the lower right quarter
    assert (margin[:, :, :23] == 0.5).all() and (margin[:, :, :, :23] == 0.5).all()
    small = torch.nn.functional.avg_pool2d(images, 2)
    torch.testing.assert_close(margin[:, :, 25:, 25:], small[:, :, 1:, 1:], atol=2e-3, rtol=0)


@pytest.mark.parametrize(("crop", "pad"), [(0.4, 0.0), (0.0, 0.4), (0.4, 0.4)])
def test_drawn_windows_stay_within_or_around_the_image(crop: float, pad: float):
    drawn = [draw_window(np.random.default_rng(seed), crop, pad) for seed in range(60)]
    for side, x, y in drawn:
        assert 1 - crop <= side <= 1 / (1 - pad) and max(abs(x), abs(y)) <= abs(1 - side)
    assert {side < 1 for side, *_ in drawn} == {here for here, share in ((True, crop), (False, pad)) if share}


def batch_of(**changes) -> tuple[torch.Tensor, torch.Tensor]:
    """A batch's images of a grey logo, and their gradient's length on each face."""
    batcher = tiny_batcher(tiny_settings(noise=0.0, contrast="1", brightness="0", **changes))
    colors = torch.full((batcher.pattern.count, 3), 0.9, requires_grad=True)
    images = batcher.batch(0).images(colors)
    images.sum().backward()
    return images.detach().clone(), colors.grad.abs().sum(1)


@pytest.mark.parametrize("changes", [{"cutout": 0.9}, {"crop": 0.5}, {"pad": 0.5}, {"blur": 1.5}], ids=str)
def test_what_is_switched_on_changes_images_and_is_drawn_by_seed_and_step(changes: dict):
    plain, own = batch_of()
    images, gradient = batch_of(**changes)
    assert not torch.allclose(plain, images)
    assert torch.equal(batch_of(**changes)[0], images)
    assert not torch.equal(batch_of(seed=1, **changes)[0], images)
    assert (gradient.sum() < 0.9 * own.sum()) == ("cutout" in changes or "pad" in changes)


def test_cut_out_faces_are_grey_and_stand_together():
    batcher = tiny_batcher(tiny_settings(cutout=1.0, batch=8, noise=0.0))
    hidden = batcher.batch(0).hidden.numpy()
    assert len({row.sum() for row in hidden}) > 3
    centres = batcher.pattern.centres
    for row in hidden[hidden.any(1) & ~hidden.all(1)]:
        apart = np.linalg.norm(centres[row][:, None] - centres[~row][None], axis=2)
        within = np.linalg.norm(centres[row][:, None] - centres[row][None], axis=2)
        # A ball about one of its faces.
        assert (within.max(1) <= np.sort(apart, axis=1)[:, 0] + 1e-9).any()
