"""Zoom, blur, JPEG and occluders, each against a plain twin or an independent implementation."""

import io

import numpy as np
import pytest
import torch
from PIL import Image, ImageFilter

from cloak_core.attack.batches import Batcher
from cloak_core.attack.distorting import blurred, through_jpeg, zoomed
from cloak_core.attack.sampling import Sampler
from cloak_core.render.views import ViewBank
from tests.attack.fakes import box_bodies, front_logo, noise_backgrounds, tiny_settings


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


def test_zoom_is_about_the_centre():
    images = torch.zeros(2, 3, 40, 40)
    images[:, :, 15:25, 15:25] = 1
    out = zoomed(images, torch.tensor([1.0, 2.0]))
    torch.testing.assert_close(out[0], images[0], atol=1e-5, rtol=0)
    assert out[1].sum() == pytest.approx(4 * float(images[1].sum()), rel=0.02)
    assert (out[1, :, 11:29, 11:29] == 1).all() and (out[1, :, :9] == 0).all()


def batch_and_plain(**changes):
    bodies = box_bodies()
    logo = front_logo(bodies)
    result = []
    for settings in (tiny_settings(noise=0, **changes), tiny_settings(noise=0)):
        sampler = Sampler(settings, bodies.pose_count, bodies.outfit_count, 5)
        backgrounds = noise_backgrounds()
        batcher = Batcher(
            settings, sampler, ViewBank(bodies, samples=4), logo.face_ids, backgrounds, torch.device("cpu")
        )
        colors = torch.full((len(logo), 3), 0.5, requires_grad=True)
        images = batcher.batch(1).images(colors)
        images.sum().backward()
        result.append((images.detach(), colors.grad))
    return result


def test_occluders_hide_the_body_and_its_gradient():
    (images, gradient), (plain, full) = batch_and_plain(occluders=3)
    changed = (images != plain).any(1)
    assert 0.01 < changed.float().mean() < 0.6
    assert gradient.sum() < 0.98 * full.sum() and (gradient <= full + 1e-4).all()


def test_distortions_reach_the_images_and_let_the_gradient_through():
    for changes in ({"blur": 1.5}, {"jpeg": "20:40"}, {"zoom": "0.7:1.4"}):
        (images, gradient), (plain, _) = batch_and_plain(**changes)
        assert images.shape == plain.shape and not torch.allclose(images, plain, atol=0.01)
        assert (gradient != 0).any() and torch.isfinite(gradient).all()
