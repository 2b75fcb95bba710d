"""Seen or unseen, white box or black box: by what things are, not by what they are called."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.detectors.loading import load_detector
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.sources.backdrops.procedural import draw_scene
from cloak_core.studies.trained_run import seen_in_training, trained_against
from cloak_core.studies.trainings.run_record import Training, run_config
from tests.core.fakes import box_bodies, front_logo, noise_backgrounds, tiny_settings
from tests.detectors.helpers import TINY_CFG, write_tiny


def recorded(bodies: Bodies, backgrounds: Backgrounds, detectors: tuple = ()) -> dict:
    """As config.json has it."""
    training = Training(tiny_settings(), bodies, front_logo(bodies), detectors, backgrounds)
    return json.loads(json.dumps(run_config(training)))


def save(folder: Path, name: str, picture: Image.Image, **options: object) -> Backgrounds:
    folder.mkdir()
    picture.save(folder / name, **options)
    return load_backgrounds(folder, (64, 64))


COPIES = {
    "png": (False, lambda p: p),
    "bmp": (None, lambda p: p.resize((90, 70))),
    "jpg": (None, lambda p: p),
    "webp": (None, lambda p: p.transpose(Image.Transpose.FLIP_LEFT_RIGHT)),
}


@pytest.mark.parametrize("suffix", COPIES)
def test_a_training_photograph_is_never_called_unseen(tmp_path: Path, suffix: str) -> None:
    unseen, change = COPIES[suffix]
    photo = Image.fromarray(draw_scene(np.random.default_rng(1), 120, 160))
    config = recorded(box_bodies(), save(tmp_path / "trained", "original.png", photo))
    kind = "png" if suffix == "bmp" else suffix
    copy = save(tmp_path / "copy", f"copy.{kind}", change(photo), **({"optimize": True} if unseen is False else {}))
    found, warnings = seen_in_training(
        config, replace(box_bodies(), vertices=box_bodies().vertices * np.float32([2, 1, 1])), copy
    )
    assert found == {"bodies": True, "backgrounds": unseen} and len(warnings) == 1
    assert "copy" in warnings[0] and (unseen is False or "like original.png" in warnings[0])


@pytest.mark.parametrize("shift", [0.5, 1e-6])
def test_bodies_moved_as_a_whole_are_not_unseen(shift: float) -> None:
    bodies = replace(box_bodies(), names=("standing", "walking"))
    turned = bodies.vertices @ np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], np.float32)
    for vertices in (bodies.vertices + np.float32(shift), turned + np.float32(shift)):
        moved = replace(bodies, vertices=vertices[::-1], names=("a", "b"))
        found, warnings = seen_in_training(recorded(bodies, noise_backgrounds()), moved, noise_backgrounds())
        assert found["bodies"] is False and "a is walking, b is standing" in warnings[0]
    other = replace(bodies, vertices=bodies.vertices * np.float32([1.2, 1, 1]))
    found, _ = seen_in_training(recorded(bodies, noise_backgrounds()), other, noise_backgrounds())
    assert found["bodies"] is True


def mixed(bodies: Bodies, **changes: object) -> Bodies:
    """The same bodies, their vertices in another order."""
    order = np.random.default_rng(0).permutation(bodies.vertex_count)
    places = np.argsort(order).astype(np.int32)
    loops = {} if bodies.loop_vertices is None else {"loop_vertices": places[bodies.loop_vertices]}
    return replace(bodies, vertices=bodies.vertices[:, order], triangles=places[bodies.triangles], **loops | changes)


@pytest.mark.parametrize("kept", [True, False])
def test_bodies_with_their_vertices_in_another_order_are_not_unseen(kept: bool) -> None:
    bodies, backgrounds = box_bodies(), noise_backgrounds()
    config = recorded(bodies, backgrounds)
    if not kept:  # as before 2.1
        del config["scene"]["pose_spreads"]
    for known in ({}, {"loop_total": None, "loop_vertices": None, "recorded_topology": bodies.topology}):
        found, (warning, *_) = seen_in_training(config, mixed(bodies, **known), backgrounds)
        assert found["bodies"] is (False if kept else None) and "vertices in another order" in warning
    grown = replace(bodies, vertices=bodies.vertices * np.float32([1.2, 1, 1]))
    assert seen_in_training(config, grown, backgrounds)[0]["bodies"] is True
    assert seen_in_training(config, mixed(grown), backgrounds)[0]["bodies"] is None


def test_parts_of_pictures_that_nobody_looked_for_are_not_called_unseen(tmp_path: Path, monkeypatch) -> None:
    photos = [Image.fromarray(draw_scene(np.random.default_rng(seed), 120, 160)) for seed in range(2)]
    config = recorded(box_bodies(), save(tmp_path / "trained", "original.png", photos[0]))
    part, other = (save(tmp_path / str(k), "a.png", photos[k].crop((0, 0, 120, 90))) for k in range(2))
    unseen = lambda shown: seen_in_training(config, box_bodies(), shown)[0]["backgrounds"]
    assert (unseen(part), unseen(other)) == (None, True)
    with monkeypatch.context() as patch:
        patch.setattr("cloak_core.files.likeness.MOST_PAIRS", 0)
        assert (unseen(part), unseen(other)) == (None, None)
    config["backgrounds"]["looks"] = [look.partition(".")[0] for look in config["backgrounds"]["looks"]]
    assert (unseen(part), unseen(other)) == (None, None)
    assert "parts of trained ones is not known" in seen_in_training(config, box_bodies(), other)[1][-1]


def test_records_that_anyone_may_have_written_tell_what_they_can() -> None:
    bodies, backgrounds = box_bodies(), noise_backgrounds()
    strange = {
        "scene": {"pose_sha256": [1, None], "pose_shapes": [[1], "x", {}, [float("nan")] * 49], "poses": 3},
        "backgrounds": {"identities": [None], "looks": [3, "zz", None], "names": {}},
        "detectors": [{"sha256": []}],
    }
    found, (warning,) = seen_in_training(strange, bodies, backgrounds)
    assert found == {"bodies": None, "backgrounds": True} and "another order" in warning
    assert seen_in_training({"scene": []}, bodies, backgrounds)[0] == {"bodies": None, "backgrounds": None}
    assert seen_in_training(None, bodies, backgrounds) == ({"bodies": None, "backgrounds": None}, [])


def test_weights_make_a_white_box_however_they_are_run(tmp_path: Path) -> None:
    spec = write_tiny(tmp_path)
    known = load_detector(spec)
    config = recorded(box_bodies(), noise_backgrounds(), (known,))
    (tmp_path / "other").mkdir()
    detectors = {
        "same": load_detector(spec + "@96,letterbox"),
        "other": load_detector(write_tiny(tmp_path / "other", seed=5)),
    }
    (tmp_path / "tiny.cfg").write_text(TINY_CFG.replace("leaky", "relu"))
    detectors["edited"] = load_detector(spec)
    assert trained_against(config, detectors) == {"same": True, "other": False, "edited": True}
    assert trained_against({}, detectors) == dict.fromkeys(detectors)
