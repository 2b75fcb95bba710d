"""Coverage by exact area: against exact fractions, discs and many samples, also where surfaces overlap."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from bodies_made import sphere

from cloak_core.bench.oracle import screen_of, visible_shares
from cloak_core.bench.reference import matrix_of, reference
from cloak_core.core.cameras import Camera
from cloak_core.core.view import CrowdedPixels, Window
from cloak_core.core.visibility.cpu import areas as area_loops
from cloak_core.core.visibility.cpu.edge_hash import hash_corners
from cloak_core.core.visibility.cpu.pieces import find_candidates, find_pieces
from cloak_core.core.visibility.cpu.workspace import Mesh
from cloak_core.core.visibility.projection import flatten
from cloak_core.core.visibility.rasterizer import area_fragments, rasterize
from cloak_core.core.visibility.screen import GRID
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.bodies.view_cache import ViewCache

FLAT = Light(ambient=1.0, diffuse=0.0, specular=0.0)
CAMERA = Camera(distance=4.0, width=48, height=40)
SIZE = 2
Case = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""x and y in grid units, inverse_depth, triangles."""


def soup(rng: np.random.Generator, count: int = 9) -> Case:
    """Triangles that hide and pierce each other."""
    x, y = rng.integers(-GRID, (SIZE + 1) * GRID, (2, 3 * count))
    return x, y, rng.uniform(0.1, 1, 3 * count), np.arange(3 * count).reshape(-1, 3)


def level(rng: np.random.Generator) -> Case:
    """Level triangles at few depths: equal ones go to the lower id."""
    x, y, _, triangles = soup(rng)
    return x, y, np.repeat(rng.choice([0.25, 0.5, 0.75], len(triangles)), 3), triangles


