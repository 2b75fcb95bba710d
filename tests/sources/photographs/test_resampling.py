"""Loops against sparse products: the same views of dressed people, to the bit."""

import numpy as np
import pytest
import torch

from cloak_core.core.cloth import Cloth
from cloak_core.core.linear import SparseMap
from cloak_core.core.view import BakedView
from cloak_core.core.visibility.compiled import torch_alone
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.fitting import Fitter
from cloak_core.sources.photographs.views import (
    Framing,
    Looseness,
    cloth_places,
    logo_positions,
    photograph_view,
    shares_of,
)
from tests.sources.photographs.made_people import standing
from tests.sources.photographs.test_fitting import person_of


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    person, _ = person_of(tmp_path_factory.mktemp("fitted"), standing(20, 5))
    return Fitter().fit(person)


def worn_by(fit, kind: str) -> SparseMap:
    bodies = sample_bodies()
    ids = np.flatnonzero(bodies.regions["shirt"] | bodies.regions["trousers"]).astype(np.int64)
    position = logo_positions(bodies.topology, ids)
    if kind == "faces":
        return shares_of(fit, position, len(ids))
    if kind == "nothing":
        return shares_of(fit, np.full_like(position, -1), len(ids))
    squares = {"large squares": 0.05, "small squares": 0.001}[kind]
    return SparseMap.from_scipy(Cloth.of(0.25, squares).shares(cloth_places(fit), position[fit.main] >= 0))


def tensors(view: BakedView) -> list[torch.Tensor]:
    return [view.pixels, view.base_color, view.map.crow, view.map.column, view.map.weight, view.coverage]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["faces", "nothing", "large squares", "small squares"])
def test_both_ways_are_equal(fitted, kind: str) -> None:
    """Smaller and larger than the photograph, mirrored, soft, beyond its border, and where nobody is.

    To the bit, but for faces of which a pixel sees several triangles: these are added up in another order.
    """
    height = float(fitted.person.shape[0])
    framings = [
        Framing(3.0, 2.0, height / 2, 200),
        Framing(-40.5, -10.25, 1.7 * height, 61, True, 1.7),
        Framing(0.0, 0.0, 0.6 * height, 96, True),
        Framing(-2 * height, 0.0, height, 32),
    ]
    worn, looseness = worn_by(fitted, kind), Looseness(folds=1.3, exposure=0.8)
    for framing in framings:
        ours = photograph_view(fitted, worn, framing, looseness)
        with torch_alone():
            theirs = photograph_view(fitted, worn, framing, looseness)
        for one, other in zip(tensors(ours), tensors(theirs), strict=True):
            torch.testing.assert_close(one, other, rtol=2e-7 if kind == "faces" else 0, atol=0)
        assert ours.is_whole and ours.front_count == ours.map.height
    assert ours.map.height == 0, "the last framing shows nobody"
