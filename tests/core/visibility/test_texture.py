"""Textures: looked up point by point when a view is built, constant ever after."""

import numpy as np
import pytest
import torch

from cloak_core.core.cameras import Camera
from cloak_core.core.paint import compose
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.core.visibility.texture import look_up
from cloak_core.sources.bodies.meshes.subdivision import subdivide
from cloak_core.sources.bodies.meshes.textures import dress_in_textures
from cloak_core.sources.bodies.view_cache import ViewCache
from tests.sources.bodies.solids import sheet

FLAT = Light(ambient=1.0, diffuse=0.0, specular=0.0)
SIDE = 64


def ramp() -> np.ndarray:
    """Red grows to the right, green upwards."""
    rise = (np.arange(256) + 0.5) / 256 * 255
    right, up = np.broadcast_to(rise, (256, 256)), np.broadcast_to(rise[::-1, None], (256, 256))
    return np.rint(np.stack([right, up, np.full((256, 256), 100.0)], axis=-1)).astype(np.uint8)


def render(cache: ViewCache, camera: Camera, logo: np.ndarray, outfit: int = 0) -> np.ndarray:
    view = cache.bake(0, camera, logo, outfit)
    black = torch.zeros(1, 3, camera.height, camera.width)
    return compose([view], torch.full((len(logo), 3), 0.25), black)[0].permute(1, 2, 0).numpy()


@pytest.mark.parametrize("samples", [None, 1, 16])
@pytest.mark.parametrize(("count", "slant"), [(2, 0.0), (2, 50.0), (40, 0.0), (100, 30.0)])
def test_a_ramp_is_seen_as_a_ramp(samples: int | None, count: int, slant: float) -> None:
    """Faces larger and smaller than a pixel, in perspective: every pixel shows what the picture says at its middle."""
    bodies = dress_in_textures(sheet(count), {"ramp": ramp()})
    camera = Camera(distance=1.5, elevation=0.0, azimuth=slant, width=SIDE, height=SIDE)
    image = render(ViewCache(bodies, RenderSettings(light=FLAT, samples=samples)), camera, np.array([0]))
    at = (np.arange(SIDE) + 0.5 - SIDE / 2) / camera.focal
    # Where the ray through each pixel meets the sheet z = 0, seen from the side by `slant` degrees.
    depth = 1.5 / (1 + at * np.tan(np.radians(slant)))
    u, v = at * depth / np.cos(np.radians(slant)) + 0.5, -at[:, None] * depth + 0.5
    u = np.broadcast_to(u, v.shape)
    edge, logo = 0.06, 1 / count + 0.06
    inside = (np.minimum(u, v) > edge) & (np.maximum(u, v) < 1 - edge) & (np.maximum(u, v) > logo)
    assert inside.sum() > 300
    assert np.abs(image[..., 0] - u)[inside].max() < 0.015
    assert np.abs(image[..., 1] - v)[inside].max() < 0.015
    assert np.abs(image[..., 2] - 100 / 255)[inside].max() < 0.003
    on_logo = (np.minimum(u, v) > edge) & (np.maximum(u, v) < 1 / count - edge)
    assert np.allclose(image[on_logo], 0.25, atol=1e-5), "the logo's faces override the texture"


def test_polygons_and_their_subdivision_show_the_same_picture() -> None:
    bodies = dress_in_textures(sheet(6), {"ramp": ramp()})
    finer, parent = subdivide(bodies, 2)
    assert np.allclose(finer.face_colors[0][parent == 0].mean(axis=0), bodies.face_colors[0, 0], atol=0.01)
    camera = Camera(distance=1.5, elevation=0.0, width=SIDE, height=SIDE)
    coarse, fine = (
        render(ViewCache(b, RenderSettings(light=FLAT)), camera, np.flatnonzero(p == 0))
        for b, p in ((bodies, np.arange(36)), (finer, parent))
    )
    assert np.abs(coarse - fine).max() < 0.02


def test_look_up_is_linear_between_texels_and_repeats() -> None:
    picture = torch.tensor([[[0, 0, 0], [255, 0, 0]], [[0, 255, 0], [255, 255, 0]]], dtype=torch.uint8)
    uv = torch.tensor([[0.25, 0.5, 0.75, 1.25, -0.5], [0.75, 0.75, 0.25, 1.75, 0.5]])
    seen = look_up(picture, uv)
    expected = [[0, 0, 0], [0.5, 0, 0], [1, 1, 0], [0, 0, 0], [0.5, 0.5, 0]]
    assert torch.allclose(seen, torch.tensor(expected))
