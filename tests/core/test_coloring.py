"""From parameters to colours: grids, smoothing, a few inks, a printer's profile, and a share of the first colours."""

import json

import numpy as np
import pytest
import torch

from cloak_core.core.coloring import (
    FREE_UNTIL,
    HARD_FROM,
    Coloring,
    Inks,
    assigned,
    far_apart,
    neighbour_means,
    octave_sums,
    smoothed,
)
from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.settings import PRESETS, make_settings
from cloak_core.exchange.face_lists import read_colors
from cloak_core.exchange.profiles import Profile, write_profile
from cloak_core.files.errors import InputError
from cloak_core.patterns.faces import FacePattern
from tests.core.fakes import box_bodies, front_logo
from tests.core.test_training import run

GREY = torch.full((6, 3), 0.5)
FREE = make_settings("best").optimization
LOGO = front_logo(box_bodies())
MEANS = neighbour_means(LOGO.edges, len(LOGO))


def distinct(colors) -> int:
    return len(np.unique(np.asarray(colors), axis=0))


def random_values(count: int) -> torch.Tensor:
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(0))


def trained(colors: ColorOptimizer, loss, steps: int, lr: float) -> ColorOptimizer:
    for step in range(steps):
        colors.on_step(step, steps)
        colors.clear()
        loss(colors.colors()).backward()
        colors.update(lr)
    return colors


@pytest.mark.parametrize(("dimensions", "period"), [(3, None), (2, 0.5)])
def test_every_grid_adds_its_own_constant_and_its_gradient_is_the_transpose(dimensions, period):
    points = np.random.default_rng(0).uniform(-1, 1, (50, dimensions))
    octaves = octave_sums(points, 0.05, 4, period)
    assert torch.allclose(octaves(torch.ones(octaves.width, 3)), torch.full((50, 3), 3.0))
    values, upstream = torch.rand(octaves.width, 3, requires_grad=True), torch.rand(50, 3)
    octaves(values).backward(upstream)
    assert torch.allclose(values.grad, octaves.matrix.to_dense().T @ upstream, atol=1e-6)


def test_a_grid_is_linear_between_its_nodes():
    places = np.random.default_rng(0).uniform(-1, 1, (50, 2))
    octaves = octave_sums(places, 0.05, 2)
    # The nodes' own places are what the grid says where it is asked for the places themselves.
    nodes = torch.linalg.lstsq(
        octaves.matrix.to_dense().double(), torch.from_numpy(np.c_[places, places[:, 0]])
    ).solution
    assert np.allclose(octaves(nodes.float())[:, :2].numpy(), places, atol=1e-4)
    # Nodes 2, 4 and 8 apart, and the one after the last place.
    assert octave_sums(np.arange(17.0)[:, None], 1.0, 4).width == 9 + 1 + 5 + 1 + 3 + 1


def test_rounds_of_smoothing_are_a_product_with_a_symmetric_matrix_whose_rows_sum_to_one():
    matrix = smoothed(torch.eye(len(LOGO)), MEANS, 1)
    torch.testing.assert_close(matrix, matrix.T)
    torch.testing.assert_close(matrix.sum(1), torch.ones(len(LOGO)))
    neighbours = np.zeros((len(LOGO), len(LOGO)), bool)
    neighbours[LOGO.edges[:, 0], LOGO.edges[:, 1]] = True
    assert np.array_equal((matrix > 0).numpy() & ~np.eye(len(LOGO), dtype=bool), neighbours | neighbours.T)
    values, upstream = random_values(len(LOGO)).requires_grad_(), torch.randn(len(LOGO), 3)
    product = matrix @ matrix @ matrix
    torch.testing.assert_close(smoothed(values, MEANS, 3), product @ values)
    (gradient,) = torch.autograd.grad(smoothed(values, MEANS, 3), values, upstream)
    torch.testing.assert_close(gradient, product.T @ upstream)


def test_optimised_colours_are_smooth_and_in_bounds():
    spread = {}
    for rounds in (0, 10):
        settings = make_settings("best", smooth=rounds).optimization
        coloring = Coloring(settings, FacePattern(LOGO, box_bodies()))
        generator = torch.Generator().manual_seed(0)
        noise = lambda colors, generator=generator: (colors * torch.randn(colors.shape, generator=generator)).sum()
        optimizer = trained(ColorOptimizer(settings, torch.full((len(LOGO), 3), 0.5), coloring), noise, 20, 0.2)
        colors = optimizer.colors().detach()
        assert colors.min() >= 0 and colors.max() <= 1
        spread[rounds] = float(colors.std(0).mean())
    assert spread[10] < spread[0] / 2


def test_the_cold_assignment_is_the_nearest_ink_and_the_warm_one_a_mean():
    inks = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0, 0.0, 0.0]])
    values = torch.tensor([[0.1, 0.1, 0.2], [0.9, 0.2, 0.1]])
    assert torch.equal(assigned(values, inks, None), inks[[0, 2]])
    torch.testing.assert_close(assigned(values, inks, 1e-3), inks[[0, 2]])
    torch.testing.assert_close(assigned(values, inks, 1e6), inks.mean(0).expand(2, 3), atol=1e-5, rtol=0)


