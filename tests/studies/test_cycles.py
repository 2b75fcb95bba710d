"""Frames from Blender's Cycles: under the matching light they are ours; shifts, colours and what is kept."""

from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core import evaluate
from cloak_core.core.evaluate import Patterns
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.images import ImageSet
from cloak_core.core.logo import make_logo, select_region
from cloak_core.files.errors import InputError
from cloak_core.patterns.controls import OwnClothing
from cloak_core.patterns.faces import FacePattern
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.blender import outside
from cloak_core.sources.bodies.blender.outside import NoBlender
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.studies import cycles
from cloak_core.studies.cycles import CyclesImages, image_difference, render_frames
from cloak_core.studies.imagery import drawn_images


@pytest.fixture(scope="module")
def shown() -> tuple[ImageSet, Patterns]:
    bodies = sample_bodies("unseen").select_poses([0])
    logo = make_logo(bodies, select_region(bodies, "chest+thighs"))
    colors = np.random.default_rng(0).uniform(0.2, 0.8, (len(logo), 3)).astype(np.float32)
    patterns = {"logo": FacePattern(logo, bodies, colors), "clothing": OwnClothing(logo)}
    settings = EvaluateSettings(images_per_view=2, size=96, shift=9)
    images = drawn_images(bodies, load_backgrounds("procedural:test:2"), (20.0,), settings, "cpu", patterns.values())
    images.trials["outfit"] = 0
    return images, patterns


@pytest.mark.long
def test_matching_light_gives_our_images_and_natural_light_does_not(
    shown: tuple[ImageSet, Patterns], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    images, patterns = shown
    said = []
    frames = render_frames(images, patterns, tmp_path, 8, said.append)
    assert len(said) == 3 * 2
    theirs = {light: CyclesImages.of(images, patterns, frames, light) for light in cycles.LIGHTS}
    difference = {light: image_difference(images, one, patterns["logo"]) for light, one in theirs.items()}
    # What is left is the highlight, and noise at the silhouette.
    assert difference["matching"]["rms"] < 0.04
    assert min(difference[light]["rms"] for light in ("studio", "sky")) > 2 * difference["matching"]["rms"]
    # Before backgrounds, moved: the body is where ours is.
    ours, matching = (one.render([0, 1], patterns["logo"]) for one in (images, theirs["matching"]))
    assert (ours - matching).abs().mean() < 0.005
    assert images.shifts([0]).any()
    assert len({one.identity for one in (images, *theirs.values())}) == 4
    # Nothing is rendered twice.
    monkeypatch.setattr(cycles, "_run", lambda *_: pytest.fail("rendered again"))
    assert render_frames(images, patterns, tmp_path, 8, said.append) == frames


@pytest.mark.parametrize("shift", [(0, 0), (3, -2), (-4, 5), (20, 0)])
def test_shifted(shift: tuple[int, int]) -> None:
    body = torch.rand(4, 8, 8)
    moved = cycles._shifted(body, *shift)
    for y in range(8):
        for x in range(8):
            u, v = x - shift[0], y - shift[1]
            expected = body[:, v, u] if 0 <= u < 8 and 0 <= v < 8 else torch.zeros(4)
            assert torch.equal(moved[:, y, x], expected)


def test_without_blender_one_line_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outside, "blender_version", lambda command: "")
    monkeypatch.setattr(outside.shutil, "which", lambda name: None)
    monkeypatch.delenv("CLOAK_BLENDER", raising=False)
    with pytest.raises(NoBlender, match=r"^Cycles is a part of Blender, and there is no Blender: put one on the path"):
        cycles.cycles_command()
    monkeypatch.setenv("CLOAK_BLENDER", "/nowhere/blender")
    with pytest.raises(NoBlender, match="CLOAK_BLENDER=/nowhere/blender is no program"):
        cycles.cycles_command()


@pytest.mark.long
def test_an_evaluation_in_cycles_is_ours_in_the_matching_light(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few = {"size": 96, "shift": 4, "images_per_view": 2, "controls": ("grey",), "bare": 1, "resamples": 100}
    asked = ("zoo:builtin-sample", "sample:unseen[0]", "procedural:test:2")
    monkeypatch.setattr(cycles, "SAMPLES", 4)
    told: list[tuple[int, int]] = []
    found = {
        light: evaluate(*asked, out=tmp_path / str(light), angles=[10.0], cycles=light, on_progress=progress, **few)
        for light, progress in ((None, None), ("matching", lambda *counts: told.append(counts)))
    }
    assert told[:3] == [(1, 3), (2, 3), (3, 3)]
    scores = [summary["detectors"]["builtin"]["clothing"]["mean_score"] for summary in found.values()]
    assert scores[0] == pytest.approx(scores[1], abs=0.05)
    assert found["matching"]["settings"]["cycles"] == "matching"
    monkeypatch.setattr(cycles, "_run", lambda *_: pytest.fail("rendered again"))
    evaluate(*asked, out=tmp_path / "again", angles=[10.0], cycles="matching", **few)


def test_what_cycles_cannot_show_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="one distance and one elevation"):
        EvaluateSettings(cycles="sky", elevations=(0.0, 10.0))
    with pytest.raises(InputError, match="--over-time"):
        evaluate("zoo:builtin-sample", over_time=True, cycles="sky", out=tmp_path / "x")
