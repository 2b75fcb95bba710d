"""Coverage by exact area: against exact fractions, discs and many samples, also where surfaces overlap."""

import contextlib
import warnings
from dataclasses import replace

import fraction_oracle
import numpy as np
import pytest
import torch
from bodies_made import sphere

from cloak_core.bench.oracle import screen_of
from cloak_core.bench.reference import matrix_of, reference
from cloak_core.exchange.bodies import Bodies
from cloak_core.render.compiled import torch_alone
from cloak_core.render.views import ViewBank
from cloak_core.render.visibility import area_loops, areas, overlap_loops, samples, settle_loops
from cloak_core.render.visibility.areas import CrowdedPixels
from cloak_core.render.visibility.flat import flatten
from cloak_core.render.visibility.projection import GRID, Window
from cloak_core.render.weights.fragments import area_fragments
from cloak_core.render.weights.shading import Light
from cloak_core.scene.cameras import Camera

FLAT = Light(ambient=1.0, diffuse=0.0, specular=0.0)
CAMERA = Camera(distance=4.0, width=48, height=40)
SIZE = 2
Case = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""x and y in grid units, nearness, triangles."""


def soup(rng: np.random.Generator, count: int = 9) -> Case:
    """Triangles that hide and pierce each other."""
    x, y = rng.integers(-GRID, (SIZE + 1) * GRID, (2, 3 * count))
    return x, y, rng.uniform(0.1, 1, 3 * count), np.arange(3 * count).reshape(-1, 3)


def level(rng: np.random.Generator) -> Case:
    """Level triangles at few depths: equal ones go to the lower id."""
    x, y, _, triangles = soup(rng)
    return x, y, np.repeat(rng.choice([0.25, 0.5, 0.75], len(triangles)), 3), triangles


def aligned(rng: np.random.Generator) -> Case:
    """Layers of rectangles on quarters of pixels: they overlap just as much as they leave open, or miss each other."""
    x, y, triangles = [], [], []
    for _ in range(9):
        left, top = rng.integers(0, 7, 2) * (GRID // 4)
        right, bottom = left + GRID // 2, top + GRID // 2
        triangles += [[len(x), len(x) + 1, len(x) + 2], [len(x), len(x) + 2, len(x) + 3]]
        x += [left, right, right, left]
        y += [top, top, bottom, bottom]
    return np.array(x), np.array(y), np.repeat(rng.uniform(0.1, 1, 9), 4), np.array(triangles)


def same_again(rng: np.random.Generator) -> Case:
    """The left half of a pixel four times over, and two quarters across a corner twice: areas that add up to whole
    pixels, and in part their moments, too, where half of the pixel is empty."""
    half = [(0, 0, 2, 4)] * 4
    quarters = [(4, 4, 6, 6), (6, 6, 8, 8)] * 2
    x, y, near, triangles = [], [], [], []
    for left, top, right, bottom in half + quarters:
        triangles += [[len(x), len(x) + 1, len(x) + 2], [len(x), len(x) + 2, len(x) + 3]]
        x += [left, right, right, left]
        y += [top, top, bottom, bottom]
        near += [rng.uniform(0.1, 1)] * 4
    return np.array(x) * (GRID // 4), np.array(y) * (GRID // 4), np.array(near), np.array(triangles)


def folded(rng: np.random.Generator) -> Case:
    """A front and a back that hang together along an edge and lie on the same side of it."""
    side = int(rng.integers(0, 2))
    x, y = np.array([0, 2 * GRID, 0, 0]), np.array([0, 0, 3 * GRID // 4, 3 * GRID // 4])
    near = rng.uniform(0.1, 1, 4)
    near[3] = near[2] / 2
    x = SIZE * GRID - x if side else x
    return x, y, near, np.array([[0, 1, 2], [1, 0, 3]])


def slivers(rng: np.random.Generator) -> Case:
    """Strips of a hundredth of a pixel and thinner before a surface: too thin for any sample."""
    x, y, near, triangles = [-GRID, 9 * GRID, -GRID], [-GRID, -GRID, 9 * GRID], [0.1] * 3, [[0, 1, 2]]
    for _ in range(6):
        (x0, y0), (x1, y1) = rng.integers(0, SIZE * GRID, (2, 2))
        width = int(rng.choice([3, 40, 600]))
        triangles.append([len(x), len(x) + 1, len(x) + 2])
        x, y, near = [*x, x0, x1, x1 + width], [*y, y0, y1, y1 + width], [*near, *rng.uniform(0.2, 1, 3)]
    return np.array(x), np.array(y), np.array(near), np.array(triangles)


def shares(case: Case, size: int = SIZE) -> dict[tuple[int, int], float]:
    x, y, nearness, triangles = case
    rows = torch.from_numpy(triangles.T.astype(np.int64)).contiguous()
    found = area_fragments(screen_of(x, y, nearness, size, size), rows, None, Window(0, 0, size, size))
    return {
        key: share
        for *key, share in zip(found.pixel.tolist(), found.triangle.tolist(), found.area.tolist(), strict=True)
        for key in [tuple(key)]
    }


@pytest.mark.parametrize("path", ["loops", "torch"])
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("make", [soup, level, aligned, same_again, slivers, folded])
def test_areas_are_those_of_exact_fractions(make: object, seed: int, path: str) -> None:
    case = make(np.random.default_rng(seed))
    exact = fraction_oracle.seen(*case, SIZE, SIZE, GRID)
    with torch_alone() if path == "torch" else contextlib.nullcontext():
        ours = shares(case)
    assert max(abs(ours.get(key, 0.0) - float(exact.get(key, 0))) for key in {*ours, *exact}) < 1e-6
    assert sum(exact.values()) > 0.5 and min(exact.values()) < 0.2


def test_crowded_pixels_are_cut_into_cells_and_stay_exact() -> None:
    """Small triangles that hide and pierce each other, hundreds in the one pixel."""
    rng = np.random.default_rng(7)
    count = settle_loops.CROWD + 60
    x, y = (rng.uniform(0, GRID, (2, count, 1)) + rng.uniform(-0.06, 0.06, (2, count, 3)) * GRID).astype(int)
    case = x.ravel(), y.ravel(), rng.uniform(0.1, 1, 3 * count), np.arange(3 * count).reshape(-1, 3)
    with torch_alone():
        expected = shares(case, 1)
    ours = shares(case, 1)
    assert len(ours) > settle_loops.CROWD / 2
    assert max(abs(ours.get(key, 0.0) - expected.get(key, 0.0)) for key in {*ours, *expected}) < 1e-6


def test_pixels_that_are_given_up_are_counted_and_never_overfull() -> None:
    """Needles across one another before a square, in a thousandth of a pixel: thousands of parts in the one cell."""
    rng = np.random.default_rng(3)
    start, end = rng.integers(0, GRID // 40, (2, 2, 300))
    x, y = (np.stack([start[i], end[i], end[i] + 30], -1).ravel() for i in range(2))
    x, y = (np.concatenate([t, np.array(corners) * (GRID // 40)]) for t, corners in ((x, [0, 1, 0]), (y, [0, 0, 1])))
    case = x, y, np.append(rng.uniform(0.1, 1, 900), [0.05] * 3), np.arange(903).reshape(-1, 3)
    with pytest.warns(CrowdedPixels, match="1 pixels"):
        found = shares(case, 1)
    assert 1e-4 < sum(found.values()) <= 1 / 32**2


@pytest.mark.parametrize("path", ["loops", "torch"])
def test_small_bands_change_nothing(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    case = soup(np.random.default_rng(5))
    with torch_alone() if path == "torch" else contextlib.nullcontext():
        whole = shares(case)
        monkeypatch.setattr(area_loops, "MOST_PAIRS", 2)
        monkeypatch.setattr(samples, "CHUNK", 7)
        assert shares(case) == whole


def test_a_thin_shell_hides_all_that_is_within() -> None:
    """A tenth of a millimetre around a sphere of 1 m, far away: nothing of the inner one is seen."""
    inner = sphere(20, 30)
    vertices = np.concatenate([inner.vertices[0], inner.vertices[0] * 1.0001])
    bodies = Bodies(
        vertices=vertices[None], triangles=np.concatenate([inner.triangles, inner.triangles + inner.vertex_count])
    )
    for camera in (CAMERA, replace(CAMERA, distance=12.0), replace(CAMERA, distance=50.0)):
        view = matrix_of(ViewBank(bodies, FLAT).view(0, camera), bodies.face_count)
        hidden = view.weight[view.face < inner.triangle_count].double().sum()
        assert float(hidden / view.weight.double().sum()) < 1e-6
        assert view.coverage.max() < 1 + 1e-6 and view.coverage.sum() > 1


def test_a_disc_has_its_area_and_inner_pixels_are_full() -> None:
    bodies, camera = sphere(40, 60), replace(CAMERA, width=80, height=80)
    view = ViewBank(bodies, FLAT).view(0, camera)
    radius = camera.focal / np.sqrt(4.0**2 - 1)
    assert abs(float(view.coverage.sum()) / (np.pi * radius**2) - 1) < 3e-3
    y, x = np.divmod(view.pixels.numpy(), 80)
    inner = np.hypot(x + 0.5 - 40, y + 0.5 - 40) < radius - 2
    assert (view.coverage.numpy()[inner] > 1 - 1e-6).all() and inner.sum() > 500
    assert view.coverage.max() < 1 + 1e-6


def two_squares() -> Bodies:
    """A near square before a far one, at uneven places."""
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    near = np.concatenate([square * 0.3 + 0.037, np.full((4, 1), 0.5)], 1)
    far = np.concatenate([square, np.full((4, 1), -0.5)], 1)
    triangles = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    return Bodies(vertices=np.concatenate([near, far])[None], triangles=triangles)


@pytest.mark.parametrize(
    ("bodies", "camera"),
    [
        (sphere(14, 20), replace(CAMERA, distance=2.0)),
        (sphere(14, 20), replace(CAMERA, distance=12.0)),
        (sphere(14, 20), replace(CAMERA, distance=1.2, near=0.5)),
        (two_squares(), CAMERA),
    ],
    ids=["near", "far", "cut open", "squares"],
)
def test_views_are_those_of_the_reference(bodies: Bodies, camera: Camera) -> None:
    ours = matrix_of(ViewBank(bodies, FLAT).view(0, camera), bodies.face_count)
    exact = reference(bodies, camera, FLAT).matrix
    dense = lambda m: (
        torch.zeros(len(m.coverage), m.face_count)
        .double()
        .index_put_((m.pixel, m.face), m.weight.double(), accumulate=True)
    )
    assert (ours.coverage - exact.coverage).abs().max() < 1e-6
    assert (dense(ours) - dense(exact)).abs().max() < 1e-6 and exact.coverage.sum() > 20


def test_light_is_that_of_what_is_seen() -> None:
    """One light for each piece, at the centroid of what is seen of it, is close to the light's integral."""
    bodies, camera, light = sphere(20, 30), replace(CAMERA, distance=3.0), Light(position=(1.0, 2.0, 3.0))
    ours = matrix_of(ViewBank(bodies, light).view(0, camera), bodies.face_count)
    exact = reference(bodies, camera, light).matrix
    colors, black = torch.rand(bodies.face_count, 3), torch.zeros(48 * 40, 3)
    assert (ours.image(colors, black) - exact.image(colors, black)).square().mean().sqrt() < 5e-4


