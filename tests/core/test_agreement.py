"""What training draws is what judging draws, of every source in every pattern; and a finer look shows the same."""

from copy import copy
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch

from cloak_core.core.batches import Batcher
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.images import ImageSet, dressed
from cloak_core.core.logo import load_logo
from cloak_core.core.paint import Canvas, blank
from cloak_core.core.pattern import Pattern
from cloak_core.core.places import Places
from cloak_core.core.sampling import Draws, Sampler
from cloak_core.core.source import Source
from cloak_core.core.view import BakedView
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.patterns.chest import ChestPattern
from cloak_core.patterns.cloth import ClothPattern
from cloak_core.patterns.controls import controls
from cloak_core.patterns.faces import FacePattern
from cloak_core.patterns.groups import GroupPattern
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.bodies.source import BodySource
from cloak_core.sources.photographs import source as photographs
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.people import load_people
from cloak_core.sources.photographs.rig import body_rig
from cloak_core.studies.imagery import body_images
from tests.core.fakes import noise_backgrounds, tiny_settings
from tests.sources.photographs.made_people import write_people

pytestmark = pytest.mark.slow
SIZE, IMAGES = 96, 2
FREE = {"angles": "0..360", "distance": "2:2.5", "noise": 0.0, "contrast": "1", "brightness": "0"}
SETTINGS = tiny_settings(size=SIZE, batch=IMAGES, samples=16, **FREE)
BACKGROUNDS = noise_backgrounds()
CLOTHS = {"large squares": (5, 5), "small squares": (100, 100), "chest": (30, 25)}
"""Rows and columns of 25 cm."""
BODIES = sample_bodies("train").select_poses([0, 7])


