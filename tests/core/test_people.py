"""Training on photographs of made people: what is drawn, what counts, and resuming to the same bits."""

import numpy as np
import pytest
import torch

from cloak_core.core.detector.outcomes import for_person
from cloak_core.core.detector.protocol import Detections
from cloak_core.core.logo import load_logo
from cloak_core.core.sampling import Sampler
from cloak_core.core.settings import make_settings
from cloak_core.core.source import Mixture
from cloak_core.files.errors import InputError
from cloak_core.patterns.faces import FacePattern
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.bodies.source import BodyPlan
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.fits import Fits
from cloak_core.sources.photographs.fitting import Fit
from cloak_core.sources.photographs.people import load_people
from cloak_core.sources.photographs.person import Person
from cloak_core.sources.photographs.source import PeopleSource, draw_framing
from cloak_core.studies.trainings.training import train
from tests.core.fakes import RedDetector, noise_backgrounds
from tests.sources.photographs.made_people import write_people

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def crowd(tmp_path_factory):
    return Crowd(load_people(write_people(tmp_path_factory.mktemp("people"), 2)))


def settings(**changes):
    return make_settings(
        "best", **({"steps": 4, "batch": 2, "size": 64, "translation": 5, "checkpoint_every": 2} | changes)
    )


def run(out, crowd, **changes):
    bodies = load_scene("sample[0:1]")
    logo = load_logo(bodies, region="shirt+trousers")
    resume = changes.pop("resume", False)
    given = (settings(**changes), bodies, logo, [RedDetector()], noise_backgrounds(), out)
    return train(*given, people=crowd, resume=resume)


class DrawsAlone(BodyPlan):
    """A source of which nobody asks a view."""

    works_on, identity = torch.device("cpu"), None

    def view(self, shown: object, seed: int | None, pattern: object) -> None:
        raise NotImplementedError

    require_visible = view


class Unread(Fits):
    """Fits of which nobody asks one."""

    def expect(self, indices: object) -> None:
        pass


def people_sampler(count: int, poses: int = 1, outfits: int = 1, **changes) -> Sampler:
    """Draws of bodies and of `count` people, without a pixel of them."""
    chosen = settings(**changes)
    people = PeopleSource(Unread([object.__new__(Person)] * count, lambda _: object.__new__(Fit)), 64, chosen.run.seed)
    people.identity = None  # of pixels, too
    mixed = Mixture(DrawsAlone(chosen.views, poses, outfits), people, chosen.photographs.people_share, chosen.run.seed)
    return Sampler(chosen, mixed, 5)


def test_everybody_is_shown_equally_often():
    sampler = people_sampler(10, steps=20, batch=5)
    shown = np.concatenate([sampler.draw(step).shown["person"] for step in range(20)])
    assert np.bincount(shown).tolist() == [10] * 10


def test_the_share_of_renders_is_kept():
    sampler = people_sampler(10, steps=100, batch=8, people_share=0.25)
    shown = np.concatenate([sampler.draw(step).shown["second"] for step in range(100)])
    assert abs(shown.mean() - 0.25) < 0.06


def test_a_mixture_is_as_fresh_as_what_it_shows():
    alone, mixed = (people_sampler(2, people_share=share).source for share in (1, 0.5))
    assert alone.is_fresh and not mixed.is_fresh
    assert alone.works_on == alone.second.works_on


def test_a_framing_keeps_most_of_the_person(crowd):
    fit = crowd.fits[0]
    for seed in range(50):
        framing = draw_framing(np.random.default_rng(seed), fit, 64)
        x0, y0, x1, y1 = framing.box(fit.person.box)
        inside = (min(x1, 64) - max(x0, 0)) * (min(y1, 64) - max(y0, 0))
        assert inside > 0.7 * (x1 - x0) * (y1 - y0)


def test_views_depend_on_person_and_seed_alone(crowd):
    pattern = FacePattern(load_logo(load_scene("sample[0:1]"), region="shirt"))
    source = PeopleSource(crowd.fits, 64)
    one, same, other = (source.view({"person": 0}, seed, pattern) for seed in (5, 5, 6))
    assert one.box == same.box != other.box and one.stream == same.stream
    values = torch.rand(one.map.width, 3)
    assert torch.equal(one.map.apply(values), same.map.apply(values))


def test_a_run_is_resumed_with_the_same_people_alone_to_the_same_bits(tmp_path, crowd):
    whole = run(tmp_path / "whole", crowd, people_share=0.7)
    run(tmp_path / "part", crowd, people_share=0.7, max_seconds=1e-9)
    with pytest.raises(InputError, match="people"):
        run(tmp_path / "part", crowd.first(1), people_share=0.7, resume=True)
    resumed = run(tmp_path / "part", crowd, people_share=0.7, resume=True)
    assert np.abs(whole.colors - 0.5).max() > 0.01
    assert resumed.step == 4 and np.array_equal(whole.colors, resumed.colors)


def boxes(*rows):
    values = torch.tensor(rows, dtype=torch.float32)[None]
    return Detections(values[..., :4], values[..., 4])


BODY = torch.tensor([[100.0, 100.0, 200.0, 400.0]])
NOBODY = torch.zeros(1, 0, 4)


def test_somebody_behind_her_lies_in_her_box_and_not_on_her_mask():
    mask = torch.zeros(1, 500, 500, dtype=torch.bool)
    mask[:, 100:400, 100:150] = True
    behind, drawn = boxes([155, 110, 195, 250, 0.9]), boxes([105, 200, 145, 260, 0.8])
    assert for_person(behind, BODY, NOBODY).scores.tolist() == [[pytest.approx(0.9)]]
    assert for_person(behind, BODY, NOBODY, masks=mask).scores.tolist() == [[0.0]]
    assert for_person(drawn, BODY, NOBODY, masks=mask).scores.tolist() == [[pytest.approx(0.8)]]


@pytest.mark.parametrize(
    ("box", "alone", "score"),
    [([120, 200, 160, 260], False, 0.9), ([300, 100, 400, 400], False, 0.0), ([300, 100, 400, 400], True, 0.9)],
    ids=["small on the cloth", "elsewhere", "elsewhere in a render"],
)
def test_boxes_on_her_count_and_on_renders_every_box(box, alone, score):
    found = for_person(boxes([*box, 0.9]), BODY, NOBODY, torch.tensor([alone]))
    assert found.scores.tolist() == [[pytest.approx(score)]]


def test_a_neighbours_box_does_not_count():
    """Though more than half of it lies in hers, as its owner's does."""
    neighbour, others = (
        boxes([142, 110, 240, 390, 0.9], [100, 100, 200, 400, 0.8]),
        torch.tensor([[[140.0, 110, 240, 390]]]),
    )
    assert for_person(neighbour, BODY, NOBODY).scores.tolist() == [pytest.approx([0.9, 0.8])]
    assert for_person(neighbour, BODY, others).scores.tolist() == [pytest.approx([0.0, 0.8])]
