"""The references themselves: areas worked out by hand, and 64 x 64 samples; the light in both precisions."""

import numpy as np
import pytest
import torch

from cloak_core.bench import exact, reference
from cloak_core.bench.growth import sphere
from cloak_core.bench.oracle import screen_of
from cloak_core.bench.polygons import Polygons, cut
from cloak_core.exchange.bodies import Bodies
from cloak_core.render.visibility.projection import GRID
from cloak_core.render.weights.shading import Light
from cloak_core.scene.cameras import Camera


def seen(corners: list, nearness: list, cull: bool = False, size: int = 8) -> dict[int, float]:
    """Pixels of each triangle that are seen; triangles given by corners in pixels, [T, 3, 2]."""
    x, y = (np.asarray(corners, float).reshape(-1, 2).T * GRID).astype(int)
    triangles = torch.arange(len(x)).view(-1, 3).T
    found = exact.seen_areas(screen_of(x, y, np.ravel(nearness), size, size), triangles, cull)
    areas = torch.zeros(triangles.shape[1], dtype=torch.float64).index_add_(0, found.triangle, found.area)
    assert (found.area <= 1 + 1e-12).all()
    return {i: float(a) for i, a in enumerate(areas)}


FAR, NEAR = [[0, 0], [8, 0], [0, 8]], [[1, 1], [3, 1], [1, 3]]


def test_a_near_triangle_hides_what_is_behind_it() -> None:
    assert seen([FAR, NEAR], [[0.2] * 3, [0.5] * 3]) == pytest.approx({0: 30.0, 1: 2.0}, abs=1e-12)
    assert seen([FAR, NEAR], [[0.5] * 3, [0.2] * 3]) == pytest.approx({0: 32.0, 1: 0.0}, abs=1e-12)


def test_two_hide_the_same_part_once() -> None:
    near = [[1.3, 1], [3.3, 1], [1.3, 3]]
    areas = seen([FAR, NEAR, near], [[0.2] * 3, [0.5] * 3, [0.6] * 3])
    assert sum(areas.values()) == pytest.approx(32.0, abs=1e-9) and areas[2] == pytest.approx(2.0, abs=1e-9)
    assert areas[1] == pytest.approx(2.0 - 1.7**2 / 2, abs=1e-4)  # 1.3 px lie between two grid steps


def test_triangles_that_pierce_each_other_are_cut_along_their_line() -> None:
    """One slants from 0.2 to 0.6 over eight pixels, the other lies level at 0.4: they meet at x = 4."""
    areas = seen([FAR, FAR], [[0.2, 0.6, 0.2], [0.4] * 3])
    assert areas == pytest.approx({0: 8.0, 1: 24.0}, abs=1e-9)


def test_equal_ones_go_to_the_lower_and_backs_can_be_dropped() -> None:
    assert seen([FAR, FAR], [[0.4] * 3] * 2) == pytest.approx({0: 32.0, 1: 0.0}, abs=1e-9)
    assert seen([FAR, FAR[::-1]], [[0.4] * 3] * 2, cull=True) == pytest.approx({0: 0.0, 1: 32.0}, abs=1e-9)
    assert seen([], []) == {}


def test_too_many_overlaps_are_out_of_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exact, "MAX_PAIRS", 3)
    found = reference.reference(sphere(200), Camera(width=8, height=8), Light())
    assert found.how == reference.SAMPLED


def test_polygons_are_cut_and_measured() -> None:
    square = Polygons(
        *(torch.tensor(t).double().view(4, 1) for t in ([0.0, 2, 2, 0], [0.0, 0, 2, 2])), torch.tensor([4])
    )
    assert [float(t) for t in square.measure()] == [4.0, 4.0, 4.0]
    half = cut(
        square.take(torch.tensor([0, 0])), torch.stack([square.x[:, 0] - 1, square.x[:, 0] + square.y[:, 0] - 3], 1)
    )
    assert half.measure()[0].tolist() == [2.0, 0.5] and half.size.tolist() == [4, 3]


@pytest.mark.slow
@pytest.mark.parametrize(("distance", "near"), [(3.0, None), (1.2, 0.7), (20.0, None)])
def test_exact_areas_equal_very_many_samples(distance: float, near: float | None) -> None:
    """A ball with a smaller one half inside it: they hide and pierce each other, and the near plane cuts them open."""
    ball = sphere(300, 0.8)
    vertices = np.concatenate([ball.vertices, ball.vertices * 0.5 + [0.5, 0.1, 0.3]], 1)
    bodies = Bodies(vertices=vertices, triangles=np.concatenate([ball.triangles, ball.triangles + ball.vertex_count]))
    camera, light = Camera(distance=distance, near=near, width=24, height=24), Light(position=(1.0, 2.0, 3.0))
    a, b = (make(bodies, camera, light) for make in (reference.exact, reference.sampled))
    finer = reference.exact(bodies, camera, light, parts=2)
    assert (a.matrix.coverage - finer.matrix.coverage).abs().max() < 1e-3
    assert (a.visible - finer.visible).abs().max() < 1e-3
    colors = torch.rand(bodies.face_count, 3, generator=torch.Generator().manual_seed(0))
    black = torch.zeros(24 * 24, 3)
    assert (a.matrix.coverage - b.matrix.coverage).abs().max() < 0.01
    assert (a.matrix.image(colors, black) - b.matrix.image(colors, black)).abs().max() < 0.01
    assert (a.visible - b.visible).abs().max() < 0.02 and a.visible.sum() > 1