def patterns() -> dict[str, Pattern]:
    logo = load_logo(BODIES, region="shirt+trousers")
    random = np.random.default_rng(0)
    colors = random.random((len(logo), 3)).astype(np.float32)
    pictures = {name: random.integers(0, 256, (*sides, 3)).astype(np.uint8) for name, sides in CLOTHS.items()}
    corner = -0.125, -float(body_rig().joints["l_hip"][1]) - 0.55
    chest = ChestPattern.of_picture(logo, pictures.pop("chest"), 0.25, corner=corner)
    made = {
        "faces": FacePattern(logo, BODIES, colors),
        "groups": GroupPattern(logo, BODIES, colors, group=np.arange(len(logo)) // 9),
        **{name: ClothPattern.of_picture(logo, picture, 0.25) for name, picture in pictures.items()},
        "chest": chest,
    }
    return made | controls(("clothing", "grey", "random", "resampled"), made["faces"])


PATTERNS = patterns()


@pytest.fixture(scope="module")
def crowd(tmp_path_factory: pytest.TempPathFactory) -> Crowd:
    return Crowd(load_people(write_people(tmp_path_factory.mktemp("people"), IMAGES)))


def on_bodies(draws: Draws) -> ImageSet:
    """Judge what was drawn of bodies."""
    trials = pd.DataFrame(draws.shown).rename(columns={"azimuth": "angle"}).assign(background=draws.background)
    trials[["shift_x", "shift_y"]] = draws.shift
    render, viewpoint = RenderSettings.of(SETTINGS.views), SETTINGS.views.camera(0.0, 0.0, 1.0)
    return body_images(BODIES, BACKGROUNDS, trials, render, viewpoint, PATTERNS.values())


def laid(pattern: Pattern, view: BakedView) -> Pattern:
    """The pattern as training laid it into a view; judging draws nothing at random."""
    offset = pattern.draw_offset(np.random.default_rng(view.stream))
    fixed = copy(pattern)
    object.__setattr__(fixed, "map", lambda places, nowhere: pattern.map(places, offset))
    return fixed


@pytest.fixture(autouse=True)
def exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a fit does not know is drawn by training alone."""
    monkeypatch.setattr(photographs, "LOOSE", 0.0)
    monkeypatch.setattr(photographs, "LIGHT", 0.0)


def trained_on(shown: str, crowd: Crowd) -> Source:
    if shown == "people":
        return photographs.PeopleSource(crowd.fits, SIZE)
    return BodySource.trained(BODIES, SETTINGS.views)


@pytest.mark.parametrize("shown", ["bodies", "people"])
def test_training_and_judging_draw_the_same_images(shown: str, crowd: Crowd, monkeypatch: pytest.MonkeyPatch) -> None:
    source = trained_on(shown, crowd)
    sampler = Sampler(SETTINGS, source, len(BACKGROUNDS))
    draws = sampler.draw(0)
    trained, laid_as = {}, {}
    for name, pattern in PATTERNS.items():
        views = [source.view(*one, pattern) for one in draws.views()]
        colors = torch.stack([pattern.colors_in(view, number(draws, i)) for i, view in enumerate(views)])
        batch = Batcher(SETTINGS, sampler, BACKGROUNDS, pattern, torch.device("cpu")).batch(0)
        trained[name] = batch.images(colors)
        laid_as[name] = [laid(pattern, view) for view in views]
    for i in range(IMAGES):
        if shown == "people":
            person, seed = number(draws, i), int(draws.seed[i])
            random = np.random.default_rng([seed, person])
            framing = photographs.draw_framing(random, crowd.fits[person], SIZE)
            monkeypatch.setattr(photographs, "framing_of", lambda *_, framing=framing: framing)
            images = crowd.images(BACKGROUNDS, WearSettings(size=SIZE))
        else:
            images = on_bodies(draws)
        judged = images.compose([number(draws, i)], [each[i] for each in laid_as.values()])
        for name, image in zip(PATTERNS, judged, strict=True):
            torch.testing.assert_close(image[0], trained[name][i], rtol=0, atol=1e-6, msg=name)


def number(draws: Draws, i: int) -> int:
    """Which of the images that are judged shows the same: people are judged one after the other."""
    return int(draws.shown.get("person", range(IMAGES))[i])


def finely(pattern: ClothPattern, places: Places) -> torch.Tensor:
    """Mean colours of the squares at 16 x 16 points inside each place's footprint."""
    steps = (np.arange(16) + 0.5) / 16 - 0.5
    corner = np.array(getattr(pattern, "corner", (0.0, 0.0)))[:, None]
    at, extent = (places.at.double().numpy() - corner)[:, :, None], places.extent.double().numpy()[:, :, None]
    across, down = (values.reshape(-1) for values in np.meshgrid(steps, steps))
    points = at + extent * np.stack([across, down])[:, None]
    colors = pattern.colors[pattern.grid.square_at(points.reshape(2, -1).T)].reshape(*points.shape[1:], 3)
    size = np.array([pattern.grid.metres, pattern.grid.square * pattern.grid.rows])[:, None, None]
    # A picture on the chest is seen as far as it reaches, a cloth anywhere.
    inside = ((points >= 0) & (points < size)).all(0) | (not hasattr(pattern, "corner"))
    total = (colors * inside[:, :, None]).sum(1) / np.maximum(inside.sum(1), 1)[:, None]
    return torch.from_numpy(total.astype(np.float32))


@pytest.mark.parametrize("shown", ["bodies", "people"])
@pytest.mark.parametrize("name", CLOTHS)
def test_a_cloth_is_seen_as_a_finer_look_shows_it(shown: str, name: str, crowd: Crowd) -> None:
    source, pattern = trained_on(shown, crowd), PATTERNS[name]
    draws = Sampler(SETTINGS, source, len(BACKGROUNDS)).draw(0)
    for columns, seed in draws.views():
        view = replace(source.view(columns, seed, pattern), stream=None)
        rows = lambda: blank(1, SIZE, SIZE).fill_(0.5)
        seen = dressed([view], pattern, rows()).paint(torch.from_numpy(pattern.colors))[0]
        worn = pattern.map(view.places)
        colors = finely(pattern, view.places) * (worn.crow.diff() > 0)[:, None]
        finer = Canvas.of([view.beside(worn)], rows()).paint(colors)[0]
        away = (seen - finer).flatten(1)[:, view.pixels[: view.map.height]].abs()
        assert 0 < away.mean() < 1.5 / 255
