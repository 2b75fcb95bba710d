"""The rasterizer against its brute-force twin, on random scenes and on cases made by hand to break it."""

import numpy as np
import pytest
import torch

from cloak_core.bench.oracle import hits, screen_of, twin
from cloak_core.core.cameras import Camera
from cloak_core.core.view import Window
from cloak_core.core.visibility.compiled import torch_alone
from cloak_core.core.visibility.projection import project
from cloak_core.core.visibility.rasterizer import rasterize
from cloak_core.core.visibility.screen import DEPTH_BITS, GRID, GUARD, ID_BITS, LIMIT
from cloak_core.core.visibility.torch import sampling as torch_sampling
from cloak_core.files.errors import InputError

HALF = GRID // 2


def triangles_of(rows: object) -> torch.Tensor:
    return torch.as_tensor(np.asarray(rows, np.int64).reshape(-1, 3)).T.contiguous()


def assert_twin(screen, triangles, grids=(1, 2), cull=None) -> np.ndarray:
    for grid in grids:
        ours = rasterize(screen, triangles, grid, cull).triangles().numpy()
        np.testing.assert_array_equal(ours, twin(screen, triangles, grid, cull))
    return ours


def random_screen(rng, vertices, width, height, spread, near=0.2):
    x, y = (rng.integers(-spread, size * GRID + spread, vertices) for size in (width, height))
    return screen_of(x, y, rng.uniform(near, 1, vertices), width, height)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_random_triangles_equal_the_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    width, height = rng.integers(1, 14, 2)
    screen = random_screen(rng, 40, int(width), int(height), spread=int(rng.choice([0, GRID, 100 * GRID])))
    triangles = triangles_of(rng.integers(0, 40, (60, 3)))
    assert_twin(screen, triangles, grids=(1, 2, 4))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_corners_on_a_coarse_lattice_hit_samples_and_edges(seed: int) -> None:
    """Quarter-pixel corners put vertices and whole edges exactly on sample points."""
    rng = np.random.default_rng(100 + seed)
    x, y = rng.integers(-4, 40, (2, 60)) * (GRID // 4) + HALF * (seed % 2)
    screen = screen_of(x, y, rng.choice([0.25, 0.5, 0.75], 60), 8, 8)
    assert_twin(screen, triangles_of(rng.integers(0, 60, (150, 3))), grids=(1, 2, 4))


@pytest.mark.parametrize("extent", [600 * GRID, GUARD])
def test_triangles_too_large_for_float64_are_exact_in_int64(extent: int) -> None:
    """Long thin triangles across the image, between corners far out on either side of it."""
    rng = np.random.default_rng(3)
    start = rng.integers(-extent // 2, extent // 2, (2, 30))
    end = rng.integers(0, 6 * GRID, (2, 30)) - start
    x, y = np.concatenate([start, end, end + rng.integers(-9 * GRID, 9 * GRID, (2, 30))], 1)
    screen = screen_of(x, y, rng.uniform(0.1, 1, 90), 9, 5)
    ids = assert_twin(screen, triangles_of(np.arange(90).reshape(3, 30).T), grids=(1, 4))
    assert len(np.unique(ids)) > 5


@pytest.mark.parametrize("offset", [0, 1, HALF, HALF + 1, GRID - 1])
def test_a_lattice_of_triangles_covers_every_sample_once(offset: int) -> None:
    """Vertices on sample points, diagonals through them: no hole, no sample hit twice."""
    size = 9
    lattice = np.stack(np.meshgrid(np.arange(size), np.arange(size), indexing="xy"), -1).reshape(-1, 2)
    x, y = (lattice - 1).T * GRID + offset
    corner = np.arange(size * size).reshape(size, size)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]))
    screen = screen_of(x, y, np.full(size * size, 0.5), 6, 6)
    for rows in ([(a, b, c), (a, c, d)], [(a, d, b), (b, d, c)]):
        triangles = triangles_of(np.concatenate([np.stack(t, -1) for t in rows]))
        assert (hits(screen, triangles, 2) == 1).all()
        assert (assert_twin(screen, triangles) >= 0).all()


@pytest.mark.parametrize("width", [1, 2, 3])
def test_slivers_of_a_few_grid_steps(width: int) -> None:
    """A strip `width` grid steps wide over sample centres, split into two slivers: its samples are covered once."""
    left = 2 * GRID
    x = np.array([left, left + width, left + 7 * GRID + width, left + 7 * GRID])
    y = np.array([0, 0, 7 * GRID, 7 * GRID])
    screen = screen_of(x, y, np.array([0.2, 0.9, 0.4, 0.6]), 12, 8)
    triangles = triangles_of([[0, 1, 2], [0, 2, 3]])
    assert_twin(screen, triangles, grids=(1, 2, 4, 8))
    assert hits(screen, triangles).max() == 1
    assert (rasterize(screen, triangles).triangles() >= 0).sum() == hits(screen, triangles).sum() > 0


