"""Clean recall and false alarms, counted on a detector whose answers are known; alarms on cloth that nobody wears."""

import numpy as np
import pandas as pd
import pytest
import torch

from cloak_core.core.evaluation.statistics import matched_threshold
from cloak_core.detectors.loading import load_detector
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.studies import negatives
from cloak_core.studies.clean import check_scene, clean_renders
from cloak_core.studies.negatives import (
    CLOAK,
    FLAT,
    RANDOM,
    cloak_textures,
    flat_scores,
    pattern_alarms,
    pattern_scores,
)
from tests.core.fakes import Says


def share_of_red(images: torch.Tensor) -> torch.Tensor:
    """The share of red pixels, times 100."""
    red = (images[:, 0] > 0.3) & (images[:, 1:].amax(1) < 0.05)
    return (100 * red.float().mean((1, 2))).clamp(max=1)


def body() -> Bodies:
    """A tetrahedron a metre wide; poses 0 and 1 stand before the camera, pose 2 lies edge-on, thinner than a pixel."""
    corners = np.array([[-0.5, 0, 0], [0.5, 0, 0], [0, 1, 0], [0, 0.3, -0.5]], np.float32)
    poses = np.stack([corners, corners * 0.8, corners * [0.001, 1, 0.001]])
    triangles = np.array([[0, 1, 2], [1, 0, 3], [1, 3, 2], [0, 2, 3]])
    red = np.zeros((2, 4, 3))
    red[0, :, 0] = 1  # the first outfit; the second is black
    return Bodies(vertices=poses, triangles=triangles, face_colors=red)


def places(red: int, count: int) -> Backgrounds:
    def draw(index: int, height: int, width: int) -> np.ndarray:
        return np.full((height, width, 3), (255, 0, 0) if index < red else (200, 200, 200), np.uint8)

    return Backgrounds([str(i) for i in range(count)], draw)


def test_every_body_at_every_angle_counts_once_per_image():
    result = check_scene(Says(share_of_red), body(), places(0, 5), (0.0, 10.0), images_per_view=3)
    own = {"operating_point": 0.5, "operating_point_assumed": True, "clean_recall_own": 2 / 3, "false_alarms_own": 0.0}
    assert result == {"clean_recall": 2 / 3, "false_alarms": 0.0, "n": 18, "backgrounds": 5, "alarms": []} | own


def test_false_alarms_are_counted_on_bare_backgrounds_and_the_detectors_own_point_beside():
    detector = Says(share_of_red)
    detector.operating_point = 1.0  # it never says more
    result = check_scene(detector, body(), places(2, 8), (0.0,), images_per_view=1)
    assert result["clean_recall_own"] == result["false_alarms_own"] == 0 < result["clean_recall"]
    assert result["false_alarms"] == 0.25 and result["n"] == 3
    assert result["alarms"] == [{"background": name, "score": 1.0} for name in ("0", "1")]


@pytest.mark.slow
def test_renders_to_check_detectors_on():
    images = clean_renders(3, (40, 64))
    assert images.shape == (3, 3, 40, 64) and images.dtype == torch.uint8 and len(images.unique()) > 50
    assert torch.equal(images, clean_renders(3, (40, 64))) and not torch.equal(images[0], images[1])
    assert clean_renders(0, (40, 64)).shape == (0, 3, 40, 64)


def test_thresholds_are_matched_by_false_alarms() -> None:
    reference, scores = np.array([0.1, 0.2, 0.7, 0.9]), np.array([0.3, 0.4, 0.5, 0.55])
    assert matched_threshold(scores, reference) == 0.4  # half of the reference is above 0.6
    assert (scores > 0.4).mean() == (reference > 0.6).mean()
    assert matched_threshold(reference, reference) == 0.2
    assert matched_threshold(scores, np.zeros(4)) == 0.55
    assert matched_threshold(scores, np.ones(4)) == 0.0


@pytest.mark.slow
def test_the_same_pictures_are_shown_to_every_detector_with_and_without_cloth(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(negatives, "COUNT", 12)
    bodies, backgrounds = sample_bodies("unseen"), load_backgrounds("procedural:test:6")
    detectors = {"a": load_detector("builtin"), "b": load_detector("builtin")}
    table = pattern_scores(detectors, backgrounds, bodies, size=128)
    assert table["pattern"].value_counts().to_dict() == {CLOAK: 12, RANDOM: 12} and cloak_textures(bodies)
    first, second = (table[table["detector"] == name].reset_index(drop=True) for name in "ab")
    assert first.drop(columns="detector").equals(second.drop(columns="detector"))
    assert (first["score"] != first["plain"]).mean() > 0.5
    assert np.array_equal(first["plain"][:6], first["plain"][6:])  # the same backgrounds again


@pytest.mark.slow
def test_flat_rectangles_of_every_kind_stand_in_the_same_places(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(negatives, "FLAT_COUNT", 3)
    shown: list[torch.Tensor] = []
    detector = load_detector("builtin")
    detector.register_forward_pre_hook(lambda _, given: shown.append(given[0].clone()))
    table = flat_scores(detector, load_backgrounds("procedural:test:2"), sample_bodies("unseen"))
    assert table["pattern"].value_counts().to_dict() == dict.fromkeys(FLAT, 3)
    for images in shown:
        changed = [(one != images[0]).any(0) for one in images[1:]]
        assert all(0.01 < float(one.float().mean()) < 0.9 for one in changed)
        assert all(float((one & changed[1]).sum() / (one | changed[1]).sum()) > 0.95 for one in changed)


def test_alarms_are_told_by_kind_with_and_without_cloth(monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"pattern": [CLOAK, CLOAK, RANDOM], "score": [0.9, 0.55, 0.1], "plain": [0.7, 0.1, 0.1]}
    monkeypatch.setattr(negatives, "pattern_scores", lambda *_, **__: pd.DataFrame(scores))
    monkeypatch.setattr(negatives, "flat_scores", lambda *_: pd.DataFrame())
    told = pattern_alarms(load_detector("builtin"), load_backgrounds("procedural:test:1"), sample_bodies("unseen"))
    assert told[CLOAK] == {"n": 2, "alarms": 0.5, "plain": 0.5, "alarms_own": 1.0, "plain_own": 0.5}
    assert told[RANDOM] == {"n": 1, "alarms": 0.0, "plain": 0.0, "alarms_own": 0.0, "plain_own": 0.0}
