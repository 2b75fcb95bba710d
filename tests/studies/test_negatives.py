"""False alarms on cloth that nobody wears, and thresholds that make them equal."""

import numpy as np
import pandas as pd
import pytest
import torch

from cloak_core.core.evaluation.statistics import matched_threshold
from cloak_core.detectors.loading import load_detector
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.studies import negatives
from cloak_core.studies.negatives import (
    CLOAK,
    FLAT,
    RANDOM,
    cloak_textures,
    flat_scores,
    pattern_alarms,
    pattern_scores,
)


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