def rectangles(sides: list[tuple[int, int, int, int]], rng: np.random.Generator) -> Case:
    """Level rectangles (left, top, right, bottom in quarters of pixels), each at a depth of its own."""
    x, y, triangles = [], [], []
    for left, top, right, bottom in sides:
        triangles += [[len(x), len(x) + 1, len(x) + 2], [len(x), len(x) + 2, len(x) + 3]]
        x += [left, right, right, left]
        y += [top, top, bottom, bottom]
    near = np.repeat(rng.uniform(0.1, 1, len(sides)), 4)
    return np.array(x) * (GRID // 4), np.array(y) * (GRID // 4), near, np.array(triangles)


def aligned(rng: np.random.Generator) -> Case:
    """Layers of rectangles on quarters of pixels: they overlap just as much as they leave open, or miss each other."""
    corners = rng.integers(0, 7, (9, 2)).tolist()
    return rectangles([(left, top, left + 2, top + 2) for left, top in corners], rng)


def same_again(rng: np.random.Generator) -> Case:
    """The left half of a pixel four times over, and two quarters across a corner twice: areas that add up to whole
    pixels, and in part their moments, too, where half of the pixel is empty."""
    return rectangles([(0, 0, 2, 4)] * 4 + [(4, 4, 6, 6), (6, 6, 8, 8)] * 2, rng)


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
    x, y, inverse_depth, triangles = case
    rows = torch.from_numpy(triangles.T.astype(np.int64)).contiguous()
    found = area_fragments(screen_of(x, y, inverse_depth, size, size), rows, None, Window(0, 0, size, size))
    keys = zip(found.pixel.tolist(), found.triangle.tolist(), strict=True)
    return dict(zip(keys, found.area.tolist(), strict=True))


def exact_shares(case: Case, size: int) -> dict:
    return visible_shares(*case, (size, size), GRID, False)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("make", [soup, level, aligned, same_again, slivers, folded])
def test_areas_are_those_of_exact_fractions(make: object, seed: int) -> None:
    case = make(np.random.default_rng(seed))
    exact = exact_shares(case, SIZE)
    ours = shares(case)
    assert max(abs(ours.get(key, 0.0) - float(exact.get(key, 0))) for key in {*ours, *exact}) < 1e-6
    assert sum(exact.values()) > 0.5 and min(exact.values()) < 0.2


@pytest.mark.slow
def test_dozens_of_small_pieces_in_a_pixel_are_exact() -> None:
    """Small triangles that hide and pierce each other, all in the one pixel."""
    case = small_triangles(90)
    exact = exact_shares(case, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ours = shares(case, 1)
    assert len(ours) > 45
    assert max(abs(ours.get(key, 0.0) - float(exact.get(key, 0.0))) for key in {*ours, *exact}) < 1e-6


def test_crowded_pixels_are_sampled_and_counted() -> None:
    """Beyond the bound: shares of 64 x 64 samples, and the lower id among equals."""
    case = small_triangles(5000)
    with pytest.warns(CrowdedPixels, match="1 pixels"):
        found = shares(case, 1)
    large = screen_of(case[0] * 8, case[1] * 8, case[2], 8, 8)  # 8 x 8 pixels of 8 x 8 samples: the same 64 x 64
    ids = rasterize(large, torch.from_numpy(case[3].T.copy()), 8).triangles().numpy()
    names, counts = np.unique(ids[ids >= 0], return_counts=True)
    assert found == {(0, name): count / 64**2 for name, count in zip(names.tolist(), counts.tolist(), strict=True)}
    x, y, _, triangles = small_triangles(5000)
    with pytest.warns(CrowdedPixels):
        level = shares((x, y, np.full(len(x), 0.5), np.concatenate([triangles, triangles])), 1)
    assert max(triangle for _, triangle in level) < 5000


def small_triangles(count: int) -> Case:
    rng = np.random.default_rng(7)
    x, y = (rng.uniform(0, GRID, (2, count, 1)) + rng.uniform(-0.06, 0.06, (2, count, 3)) * GRID).astype(int)
    return x.ravel(), y.ravel(), rng.uniform(0.1, 1, 3 * count), np.arange(3 * count).reshape(-1, 3)


def test_small_bands_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    case = soup(np.random.default_rng(5))
    whole = shares(case)
    monkeypatch.setattr(area_loops, "MOST_PAIRS", 2)
    assert shares(case) == whole


def test_a_thin_shell_hides_all_that_is_within() -> None:
    """A tenth of a millimetre around a sphere of 1 m, far away: nothing of the inner one is seen."""
    inner = sphere(20, 30)
    vertices = np.concatenate([inner.vertices[0], inner.vertices[0] * 1.0001])
    bodies = Bodies(
        vertices=vertices[None], triangles=np.concatenate([inner.triangles, inner.triangles + inner.vertex_count])
    )
    for camera in (CAMERA, replace(CAMERA, distance=12.0), replace(CAMERA, distance=50.0)):
        view = matrix_of(ViewCache(bodies, RenderSettings(light=FLAT)).view(0, camera), bodies.face_count)
        hidden = view.weight[view.face < inner.triangle_count].double().sum()
        assert float(hidden / view.weight.double().sum()) < 1e-6
        assert view.coverage.max() < 1 + 1e-6 and view.coverage.sum() > 1


def test_a_disc_has_its_area_and_inner_pixels_are_full() -> None:
    bodies, camera = sphere(40, 60), replace(CAMERA, width=80, height=80)
    view = ViewCache(bodies, RenderSettings(light=FLAT)).view(0, camera)
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
    ours = matrix_of(ViewCache(bodies, RenderSettings(light=FLAT)).view(0, camera), bodies.face_count)
    exact = reference(bodies, camera, FLAT).matrix
    zeros = torch.zeros(len(ours.coverage), bodies.face_count, dtype=torch.float64)
    dense = lambda m: zeros.index_put((m.pixel, m.face), m.weight.double(), accumulate=True)
    assert (ours.coverage - exact.coverage).abs().max() < 1e-6
    assert (dense(ours) - dense(exact)).abs().max() < 1e-6 and exact.coverage.sum() > 20


def test_light_is_that_of_what_is_seen() -> None:
    """One light for each piece, at the centroid of what is seen of it, is close to the light's integral."""
    bodies, camera, light = sphere(20, 30), replace(CAMERA, distance=3.0), Light(position=(1.0, 2.0, 3.0))
    ours = matrix_of(ViewCache(bodies, RenderSettings(light=light)).view(0, camera), bodies.face_count)
    exact = reference(bodies, camera, light).matrix
    colors, black = torch.rand(bodies.face_count, 3), torch.zeros(48 * 40, 3)
    assert (ours.image(colors, black) - exact.image(colors, black)).square().mean().sqrt() < 5e-4


def test_nothing_seen_is_an_empty_view() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        away = replace(CAMERA, pivot=(90.0, 0.0, 0.0))
        assert len(ViewCache(sphere(14, 20), RenderSettings(light=FLAT)).view(0, away).pixels) == 0


def test_triangles_that_fill_the_screen_are_dropped_before_they_are_stored() -> None:
    """Of 200 level layers over all of the image, in any order, hardly more than one is ever held."""
    count, size = 200, 24
    x, y = (np.tile(np.array(corners) * size * GRID, count) for corners in ([-1, 3, -1], [-1, -1, 3]))
    depth = np.repeat(np.random.default_rng(0).permutation(count) / 250 + 0.1, 3)
    screen, window = screen_of(x, y, depth, size, size), Window(0, 0, size, size)
    triangles = torch.arange(3 * count).view(-1, 3).T.contiguous()
    arrays = flatten(screen, triangles, 0).arrays()
    candidates = find_candidates(arrays[0], arrays[1], arrays[3], arrays[5], 0, size, 0, size)
    mesh, most = Mesh(*arrays[:5], hash_corners(*arrays[:2])), int(candidates[-1].sum())
    held = len(find_pieces(mesh, candidates, 0, size, 0, size, most)[0])
    found = area_fragments(screen, triangles, None, window)
    assert held <= 2 * size * size
    assert (found.triangle == int(depth[::3].argmax())).all() and found.area.sum() == size * size
