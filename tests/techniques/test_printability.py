"""Non-printability: its value, its gradient, and a training that is drawn to a palette."""

import json

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from cloak_core.files.errors import InputError
from cloak_core.techniques.printability import Printability
from tests.core.fakes import tiny_settings
from tests.core.test_training import run


def non_printability(colors: torch.Tensor, palette: torch.Tensor) -> torch.Tensor:
    return Printability(1.0, palette.numpy(), torch.device("cpu")).penalty(colors)[1]


@given(st.integers(0, 2**31), st.integers(1, 40), st.integers(1, 60))
def test_non_printability_against_all_distances(seed, count, size):
    generator = torch.Generator().manual_seed(seed)
    colors, palette = torch.rand(count, 3, generator=generator), torch.rand(size, 3, generator=generator)
    distances = torch.cdist(colors.double(), palette.double(), compute_mode="donot_use_mm_for_euclid_dist")
    assert non_printability(colors, palette).item() == pytest.approx(
        distances.min(dim=1).values.mean().item(), abs=1e-5
    )


def test_the_gradient_of_non_printability_leads_to_the_palette():
    palette = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    colors = torch.tensor([[0.1, 0.1, 0.1], [0.8, 0.9, 1.0], [1.0, 1.0, 1.0]], requires_grad=True)
    non_printability(colors, palette).backward()
    assert (colors.grad[0] > 0).all() and (colors.grad[1, :2] < 0).all()
    assert colors.grad.isfinite().all() and (colors.grad[2] == 0).all()


@pytest.mark.slow
def test_a_palette_draws_the_colours_to_it(tmp_path):
    palette = tmp_path / "cloth.txt"
    palette.write_text("#202020\n#c02040\n0.2 0.3 0.9\n")
    options = {"steps": 60, "noise": 0, "tv_weight": 0, "lr": 0.05}
    free = run(tmp_path / "free", palette=str(palette), **options)
    bound = run(tmp_path / "bound", palette=str(palette), nps_weight=100, **options)
    assert bound.figures.penalties["nps"] < 0.05 < free.figures.penalties["nps"]
    assert bound.figures.loss == pytest.approx(
        bound.figures.disappearance + 100 * bound.figures.penalties["nps"], abs=1e-4
    )
    config = json.loads((tmp_path / "bound" / "config.json").read_text())
    assert config["palette"]["colors"] == 3
    moved = palette.rename(tmp_path / "moved.txt")
    again = run(tmp_path / "bound", palette=str(moved), nps_weight=100, resume=True, **options)
    assert np.array_equal(again.colors, bound.colors)
    moved.write_text("#202020\n")
    with pytest.raises(InputError, match=r"palette\.colors = 3, not 1"):
        run(tmp_path / "bound", palette=str(moved), nps_weight=100, resume=True, **options)
    with pytest.raises(InputError, match="--nps-weight: needs a --palette"):
        tiny_settings(nps_weight=1)
