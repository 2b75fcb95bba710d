"""The loops that the CPU runs against the torch operations that other devices run: the same views."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest
import torch
from bodies_made import soup, sphere

from cloak_core.core.cameras import Camera
from cloak_core.core.logo import Cover
from cloak_core.core.visibility.compiled import torch_alone
from cloak_core.core.visibility.rasterizer import rasterize
from cloak_core.core.visibility.screen import GRID, GUARD
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.patterns.cloth import ClothPattern, Grid
from cloak_core.sources.bodies.view_cache import ViewCache

CAMERA = Camera(distance=2.6, azimuth=20.0, width=45, height=37)
SHINY = Light(ambient=0.4, diffuse=0.5, specular=0.6, shininess=7.0, position=(2.0, 1.0, 3.0))


def two_bodies(sides: int = 1) -> Bodies:
    """A sphere before part of a larger, finer one; faces of up to `sides` triangles, two poses."""
    near, far = sphere(9, 14, 0.5), sphere(26, 40, 0.9)
    vertices = np.concatenate([near.vertices[0] + [0.3, 0.1, 0.9], far.vertices[0]])
    triangles = np.concatenate([near.triangles, far.triangles + len(near.vertices[0])])
    turned = vertices @ np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]])
    face = np.arange(len(triangles)) // sides
    return Bodies(vertices=np.stack([vertices, turned]), triangles=triangles, triangle_face=face)


def textured() -> Bodies:
    body = two_bodies()
    rng = np.random.default_rng(5)
    uv = rng.uniform(0, 1, (body.triangle_count * 3, 2)).astype(np.float32)
    corner = np.arange(body.triangle_count * 3).reshape(-1, 3)
    return replace(
        body,
        uv=uv,
        triangle_uv=corner,
        textures={"t": rng.integers(0, 256, (16, 16, 3)).astype(np.uint8)},
        outfit_textures=("t",),
    )


def dense(cache: ViewCache, pose: int, camera: Camera) -> dict[str, torch.Tensor]:
    """A view's numbers where no order or rounding away of nothing can hide or pretend a difference."""
    view = cache.view(pose, camera)
    rows = torch.repeat_interleave(view.pixels, view.map.crow.diff())
    size = camera.width * camera.height
    spread = lambda index, values, count: torch.zeros(count).double().index_add_(0, index, values.double())
    key = rows * cache.bodies.face_count + view.map.column
    result = {
        "weight": spread(key, view.map.weight, size * cache.bodies.face_count),
        "coverage": spread(view.pixels, view.coverage, size),
        "specular": spread(view.pixels, view.specular, size),
    }
    if view.uv is not None:
        result |= {
            f"uv{i}": spread(key, row * view.map.weight, size * cache.bodies.face_count)
            for i, row in enumerate(view.uv)
        }
    return result


@pytest.mark.slow
@pytest.mark.parametrize("samples", [1, 4, 16, 64, None])
@pytest.mark.parametrize(
    "body,camera",
    [
        (two_bodies(), CAMERA),
        (two_bodies(2), replace(CAMERA, elevation=30.0)),
        (two_bodies(3), replace(CAMERA, distance=1.5, near=0.4)),  # cut by the near plane
        (two_bodies(2), replace(CAMERA, distance=9.0)),
        (textured(), CAMERA),
    ],
)
def test_views(samples: int | None, body: Bodies, camera: Camera) -> None:
    ours = ViewCache(body, RenderSettings(light=SHINY, samples=samples))
    with torch_alone():
        theirs = ViewCache(body, RenderSettings(light=SHINY, samples=samples))
        expected = [dense(theirs, pose, camera) for pose in range(2)]
    for pose, other in enumerate(expected):
        mine = dense(ours, pose, camera)
        assert mine.keys() == other.keys() and ("uv0" in mine) == bool(body.textures)
        assert mine["coverage"].sum() > 5 and mine["specular"].sum() > 0
        for name, values in other.items():
            np.testing.assert_allclose(mine[name], values, atol=2e-6, rtol=0, err_msg=name)


@pytest.mark.parametrize("samples", [4, None])
def test_places_on_a_cloth(samples: int | None) -> None:
    """Loops and torch agree on where entries lie on a cloth, how far they reach, and which squares they show."""
    body = two_bodies()
    cloth = ClothPattern(Cover(np.arange(body.face_count), body.topology), Grid.of(0.25, 0.02))
    seen = []
    for context in (contextlib.nullcontext(), torch_alone()):
        with context:
            cache = ViewCache(body, RenderSettings(light=SHINY, samples=samples), on_cloth=True)
            view = cache.bake(0, CAMERA, cloth.cover.face_ids)
            seen.append((view, view.map @ cloth.map(view.places, (0.013, 0.1))))
    (ours, ours_worn), (theirs, theirs_worn) = seen
    assert len(ours.map) == len(ours.places) == len(theirs.places) > 100
    for name in ("face", "at", "extent"):
        torch.testing.assert_close(getattr(ours.places, name), getattr(theirs.places, name), rtol=0, atol=5e-6)
    assert (ours.places.extent >= 0).all() and float(ours.places.extent.max()) > 0.001
    colors = torch.rand(cloth.count, 3)
    torch.testing.assert_close(ours_worn.apply(colors), theirs_worn.apply(colors), rtol=0, atol=1e-4)
    torch.testing.assert_close(ours_worn.row_sums(), ours.map.row_sums(), rtol=0, atol=1e-5)


@pytest.mark.parametrize("extent", [0, 3 * GRID, 600 * GRID, GUARD // 2])
@pytest.mark.parametrize("grid", [1, 2, 8])
def test_keys_are_the_same_bits(extent: int, grid: int) -> None:
    """Depth and triangle of every sample, from triangles inside the image to ones too large for float64."""
    screen, triangles = soup(extent + grid, extent, 90, (13, 9))
    for cull in (False, True):
        ours = rasterize(screen, triangles, grid, torch.tensor([cull]))
        with torch_alone():
            theirs = rasterize(screen, triangles, grid, torch.tensor([cull]))
        assert torch.equal(ours.packed, theirs.packed)
        assert (ours.triangles() >= 0).any()