def test_degenerate_duplicate_and_inverted_triangles() -> None:
    screen = screen_of(
        np.array([0, 6, 0, 3]) * GRID, np.array([0, 0, 6, 3]) * GRID, np.array([0.3, 0.8, 0.5, 0.6]), 6, 6
    )
    points, lines = [[0, 0, 0], [1, 1, 2]], [[0, 1, 1], [1, 3, 2]]
    same = [[1, 2, 0], [2, 0, 1], [0, 1, 2], [0, 2, 1], [2, 1, 0], [1, 0, 2]]
    ids = assert_twin(screen, triangles_of(points + lines + same))
    assert set(np.unique(ids)) == {-1, 4}, "identical triangles, however listed, must tie: the lowest id wins"


def test_equal_depths_go_to_the_lower_id_across_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    corner = np.array([[0, 0], [8, 0], [0, 8]]) * GRID
    screen = screen_of(corner[:, 0], corner[:, 1], np.full(3, 0.5), 4, 4)
    triangles = triangles_of([[0, 1, 2]] * 50)
    monkeypatch.setattr(torch_sampling, "CHUNK", 7)
    with torch_alone():
        assert (rasterize(screen, triangles, 4).triangles() == 0).all()


def test_a_window_is_a_part_of_the_image() -> None:
    rng = np.random.default_rng(9)
    screen = random_screen(rng, 60, 20, 12, GRID)
    triangles = triangles_of(rng.integers(0, 60, (100, 3)))
    whole = rasterize(screen, triangles, 2, window=Window(0, 0, 20, 12)).triangles()
    part = rasterize(screen, triangles, 2, window=Window(3, 5, 17, 9)).triangles()
    assert torch.equal(part[:, 5:9, 3:17], whole[:, 5:9, 3:17])
    assert (part[:, :5] == -1).all() and (part[:, :, 17:] == -1).all()


def test_empty_meshes() -> None:
    nothing = screen_of(np.zeros(0), np.zeros(0), np.ones(0), 4, 3)
    assert (rasterize(nothing, triangles_of([])).triangles() == -1).all()
    points = screen_of(np.zeros(3), np.zeros(3), np.ones(3), 4, 3)
    assert (rasterize(points, triangles_of([])).triangles() == -1).all()


def test_depth_is_perspective_correct() -> None:
    """On a slanted triangle 1/z, not z, is linear on the screen."""
    x, y = np.array([0, 64, 0]) * GRID, np.array([0, 0, 64]) * GRID
    screen = screen_of(x, y, np.array([1.0, 0.1, 0.5]), 64, 64)
    visibility = rasterize(screen, triangles_of([[0, 1, 2]]))
    depth = (LIMIT - (visibility.packed[0] >> ID_BITS)).double() / (1 << DEPTH_BITS)
    row, column = torch.meshgrid(torch.arange(40).double() + 0.5, torch.arange(20).double() + 0.5, indexing="ij")
    expected = 1.0 - 0.9 * column / 64 - 0.5 * row / 64
    np.testing.assert_allclose(depth[:40, :20], expected, rtol=1e-10)


def random_body(rng, count: int, spread: float) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.from_numpy(rng.normal(0, spread, (3, count))), triangles_of(rng.integers(0, count, (count, 3)))


@pytest.mark.parametrize("seed", range(8))
def test_near_plane_and_vertices_behind_the_camera(seed: int) -> None:
    """Triangles around, through and behind the camera equal the twin; in part they were cut, so none was dropped."""
    rng = np.random.default_rng(200 + seed)
    vertices, triangles = random_body(rng, 24, 1.0)
    camera = Camera(distance=1.0, width=8, height=6, field_of_view=70.0, near=float(rng.choice([1e-3, 0.05, 0.9])))
    screen = project(vertices.unsqueeze(0), [camera], [(0.0, 0.0, 0.0)])
    assert screen.in_guard_band is not None
    assert_twin(screen, triangles, grids=(1, 2))


def test_near_plane_coverage_is_that_of_the_rays() -> None:
    """Which rays meet which part of a triangle before the near plane, worked out in world space."""
    vertices = torch.tensor([[-3.0, 3.0, 0.0], [-0.5, -0.5, 0.5], [0.5, 0.5, 4.0]], dtype=torch.float64)
    camera = Camera(distance=2.0, elevation=0.0, width=40, height=30, near=0.25)
    screen = project(vertices.unsqueeze(0), [camera], [(0.0, 0.0, 0.0)])
    ours = rasterize(screen, triangles_of([[0, 1, 2]])).triangles()[0, :, :, 0] == 0
    a, b, c = screen.view[0].T
    x = (torch.arange(40) + 0.5 - 20) / camera.focal
    y = (15 - torch.arange(30) - 0.5) / camera.focal
    ray = torch.stack(torch.broadcast_tensors(x[None], y[:, None], torch.ones(1, 1)), -1).to(torch.float64)
    weight = torch.stack([ray @ torch.linalg.cross(*pair) for pair in ((b, c), (c, a), (a, b))])
    weight = weight / weight.sum(0)
    depth = (weight * torch.stack([a[2], b[2], c[2]])[:, None, None]).sum(0)
    margin = torch.minimum(weight.min(0).values, (depth - camera.near) / 4)
    clear = margin.abs() > 1e-4
    assert torch.equal(ours[clear], (margin > 0)[clear])
    assert ours.any() and not ours.all() and screen.in_guard_band is not None


