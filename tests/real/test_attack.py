"""Training against a real detector: stopped and resumed on two threads, it ends in the same bits."""

import numpy as np
import pytest

from cloak_core.core.detector.protocol import state_hash
from cloak_core.core.logo import make_logo, select_region
from cloak_core.core.settings import make_settings
from cloak_core.detectors.loading import load_detector
from cloak_core.exchange.scenes import read_scene
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.studies.trainings.training import train


@pytest.mark.slow
def test_resume_is_bit_identical_on_a_real_detector(shared, tmp_path):
    weights = shared / "data" / "weights"
    name = "yolo-lite-coco-trial6"
    detector = load_detector(f"darknet:{weights / name}.cfg:{weights / name}_653550.weights@224")
    bodies = read_scene(shared / "data" / "bodies_anny.npz").select_poses(range(2))
    logo = make_logo(bodies, select_region(bodies, "chest_thighs"))
    backgrounds = load_backgrounds(shared / "data" / "backgrounds").subset(range(4))
    settings = make_settings("best", steps=5, batch=2, threads=2, angles="0,5", preview_every=0)
    before = state_hash(detector)

    def run(out, stop_at=0, resume=False):
        stop = lambda event: (out / "cancel").touch() if (event["type"], event["step"]) == ("step", stop_at) else None
        return train(settings, bodies, logo, [detector], backgrounds, out, resume=resume, on_event=stop)

    whole = run(tmp_path / "whole")
    part = run(tmp_path / "part", stop_at=2)
    assert (part.step, part.stopped) == (2, "cancel file")
    rest = run(tmp_path / "part", resume=True)
    assert np.array_equal(whole.colors, rest.colors)
    assert not np.array_equal(part.colors, rest.colors)
    assert state_hash(detector) == before
