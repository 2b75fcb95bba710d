"""Training the built-in detector end to end in miniature, and the weights that come with Cloak."""

import math

import numpy as np
import pytest
import torch
from PIL import Image

from cloak_core.core.cameras import Camera
from cloak_core.core.detector.outcomes import on_body
from cloak_core.core.detector.scoring import THRESHOLD, max_person_score
from cloak_core.core.paint import compose, true_boxes
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.detectors.darknet.cfg import read_cfg_text
from cloak_core.detectors.darknet.detector import BUILTIN_CFG, BUILTIN_WEIGHTS
from cloak_core.detectors.darknet.network import build_network
from cloak_core.detectors.darknet.weights import read_weights
from cloak_core.detectors.loading import load_detector
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.bodies.view_cache import ViewCache
from tools.pretrain.builtin_training import train_builtin

SMALL = {"batch": 4, "views": 6, "scenes": 3, "judged": 32}


@pytest.mark.long
def test_a_run_writes_a_pair_that_the_reader_takes(tmp_path):
    photos = tmp_path / "photos"
    photos.mkdir()
    noise = np.random.default_rng(0).integers(0, 255, (7, 40, 50, 3), dtype=np.uint8)
    for i, image in enumerate(noise):
        Image.fromarray(image).save(photos / f"{i}.png")
    events = []
    result = train_builtin(tmp_path / "out", photos, steps=3, seed=1, on_event=events.append, **SMALL)
    assert result["step"] == 3 and 0 <= result["recall"] <= 1 and 0 <= result["false_alarms"] <= 1
    assert events[-1]["type"] == "stored"
    detector = load_detector(f"builtin:{tmp_path / 'out' / 'builtin.weights'}")
    scores = detector(torch.rand(1, 3, 64, 64)).scores
    assert scores.shape == (1, 192) and torch.isfinite(scores).all()


@pytest.mark.slow
def test_a_run_goes_on_from_stored_weights(tmp_path):
    """With a learning rate of next to nothing the weights it started from come out again, calibration apart."""
    train_builtin(tmp_path / "on", steps=1, start_from=BUILTIN_WEIGHTS, learning_rate=1e-9, **SMALL)
    before, after = (build_network(read_cfg_text(BUILTIN_CFG)) for _ in range(2))
    read_weights(before, BUILTIN_WEIGHTS)
    read_weights(after, tmp_path / "on" / "builtin.weights")
    torch.testing.assert_close(after.layers[0].conv.weight, before.layers[0].conv.weight, atol=1e-5, rtol=0)


@pytest.mark.slow
def test_the_committed_weights_find_unseen_people_and_no_others():
    """A handful of renders of bodies never trained on, and of places never trained on (not the figures of record)."""
    detector, bodies = load_detector("builtin"), sample_bodies("unseen")
    places = load_backgrounds("procedural:test:24").batch(range(24))
    assert BUILTIN_WEIGHTS.stat().st_size < 6 << 20
    view_cache = ViewCache(bodies, RenderSettings(samples=4))
    logo = np.flatnonzero(bodies.regions["chest"])
    grey = torch.full((len(logo), 3), 0.5)
    views = [view_cache.bake(i % bodies.pose_count, Camera(azimuth=10.0 * (i % 3 - 1)), logo, i % 3) for i in range(24)]
    images = compose(views, grey, places)
    boxes = true_boxes(views).float()
    with torch.no_grad():
        found = detector(images)
        bare = max_person_score(detector(places))
    assert (max_person_score(found) > 0.6).float().mean() >= 0.9
    assert (on_body(found, boxes, within=math.inf).person > THRESHOLD).float().mean() >= 0.8
    assert (bare > 0.6).float().mean() <= 0.13