def test_gradients_go_to_the_value_and_to_its_ink():
    inks = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]], requires_grad=True)
    values = torch.tensor([[0.1, 0.1, 0.2], [0.9, 0.8, 0.7], [0.2, 0.0, 0.0]], requires_grad=True)
    upstream = torch.tensor([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]])
    assigned(values, inks, None).backward(upstream)
    assert torch.equal(values.grad, upstream)
    assert torch.equal(inks.grad, torch.stack([upstream[0] + upstream[2], upstream[1]]))
    soft = [x.detach().double().requires_grad_() for x in (values, inks)]
    assert torch.autograd.gradcheck(lambda v, i: assigned(v, i, 0.3), soft)


@pytest.mark.parametrize("optimizer", ["sgd", "adam", "mi"])
@pytest.mark.parametrize("gamut", ["projection", "sigmoid"])
def test_every_optimiser_finds_the_two_colours_that_are_wanted(optimizer, gamut):
    """Three of six faces are pulled to red, three to blue: the learnt inks become red and blue."""
    wanted = torch.tensor([[0.9, 0.1, 0.1], [0.1, 0.1, 0.9]])[[0, 0, 1, 0, 1, 1]]
    settings = make_settings("best", optimizer=optimizer, gamut=gamut).optimization
    lr = {"sgd": 2.0 if gamut == "sigmoid" else 0.2, "adam": 0.05, "mi": 0.02}[optimizer]
    colors = ColorOptimizer(settings, GREY, Coloring(settings, inks=Inks(2)))
    trained(colors, lambda found: ((found - wanted) ** 2).sum(), 80, lr)
    assert distinct(colors.finished()) == 2
    torch.testing.assert_close(colors.finished(), wanted, atol=0.15, rtol=0)


def test_inks_of_a_palette_are_its_colours_and_the_useful_ones_are_chosen():
    palette = torch.from_numpy(np.random.default_rng(0).random((20, 3)).astype(np.float32))
    wanted = palette[[3, 3, 11, 11, 3, 11]]
    colors = ColorOptimizer(FREE, GREY, Coloring(FREE, inks=Inks(2, palette)))
    trained(colors, lambda found: ((found - wanted) ** 2).sum(), 150, 0.03)
    assert torch.equal(colors.finished(), wanted)
    few = Inks(8, palette[:4])
    assert len(Coloring(FREE, inks=few).begin(GREY)) == 6 and few.rows == 0


def test_inks_begin_as_clusters_of_the_free_colours():
    cube = far_apart(np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), -1).reshape(-1, 3), 8)
    assert set(np.unique(cube)) == {0.0, 1.0} and distinct(cube) == 8
    first = torch.tensor([[0.9, 0.1, 0.1], [0.1, 0.2, 0.9]])[[0, 1, 0, 1, 0, 1]]
    assert [step for step in range(13) if Inks(2).on_step(step, 13, lambda: first) is not None] == [4]
    coloring = Coloring(FREE, inks=Inks(2))
    values = coloring.begin(first)
    coloring.on_step(4, 13, values)
    inks = values[6:]
    torch.testing.assert_close(inks[inks[:, 0].argsort()], first[[1, 0]])
    assert torch.equal(values[:6], first)
    grey = coloring.begin(GREY)
    begun = grey.clone()
    coloring.on_step(4, 13, grey)
    assert torch.equal(begun, grey)


def test_colours_stay_soft_before_the_last_part_and_are_hard_in_it():
    inks = Inks(2)
    coloring = Coloring(FREE, inks=inks)
    values = coloring.begin(random_values(6))
    assert torch.equal(coloring(values), values[:6])
    for progress, is_hard in ((FREE_UNTIL - 0.01, False), (HARD_FROM - 0.01, False), (HARD_FROM, True), (1.0, True)):
        inks.progress = progress
        assert torch.equal(coloring(values), coloring(values, is_final=True)) == is_hard


@pytest.mark.long
@pytest.mark.parametrize("preset", ["best", "transfer"])
def test_a_run_ends_with_few_colours_and_goes_on_to_the_same_bits(tmp_path, preset):
    few = {"colors_at_most": 3, "pattern": "camouflage", "feature_cm": 30.0, "smooth": 1, "tv_weight": 0.0}
    scheme = PRESETS[preset] | {"steps": 8, "batch": 8, "angles": "0", "samples": 1} | few
    whole = run(tmp_path / "whole", **scheme)
    assert 1 < distinct(whole.colors) <= 3 and whole.record()["distinct_colors"] == distinct(whole.colors)
    for _ in range(2):
        part = run(tmp_path / "part", max_seconds=1e-6, resume=True, **scheme)
        assert distinct(read_colors(tmp_path / "part" / "colors.npy")) <= 3 and part.stopped
    rest = run(tmp_path / "part", resume=True, **scheme)
    assert rest.stopped == "" and np.array_equal(whole.colors, rest.colors)
    with pytest.raises(InputError, match=r"settings\.colors_at_most = 3, not 4"):
        run(tmp_path / "part", resume=True, **(scheme | {"colors_at_most": 4}))


