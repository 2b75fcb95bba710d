"""Early stopping: what is set aside, which colours are kept, and that a resumed run decides alike."""

import numpy as np
import pytest

from cloak_core.core.events import read_events
from cloak_core.core.held_out import TrainingData, set_aside
from cloak_core.exchange.colors import read_colors
from cloak_core.files.errors import InputError
from tests.core.fakes import box_bodies, noise_backgrounds, tiny_settings
from tests.core.test_training import run

EARLY = {"held_out": 0.3, "tv_weight": 0, "held_out_every": 2, "patience": 2, "steps": 40, "checkpoint_every": 3}


def test_what_is_set_aside_is_apart_and_drawn_by_the_seed():
    material = TrainingData(box_bodies(5), noise_backgrounds(10))
    trained, held = set_aside(tiny_settings(held_out=0.3).run, material)
    for count, share, names in ((5, 2, lambda m: m.bodies.names), (10, 3, lambda m: m.backgrounds.names)):
        assert len(names(held)) == share and len(names(trained)) == count - share
        assert not set(names(held)) & set(names(trained))
    again = set_aside(tiny_settings(held_out=0.3).run, material)[1]
    other = set_aside(tiny_settings(held_out=0.3, seed=1).run, material)[1]
    assert again.backgrounds.names == held.backgrounds.names != other.backgrounds.names
    assert set_aside(tiny_settings().run, material) == (material, None)


def test_little_material():
    trained, held = set_aside(tiny_settings(held_out=0.01).run, TrainingData(box_bodies(1), noise_backgrounds(2)))
    assert len(trained.backgrounds) == len(held.backgrounds) == 1
    assert trained.bodies.pose_count == held.bodies.pose_count == 1
    with pytest.raises(InputError, match=r"--held-out 0\.2: a single background"):
        set_aside(tiny_settings(held_out=0.2).run, TrainingData(box_bodies(1), noise_backgrounds(1)))


def told(folder, kind):
    return [event for event in read_events(folder / "events.jsonl") if event["type"] == kind]


@pytest.fixture
def worse_and_worse(monkeypatch):
    """Held-out figures that grow with the distance from grey, where the colours begin."""
    measure = lambda self, colors: (float((colors - 0.5).abs().mean()), 0.0)
    monkeypatch.setattr("cloak_core.core.held_out.HeldOut._measure", measure)


@pytest.mark.slow
def test_the_best_colours_are_kept_and_said_of_which_step(tmp_path, worse_and_worse):
    seen = {}

    def watch(event):
        if event["type"] == "checkpoint":
            seen[event["step"]] = read_colors(tmp_path / "run" / "colors.npy")

    often = {"held_out_every": 1, "checkpoint_every": 1, "steps": 12, "patience": 0}
    done = run(tmp_path / "run", on_event=watch, **(EARLY | often))
    measured = told(tmp_path / "run", "held_out")
    assert [event["step"] for event in measured] == list(range(1, 13))
    best = min(measured, key=lambda event: event["disappearance"])["step"]
    assert best < 12 and done.step == 12
    end = told(tmp_path / "run", "end")[-1]
    assert (done.colors_step, end["colors_step"], measured[-1]["best_step"]) == (best, best, best)
    assert np.array_equal(done.colors, seen[best])
    assert np.array_equal(read_colors(tmp_path / "run" / "colors.npy"), seen[best])


@pytest.mark.slow
def test_patience_ends_the_run_and_a_resumed_one_decides_alike(tmp_path, worse_and_worse):
    whole = run(tmp_path / "whole", **EARLY)
    assert whole.step < 40 and whole.stopped == "" and str(whole.colors_step) in whole.enough
    assert whole.step - whole.colors_step == 4
    assert told(tmp_path / "whole", "end")[-1]["outcome"] == "done"
    part = run(tmp_path / "part", max_seconds=1e-6, **EARLY)
    while part.stopped:
        part = run(tmp_path / "part", max_seconds=part.seconds + 1e-6, resume=True, **EARLY)
    assert (part.step, part.colors_step, part.enough) == (whole.step, whole.colors_step, whole.enough)
    assert np.array_equal(part.colors, whole.colors)
    again = run(tmp_path / "part", resume=True, **EARLY)
    assert again.step == whole.step and np.array_equal(again.colors, whole.colors)


@pytest.mark.slow
def test_measuring_does_not_change_what_is_trained(tmp_path):
    often = run(tmp_path / "often", **(EARLY | {"patience": 0, "held_out_every": 1, "steps": 5}))
    seldom = run(tmp_path / "seldom", **(EARLY | {"patience": 0, "held_out_every": 1000, "steps": 5}))
    of_steps = [[e["loss"] for e in told(tmp_path / name, "step")] for name in ("often", "seldom")]
    assert of_steps[0] == of_steps[1]
    assert seldom.colors_step == 5 >= often.colors_step


@pytest.mark.slow
def test_a_measurement_is_of_fixed_images(tmp_path, monkeypatch):
    """The same colours give the same figures, whenever they are measured."""
    from cloak_core.core.held_out import HeldOut

    figures, measure = [], HeldOut._measure
    monkeypatch.setattr(
        HeldOut,
        "_measure",
        lambda self, colors: figures.append((measure(self, colors), measure(self, 0 * colors))) or figures[-1][0],
    )
    run(tmp_path / "run", **(EARLY | {"patience": 0, "steps": 6}))
    assert len(figures) == 3
    assert len({of_black for _, of_black in figures}) == 1 < len({of_colors for of_colors, _ in figures})


def test_patience_without_a_split_is_refused():
    with pytest.raises(InputError, match="--patience: needs a share"):
        tiny_settings(patience=3)