def test_far_away_vertices_are_cut_at_the_guard_band() -> None:
    vertices = torch.tensor([[-1e6, 1e6, 0.3], [-1.0, -1.0, 1e6], [0.0, 0.0, 0.0]], dtype=torch.float64)
    camera = Camera(width=16, height=16)
    screen = project(vertices.unsqueeze(0), [camera], [(0.0, 0.0, 0.0)])
    ids = assert_twin(screen, triangles_of([[0, 1, 2]]))
    assert (ids[0, 4:12] == 0).all(), "the triangle spans the image from left to right"


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_scale_of_the_scene_changes_nothing(scale: float) -> None:
    rng = np.random.default_rng(5)
    vertices, triangles = random_body(rng, 30, 0.5)
    ids = []
    for s in (1.0, scale):
        camera = Camera(distance=2.2 * s, width=24, height=24)
        screen = project(vertices.unsqueeze(0) * s, [camera], [(0.0, 0.0, 0.0)])
        ids.append(rasterize(screen, triangles, 2).triangles())
        assert screen.in_guard_band is None
    assert torch.equal(*ids)


def test_batch_and_threads_change_nothing() -> None:
    rng = np.random.default_rng(6)
    vertices, triangles = random_body(rng, 3000, 0.4)
    cameras = [Camera(azimuth=float(a), distance=float(d), width=40, height=30) for a in (0, 70) for d in (0.3, 1, 4)]
    pivots = [(0.0, 0.0, 0.0)] * len(cameras)
    batch = project(vertices.expand(len(cameras), -1, -1), cameras, pivots)
    cull = torch.arange(len(cameras)) % 2 == 0
    together = rasterize(batch, triangles, 2, cull).triangles()
    before = torch.get_num_threads()
    try:
        for threads in (1, 4):
            torch.set_num_threads(threads)
            for index, camera in enumerate(cameras):
                alone = project(vertices.unsqueeze(0), [camera], pivots[:1])
                one = rasterize(alone, triangles, 2, cull[index : index + 1]).triangles()
                assert torch.equal(one[0], together[index])
    finally:
        torch.set_num_threads(before)


def test_culling_drops_what_shows_its_back() -> None:
    x, y = np.array([1, 7, 1]) * GRID, np.array([1, 1, 7]) * GRID
    screen = screen_of(x, y, np.full(3, 0.5), 8, 8)
    cull = torch.ones(1, dtype=torch.bool)
    clockwise, counter = triangles_of([[0, 1, 2]]), triangles_of([[0, 2, 1]])
    assert (rasterize(screen, clockwise, cull=cull).triangles() == -1).all()
    assert torch.equal(rasterize(screen, counter, cull=cull).packed, rasterize(screen, clockwise).packed)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_vertex_that_is_not_finite_is_named(value: float) -> None:
    vertices = torch.zeros(2, 3, 5, dtype=torch.float64)
    vertices[1, 2, 3] = value
    with pytest.raises(InputError, match="vertex 3 of view 1: coordinate z"):
        project(vertices, [Camera()] * 2, [(0.0, 0.0, 0.0)] * 2)


@pytest.mark.slow
def test_a_million_triangles_in_one_pixel() -> None:
    rng = np.random.default_rng(7)
    count = 1_000_000
    x, y = rng.integers(2 * GRID, 3 * GRID, (2, 3 * count))
    inverse_depth = rng.uniform(0.1, 0.9, 3 * count)
    screen = screen_of(x, y, inverse_depth, 5, 5)
    triangles = torch.arange(3 * count).view(-1, 3).T.contiguous()
    visibility = rasterize(screen, triangles, 2)
    ids = visibility.triangles()[0]
    assert (ids[2, 2] >= 0).all() and (ids >= 0).sum() == 4
    # Of the triangles that cover a sample, the twin's formula must put the winner first; check the nearest few.
    best = torch.topk(screen.inverse_depth[0].view(-1, 3).max(1).values, 2000).indices
    subset = torch.cat([best, ids[2, 2].to(torch.int64)]).unique()
    expected = twin(screen, triangles[:, subset], 2)[0, 2, 2]
    assert subset[torch.from_numpy(expected.astype(np.int64))].tolist() == ids[2, 2].tolist()