def dull() -> Profile:
    """A printer and camera that make every colour paler, and green darker."""
    steps = np.linspace(0, 1, 5)
    sent = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1)
    return Profile((0.2 + 0.6 * sent * (1, 0.8, 1)).astype(np.float32))


def test_colours_are_those_that_are_photographed_and_their_gradient_is_right():
    profile = dull()
    coloring = Coloring(FREE, profile=profile)
    sent = random_values(40)
    np.testing.assert_allclose(coloring(sent).numpy(), profile.photographed(sent.numpy()), atol=1e-6)
    first = torch.from_numpy(profile.photographed(sent.numpy()))
    torch.testing.assert_close(coloring(coloring.begin(first)), first, atol=2e-3, rtol=0)
    sent.requires_grad_()
    coloring(sent).sum().backward()
    torch.testing.assert_close(sent.grad, torch.tensor([0.6, 0.48, 0.6]).expand(40, 3), atol=1e-4, rtol=0)


@pytest.mark.slow
def test_a_run_through_a_profile_keeps_what_is_photographed(tmp_path):
    write_profile(tmp_path / "p.npz", dull())
    scheme = {"steps": 8, "lr": 0.5, "profile": str(tmp_path / "p.npz"), "colors_at_most": 4}
    done = run(tmp_path / "run", **scheme)
    assert done.colors.min() >= 0.2 and done.colors[:, 1].max() <= 0.68 and distinct(done.colors) <= 4
    moved = (tmp_path / "p.npz").rename(tmp_path / "q.npz")
    again = run(tmp_path / "run", resume=True, **(scheme | {"profile": str(moved)}))
    assert np.array_equal(again.colors, done.colors)
    write_profile(moved, Profile(dull().table / 2))
    with pytest.raises(InputError, match=r"profile\.sha256"):
        run(tmp_path / "run", resume=True, **(scheme | {"profile": str(moved)}))
    assert json.loads((tmp_path / "run" / "config.json").read_text())["profile"]["sha256"]


def moved(gamut: str = "projection", **parts) -> ColorOptimizer:
    """Make six colours, and move them by three steps; parts: the share of the first colours, and inks."""
    changes = {"initial": "balls", "initial_share": parts.pop("share", 0)}
    settings = make_settings("best", optimizer="sgd", gamut=gamut, **changes).optimization
    colors = ColorOptimizer(settings, random_values(6) * 0.6 + 0.2, Coloring(settings, **parts))
    return trained(colors, lambda found: (found**2).sum(), 3, 0.1)


@pytest.mark.parametrize("gamut", ["projection", "sigmoid"])
def test_what_is_written_lies_between_the_first_colours_and_those_found(gamut):
    """Training sees none of it, and a run that goes on keeps the colours that it began with."""
    first, colors = random_values(6) * 0.6 + 0.2, moved(gamut, share=0.25)
    found = colors.colors().detach()
    assert torch.equal(found, moved(gamut).colors().detach())
    assert (found - first).abs().min() > 1e-3
    torch.testing.assert_close(colors.finished(), 0.25 * first + 0.75 * found)
    later = ColorOptimizer(colors.settings, GREY, Coloring(colors.settings))
    later.load(colors.state())
    assert torch.equal(later.finished(), colors.finished())
    with pytest.raises(KeyError, match="first"):
        later.load(moved(gamut).state())


def test_inks_stay_few_beside_a_share_of_the_first_colours():
    assert distinct(moved(share=0.5, inks=Inks(2)).finished()) <= 2


@pytest.mark.parametrize("initial", ["grey", "random", "clothing", "animal"])
def test_only_a_print_is_worth_a_share(initial):
    with pytest.raises(InputError, match=rf"--initial-share.*--initial {initial}.*--initial-share 0"):
        make_settings("photographs", initial=initial)
    assert make_settings("photographs", initial=initial, initial_share=0).optimization.initial_share == 0
    assert make_settings("photographs", initial=initial, init="run").optimization.initial_share > 0


@pytest.mark.parametrize(
    "change",
    [
        {"colors_at_most": 3},
        {"pattern": "camouflage"},
        {"octaves": 3, "gamut": "sigmoid"},
        {"initial": "balls", "initial_share": 0.5},
        {"profile": "p.npz"},
    ],
)
def test_a_search_for_answers_alone_refuses_patterns(tmp_path, monkeypatch, change):
    monkeypatch.chdir(tmp_path)
    write_profile("p.npz", dull())
    with pytest.raises(InputError, match="--black-box-queries: free colours alone"):
        run(tmp_path / "run", black_box_queries=64, **change)
