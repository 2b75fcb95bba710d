"""A cloth on a body is seen as finely as the image can show it."""

import numpy as np
import pytest
import torch

from cloak_core.core.cameras import Camera
from cloak_core.core.images import dressed
from cloak_core.core.linear import Chain, SparseMap
from cloak_core.core.logo import Cover
from cloak_core.core.paint import blank
from cloak_core.core.view import BakedView
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.patterns.cloth import ClothPattern, Grid
from cloak_core.patterns.footprint import MOST_SQUARES
from cloak_core.sources.bodies.view_cache import ViewCache

FLAT = Light(ambient=1.0, diffuse=0.0, specular=0.0)
SIDE = 0.4
"""Of the panel, metres."""


def panel() -> Bodies:
    """A square of two large triangles that faces the camera: far coarser than any cloth."""
    half = SIDE / 2
    corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
    return Bodies(vertices=corners[None], triangles=np.array([[0, 1, 2], [0, 2, 3]]))


def camera(pixels_across: int, size: int = 80) -> Camera:
    """One that shows the panel this many pixels wide."""
    distance = SIDE * size / pixels_across / (2 * np.tan(np.radians(30)))
    return Camera(distance=float(distance), elevation=0.0, width=size, height=size)


def worn(squares: int) -> ClothPattern:
    """A cloth as large as the panel, of squares x squares."""
    return ClothPattern(Cover(np.arange(2), panel().topology), Grid.of(SIDE, SIDE / squares))


def view_of(pixels_across: int) -> BakedView:
    return ViewCache(panel(), RenderSettings(light=FLAT), on_cloth=True).bake(0, camera(pixels_across), [0, 1])


def shown(cloth: ClothPattern, colors: torch.Tensor, pixels_across: int) -> np.ndarray:
    """The panel as the image shows it, pixels [n, n, 3]."""
    canvas = dressed([view_of(pixels_across)], cloth, blank(1, 80, 80).fill_(0))
    image = canvas.paint(colors)[0].permute(1, 2, 0).numpy()
    start = (80 - pixels_across) // 2
    return image[start : start + pixels_across, start : start + pixels_across]


@pytest.mark.parametrize(("pixels", "near"), [(40, 2e-3), (10, 5e-3)])
def test_a_pixel_sees_its_square_or_the_mean_of_many(pixels: int, near: float) -> None:
    cloth, side = worn(40), 40 // pixels
    colors = torch.rand(cloth.count, 3, generator=torch.Generator().manual_seed(0))
    seen = shown(cloth, colors, pixels)
    # The cloth begins in the middle of the body.
    printed = np.roll(colors.view(40, 40, 3).numpy(), (20, 20), axis=(0, 1))
    means = printed.reshape(pixels, side, pixels, side, 3).mean(axis=(1, 3))
    # Pixels that the panel's diagonal cuts are lit in two parts, each at its own middle.
    off_diagonal = ~np.eye(pixels, dtype=bool)[:, ::-1]
    np.testing.assert_allclose(seen[off_diagonal], means[off_diagonal], atol=near)


def test_a_cloth_far_away_costs_bounded_entries() -> None:
    view = view_of(4)
    whole = view.map @ worn(400).map(view.places)
    assert len(whole) <= MOST_SQUARES**2 * len(view.map)
    torch.testing.assert_close(whole.row_sums(), view.map.row_sums())


def test_the_gradient_reaches_every_square_that_is_seen() -> None:
    view, cloth = view_of(40), worn(40)
    colors = torch.full((cloth.count, 3), 0.5, requires_grad=True)
    dressed([view], cloth, blank(1, 80, 80).fill_(0)).paint(colors).sum().backward()
    np.testing.assert_allclose(colors.grad.sum(), 3 * view.coverage.sum(), rtol=1e-4)
    assert (colors.grad > 0).all()


def random_map(rows: int, columns: int, seed: int) -> SparseMap:
    dense = torch.rand(rows, columns, generator=torch.Generator().manual_seed(seed))
    sparse = torch.where(dense > 0.6, dense, 0).to_sparse_csr()
    return SparseMap(sparse.crow_indices(), sparse.col_indices(), sparse.values(), columns)


def test_maps_compose_transpose_and_differentiate_as_dense_matrices_do() -> None:
    one, other = random_map(7, 5, 0), random_map(5, 4, 1)
    dense = one.matrix.to_dense() @ other.matrix.to_dense()
    torch.testing.assert_close((one @ other).matrix.to_dense(), dense)
    torch.testing.assert_close(one.transposed.matrix.to_dense(), one.matrix.to_dense().T)
    assert one @ SparseMap.identity(5) is one
    for both in (one @ other, Chain(one, other), Chain(one, SparseMap.identity(5)) @ other):
        values, upstream = torch.rand(4, 3), torch.rand(7, 3)
        torch.testing.assert_close(both.apply(values), dense @ values)
        torch.testing.assert_close(both.adjoint(upstream), dense.T @ upstream)
        assert (both.height, both.width) == (7, 4)
    torch.testing.assert_close(one.row_sums(), one.matrix.to_dense().sum(1))
    stacked = torch.cat([one.matrix.to_dense(), one.matrix.to_dense()])
    torch.testing.assert_close(SparseMap.stacked([one, one]).matrix.to_dense(), stacked)
    torch.testing.assert_close(
        SparseMap.blocks([one, other]).matrix.to_dense(),
        torch.block_diag(one.matrix.to_dense(), other.matrix.to_dense()),
    )
    values = torch.rand(5, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(one.to("cpu", torch.float64), values)
