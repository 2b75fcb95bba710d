"""Frames from Blender's Cycles: under the matching light they are ours; shifts, colours and what is kept."""

from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.detectors.protocol import Detector
from cloak_core.evaluation import cycles
from cloak_core.evaluation.cycles import CyclesStage, NoBlender, image_difference, render_frames, require_blender
from cloak_core.evaluation.evaluate import make_stage
from cloak_core.evaluation.settings import EvaluateSettings
from cloak_core.evaluation.stage import Stage
from cloak_core.scene.backdrops.backgrounds import load_backgrounds
from cloak_core.scene.logos.logo import make_logo, select_region
from cloak_core.scene.people.samples import sample_bodies


@pytest.fixture(scope="module")
def stage() -> Stage:
    bodies = sample_bodies("unseen").select_poses([0])
    logo = make_logo(bodies, select_region(bodies, "chest+thighs"))
    colors = np.random.default_rng(0).uniform(0.2, 0.8, (len(logo), 3)).astype(np.float32)
    settings = EvaluateSettings(images_per_view=2, size=96, shift=9)
    detectors = {"any": Detector("any", "any")}
    made = make_stage(colors, logo, bodies, load_backgrounds("procedural:test:2"), detectors, (20.0,), settings)
    made.trials.outfit[:] = 0
    return made


@pytest.mark.slow
def test_matching_light_gives_our_images_and_natural_light_does_not(
    stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = []
    frames = render_frames(stage, ("logo", "clothing"), tmp_path, 8, said.append)
    assert len(said) == 3 * 2
    difference = {light: image_difference(stage, CyclesStage(stage, frames, light)) for light in cycles.LIGHTS}
    # What is left is the highlight, and noise at the silhouette.
    assert difference["matching"]["rms"] < 0.04
    assert min(difference[light]["rms"] for light in ("studio", "sky")) > 2 * difference["matching"]["rms"]
    # Before backgrounds, moved: the body is where ours is.
    matching = CyclesStage(stage, frames, "matching")
    ours, theirs = (s.images([0, 1], "logo") for s in (stage, matching))
    assert (ours - theirs).abs().mean() < 0.005
    assert stage.trials.shift[0].any()
    # Nothing is rendered twice.
    monkeypatch.setattr(cycles, "_run", lambda *_: pytest.fail("rendered again"))
    assert render_frames(stage, ("logo", "clothing"), tmp_path, 8, said.append) == frames


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
    monkeypatch.setattr(cycles, "find_bpy", lambda: None)
    with pytest.raises(NoBlender, match=r"^render-gap: needs Blender's Python package .*setup_blender"):
        require_blender()
