"""Photographs through kernels: loops against torch operations, maps against their adjoints."""

import numpy as np
import pytest
import torch

from cloak_core.core.images import dressed
from cloak_core.core.logo import Cover
from cloak_core.core.paint import blank
from cloak_core.core.visibility.compiled import torch_alone
from cloak_core.patterns.cloth import ClothPattern, Grid
from cloak_core.patterns.controls import OwnClothing
from cloak_core.patterns.faces import FacePattern
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.fitting import fit_all
from cloak_core.sources.photographs.resampling import Kernel, resample, spread_back
from cloak_core.sources.photographs.views import FitJitter, Framing, logo_positions, photograph_view
from tests.sources.photographs.made_people import standing
from tests.sources.photographs.test_fitting import person_of


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    person, _ = person_of(tmp_path_factory.mktemp("fitted"), standing(20, 5))
    return fit_all([person])[0]


def kernels(start: float, side: float, size: int, **more: object) -> tuple[Kernel, Kernel]:
    return Kernel.of(start, side, size, 40, **more), Kernel.of(start / 2, side, size, 30)


@pytest.mark.parametrize(
    "down,across",
    [
        kernels(3.0, 20.0, 50),
        kernels(-9.5, 70.0, 13, softness=1.7, mirror=True),
        kernels(0.0, 24.0, 24, mirror=True),
        kernels(500.0, 40.0, 8),  # beyond the photograph
    ],
)
def test_kernels_and_their_transposes(down: Kernel, across: Kernel) -> None:
    """Loops and torch give the same sums, and <A x, y> = <x, A' y>."""
    random = torch.Generator().manual_seed(0)
    picture = torch.rand(40, 30, 3, generator=random)
    upstream = torch.rand(len(down.first), len(across.first), 3, generator=random)
    seen, back = resample(picture, down, across), spread_back(upstream, down, across)
    with torch_alone():
        torch.testing.assert_close(resample(picture, down, across), seen, rtol=0, atol=1e-6)
        torch.testing.assert_close(spread_back(upstream, down, across), back, rtol=0, atol=1e-5)
    inner = lambda a, b: (a.double() * b.double()).sum()
    torch.testing.assert_close(inner(seen, upstream), inner(picture, back), rtol=1e-6, atol=0)


FRAMINGS = {
    "close": lambda height: Framing(3.0, 2.0, height / 2, 200),
    "far, mirrored, soft, beyond the border": lambda height: Framing(-40.5, -10.25, 1.7 * height, 61, True, 1.7),
    "mirrored": lambda height: Framing(0.0, 0.0, 0.6 * height, 96, True),
    "nobody": lambda height: Framing(-2 * height, 0.0, height, 32),
}
PATTERNS = {
    "faces": FacePattern,
    "own": OwnClothing,
    "large squares": lambda cover: ClothPattern(cover, Grid.of(0.25, 0.05)),
    "small squares": lambda cover: ClothPattern(cover, Grid.of(0.25, 0.001)),
}


@pytest.mark.slow
@pytest.mark.parametrize("framing", FRAMINGS)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_images_and_gradients_of_both_backends(fitted, framing: str, pattern: str) -> None:
    bodies, asked = sample_bodies(), FRAMINGS[framing](float(fitted.person.shape[0]))
    ids = np.flatnonzero(bodies.regions["shirt"] | bodies.regions["trousers"]).astype(np.int64)
    chosen = PATTERNS[pattern](Cover(ids, bodies.topology))
    random = torch.Generator().manual_seed(0)
    upstream = torch.rand(1, 3, asked.size, asked.size, generator=random)

    def drawn() -> tuple[torch.Tensor, torch.Tensor]:
        position = logo_positions(bodies.topology, ids)
        view = photograph_view(fitted, position, len(ids), asked, FitJitter(folds=1.3, exposure=0.8))
        assert view.is_whole and view.front_count == view.map.height
        assert (view.map.height == 0) == (framing == "nobody")
        values, other = torch.rand(view.map.width, 3), torch.rand(view.map.height, 3)
        products = (view.map.apply(values) * other).sum(), (values * view.map.adjoint(other)).sum()
        torch.testing.assert_close(*products, rtol=1e-5, atol=1e-6)
        canvas = dressed([view], chosen, blank(1, asked.size, asked.size).fill_(0))
        colors = torch.rand(canvas.logo_count, 3, generator=random.manual_seed(1)).requires_grad_()
        image = canvas.paint(colors)
        image.backward(upstream)
        return image.detach().clone(), colors.grad

    ours = drawn()
    with torch_alone():
        theirs = drawn()
    for one, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=2e-6)
