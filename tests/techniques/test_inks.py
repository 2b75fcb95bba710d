"""A few inks, patches of a smallest size, and colours as they are printed and photographed."""

import json

import numpy as np
import pytest
import torch

from cloak_core.core.coloring import Coloring
from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.settings import PRESETS, make_settings
from cloak_core.core.technique import Techniques
from cloak_core.exchange.colors import read_colors
from cloak_core.exchange.profiles import Profile, write_profile
from cloak_core.files.errors import InputError
from cloak_core.techniques.inks import FREE_UNTIL, HARD_FROM, Inks, assigned, far_apart
from cloak_core.techniques.profile import Photographed
from tests.core.test_training import run

GREY = torch.full((6, 3), 0.5)


def distinct(colors) -> int:
    return len(np.unique(np.asarray(colors), axis=0))


def dull() -> Profile:
    """A printer and camera that make every colour paler, and green darker."""
    steps = np.linspace(0, 1, 5)
    sent = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1)
    return Profile((0.2 + 0.6 * sent * (1, 0.8, 1)).astype(np.float32))


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
    """Six faces, of which each wants red or blue: learnt inks come to these."""
    wanted = torch.tensor([[0.9, 0.1, 0.1], [0.1, 0.1, 0.9]])[[0, 0, 1, 0, 1, 1]]
    settings = make_settings("best", optimizer=optimizer, gamut=gamut).optimization
    colors = ColorOptimizer(settings, GREY, Techniques([Inks(2)]))
    lr = {"sgd": 2.0 if gamut == "sigmoid" else 0.2, "adam": 0.05, "mi": 0.02}[optimizer]
    for step in range(80):
        colors.reach(step, 80)
        colors.clear()
        ((colors.colors() - wanted) ** 2).sum().backward()
        colors.update(lr)
    assert distinct(colors.finished()) == 2
    torch.testing.assert_close(colors.finished(), wanted, atol=0.15, rtol=0)


def test_inks_of_a_palette_are_its_colours_and_the_useful_ones_are_chosen():
    random = np.random.default_rng(0)
    palette = torch.from_numpy(random.random((20, 3)).astype(np.float32))
    wanted = palette[[3, 3, 11, 11, 3, 11]]
    colors = ColorOptimizer(make_settings("best").optimization, GREY, Techniques([Inks(2, palette)]))
    for step in range(150):
        colors.reach(step, 150)
        colors.clear()
        ((colors.colors() - wanted) ** 2).sum().backward()
        colors.update(0.03)
    assert torch.equal(colors.finished(), wanted)
    few = Inks(8, palette[:4])
    assert len(Coloring(Techniques([few])).begin(GREY)) == 6 and few.rows == 0


def test_inks_begin_as_clusters_of_the_free_colours():
    cube = far_apart(np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), -1).reshape(-1, 3), 8)
    assert set(np.unique(cube)) == {0.0, 1.0} and distinct(cube) == 8
    first = torch.tensor([[0.9, 0.1, 0.1], [0.1, 0.2, 0.9]])[[0, 1, 0, 1, 0, 1]]
    assert [step for step in range(13) if Inks(2).reach(step, 13, lambda: first) is not None] == [4]
    coloring = Coloring(Techniques([Inks(2)]))
    values = coloring.begin(first)
    coloring.reach(4, 13, values)
    inks = values[6:]
    torch.testing.assert_close(inks[inks[:, 0].argsort()], first[[1, 0]])
    assert torch.equal(values[:6], first)
    grey = coloring.begin(GREY)
    begun = grey.clone()
    coloring.reach(4, 13, grey)
    assert torch.equal(begun, grey)


def test_colours_are_those_that_are_photographed_and_their_gradient_is_right():
    profile = dull()
    pattern = Coloring(Techniques([Photographed(profile)]))
    sent = torch.rand(40, 3, generator=torch.Generator().manual_seed(0))
    np.testing.assert_allclose(pattern(sent).numpy(), profile.photographed(sent.numpy()), atol=1e-6)
    first = torch.from_numpy(profile.photographed(sent.numpy()))
    torch.testing.assert_close(pattern(pattern.begin(first)), first, atol=2e-3, rtol=0)
    sent.requires_grad_()
    pattern(sent).sum().backward()
    torch.testing.assert_close(sent.grad, torch.tensor([0.6, 0.48, 0.6]).expand(40, 3), atol=1e-4, rtol=0)


@pytest.mark.long
@pytest.mark.parametrize("preset", ["best", "transfer"])
def test_a_run_ends_with_few_colours_and_goes_on_to_the_same_bits(tmp_path, preset):
    scheme = PRESETS[preset] | {
        "steps": 8,
        "batch": 8,
        "angles": "0",
        "samples": 1,
        "colors_at_most": 3,
        "pattern": "camouflage",
        "feature_cm": 30.0,
    }
    scheme |= {"smooth": 1, "tv_weight": 0.0}
    whole = run(tmp_path / "whole", **scheme)
    assert 1 < distinct(whole.colors) <= 3 and whole.record()["distinct_colors"] == distinct(whole.colors)
    for _ in range(2):
        part = run(tmp_path / "part", max_seconds=1e-6, resume=True, **scheme)
        assert distinct(read_colors(tmp_path / "part" / "colors.npy")) <= 3 and part.stopped
    rest = run(tmp_path / "part", resume=True, **scheme)
    assert rest.stopped == "" and np.array_equal(whole.colors, rest.colors)
    with pytest.raises(InputError, match=r"settings\.colors_at_most = 3, not 4"):
        run(tmp_path / "part", resume=True, **(scheme | {"colors_at_most": 4}))


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


@pytest.mark.parametrize(
    "change", [{"colors_at_most": 3}, {"pattern": "camouflage"}, {"octaves": 3, "gamut": "sigmoid"}]
)
def test_a_search_for_answers_alone_refuses_patterns(tmp_path, change):
    with pytest.raises(InputError, match="--black-box-queries: free colours alone"):
        run(tmp_path / "run", black_box_queries=64, **change)


def test_colours_stay_soft_before_the_last_part_and_are_hard_in_it():
    inks = Inks(2)
    coloring = Coloring(Techniques([inks]))
    values = coloring.begin(torch.rand(6, 3, generator=torch.Generator().manual_seed(0)))
    assert torch.equal(coloring(values), values[:6])
    for progress, is_hard in ((FREE_UNTIL - 0.01, False), (HARD_FROM - 0.01, False), (HARD_FROM, True), (1.0, True)):
        inks.progress = progress
        assert torch.equal(coloring(values), coloring(values, is_final=True)) == is_hard
