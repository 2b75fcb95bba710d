"""Coverage by exact area: the clipping formula against a polygon clipper, whole views against many samples."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from bodies_made import sphere

from cloak_core.bench.reference import matrix_of, reference
from cloak_core.exchange.bodies import Bodies
from cloak_core.render.area import overlaps
from cloak_core.render.shading import Light
from cloak_core.render.views import ViewBank
from cloak_core.scene.cameras import Camera

FLAT = Light(ambient=1.0, diffuse=0.0, specular=0.0)
CAMERA = Camera(distance=4.0, width=48, height=40)


def polygon_area_in_square(triangle: np.ndarray) -> float:
    """Sutherland-Hodgman against the unit square, then the shoelace formula."""
    polygon = list(triangle)
    for axis, bound, sign in ((0, 0, 1), (0, 1, -1), (1, 0, 1), (1, 1, -1)):
        clipped = []
        for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True):
            da, db = sign * (a[axis] - bound), sign * (b[axis] - bound)
            if da >= 0:
                clipped.append(a)
            if (da >= 0) != (db >= 0):
                clipped.append(a + (b - a) * da / (da - db))
        polygon = clipped
    if len(polygon) < 3:
        return 0.0
    x, y = np.array(polygon).T
    return abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2


@pytest.mark.parametrize("spread", [0.3, 1.0, 5.0, 200.0])
def test_overlaps_equal_a_polygon_clipper(spread: float) -> None:
    rng = np.random.default_rng(int(spread * 10))
    corners = rng.normal(0.5, spread, (400, 3, 2))
    corners[:60] = np.round(corners[:60] * 2) / 2  # corners and edges on the square's own
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    back = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] < 0
    corners[back] = corners[back][:, ::-1]
    x, y = (list(torch.from_numpy(corners[..., axis].T.copy())) for axis in (0, 1))
    width, height = (torch.from_numpy(rng.integers(1, 4, 400)) for _ in range(2))
    ours = np.zeros((400, 3, 3))
    for owner, row, column, area in overlaps(x, y, width, height):
        ours[owner, row, column] = area
    for index, triangle in enumerate(corners):
        for row, column in np.ndindex(int(height[index]), int(width[index])):
            expected = polygon_area_in_square(triangle - [column, row])
            assert abs(ours[index, row, column] - expected) < 1e-9
    assert ours.max() > 0.05 and ((ours[:, 1:, 1:] > 0.05).any() or spread < 1)


def test_a_disc_has_its_area_and_inner_pixels_are_full() -> None:
    bodies, camera = sphere(40, 60), replace(CAMERA, width=80, height=80)
    view = ViewBank(bodies, FLAT).view(0, camera)
    radius = camera.focal / np.sqrt(4.0**2 - 1)
    assert abs(float(view.coverage.sum()) / (np.pi * radius**2) - 1) < 3e-3
    y, x = np.divmod(view.pixels.numpy(), 80)
    inner = np.hypot(x + 0.5 - 40, y + 0.5 - 40) < radius - 2
    assert (view.coverage.numpy()[inner] > 1 - 1e-6).all() and inner.sum() > 500
    assert view.coverage.max() < 1 + 1e-6


@pytest.mark.parametrize("distance", [2.0, 4.0, 12.0])
def test_views_equal_very_many_samples(distance: float) -> None:
    """Nothing hides anything on a sphere, so every face's share is exact: the reference's own error is what is left."""
    bodies, camera = sphere(14, 20), replace(CAMERA, distance=distance)
    ours = matrix_of(ViewBank(bodies, FLAT).view(0, camera), bodies.face_count)
    exact = reference(bodies, camera, FLAT).matrix
    share = lambda m: torch.zeros(bodies.face_count).double().index_add_(0, m.face, m.weight.double())
    np.testing.assert_allclose(share(ours), share(exact), rtol=2e-3, atol=0.02)
    assert (ours.coverage - exact.coverage).abs().max() < 0.02
    seen = share(exact) > 0.02
    assert (share(ours)[seen] > 0).all() and seen.any()


def test_what_is_hidden_is_judged_by_samples() -> None:
    """A near square before a far one, at uneven places: shares by area up to the resolution of the samples."""
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    near = np.concatenate([square * 0.3 + 0.037, np.full((4, 1), 0.5)], 1)
    far = np.concatenate([square, np.full((4, 1), -0.5)], 1)
    triangles = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    bodies = Bodies(vertices=np.concatenate([near, far])[None], triangles=triangles)
    ours = matrix_of(ViewBank(bodies, FLAT).view(0, CAMERA), 4)
    exact = reference(bodies, CAMERA, FLAT).matrix
    assert (ours.coverage - exact.coverage).abs().max() < 0.02
    dense = lambda m: torch.zeros(len(m.coverage) * 4).double().index_add_(0, m.pixel * 4 + m.face, m.weight.double())
    assert (dense(ours) - dense(exact)).abs().max() < 0.1
    assert (dense(ours) - dense(exact)).pow(2).mean().sqrt() < 0.005


def test_bodies_cut_by_the_near_plane_and_empty_views() -> None:
    bodies = sphere(14, 20)
    camera = replace(CAMERA, distance=1.2, near=0.5)
    ours = matrix_of(ViewBank(bodies, FLAT).view(0, camera), bodies.face_count)
    exact = reference(bodies, camera, FLAT).matrix
    assert (ours.coverage - exact.coverage).abs().mean() < 0.002
    assert float(exact.coverage.sum()) > 500
    away = replace(CAMERA, pivot=(90.0, 0.0, 0.0))
    assert len(ViewBank(bodies, FLAT).view(0, away).pixels) == 0