def test_nothing_seen_is_an_empty_view() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        away = replace(CAMERA, pivot=(90.0, 0.0, 0.0))
        assert len(ViewBank(sphere(14, 20), FLAT).view(0, away).pixels) == 0


@pytest.mark.parametrize("path", ["loops", "torch"])
def test_triangles_that_fill_the_screen_are_dropped_before_they_are_stored(path: str) -> None:
    """Of 200 level layers over all of the image, in any order, hardly more than one is ever held."""
    count, size = 200, 24
    x, y = (np.tile(np.array(corners) * size * GRID, count) for corners in ([-1, 3, -1], [-1, -1, 3]))
    depth = np.repeat(np.random.default_rng(0).permutation(count) / 250 + 0.1, 3)
    screen, window = screen_of(x, y, depth, size, size), Window(0, 0, size, size)
    triangles = torch.arange(3 * count).view(-1, 3).T.contiguous()
    flat = flatten(screen, triangles, 0)
    if path == "loops":
        arrays = flat.arrays()
        candidates = overlap_loops.find_candidates(arrays[0], arrays[1], arrays[3], arrays[5], 0, size, 0, size)
        held = len(
            overlap_loops.find_pieces(
                *arrays[:4], overlap_loops.hash_corners(*arrays[:2]), candidates, 0, size, 0, size
            )[0]
        )
    else:
        held = sum(len(part[0]) for part in areas.seen_areas(flat, window, size))
    found = area_fragments(screen, triangles, None, window)
    assert held <= 2 * size * size
    assert (found.triangle == int(depth[::3].argmax())).all() and found.area.sum() == size * size
