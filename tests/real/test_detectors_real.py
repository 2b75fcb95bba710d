"""Real weights on real photographs and clean renders, and the golden outputs of the full cfgs."""

import runpy
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from cloak_core.core.detector.protocol import state_hash
from cloak_core.core.detector.scoring import box_iou, max_person_score, person_boxes
from cloak_core.core.logo import make_logo, select_region
from cloak_core.core.settings import make_settings
from cloak_core.detectors.darknet.cfg import read_cfg
from cloak_core.detectors.darknet.network import Network
from cloak_core.detectors.darknet.weights import read_weights
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.verification import verify
from cloak_core.detectors.verification.kit import natural_size
from cloak_core.exchange.scenes import read_scene
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.studies.clean import check_scene, sample_images
from cloak_core.studies.trainings.training import train
from tests.detectors.helpers import lowers_score

WEIGHTS = {
    "yolo-lite": "yolo-lite-coco-trial6.cfg yolo-lite-coco-trial6_653550.weights",
    "yolo-fastest-xl": "yolo-fastest-1.1-xl.cfg yolo-fastest-1.1-xl.weights",
    "yolov3-nano": "MobileNetV2-YOLOv3-Nano-coco.cfg MobileNetV2-YOLOv3-Nano-coco.weights",
}
REAL = [*WEIGHTS, "d2go"]
PERSON_BOX = torch.tensor([190.0, 98.0, 274.0, 379.0])
"""Where the person stands in photos/person.jpg, read off the picture."""


def spec_of(name: str, shared: Path) -> str:
    if name == "d2go":
        return f"python:{shared / 'detectors' / 'd2go.py'}:load"
    cfg, weights = WEIGHTS[name].split()
    return f"darknet:{shared / 'data' / 'weights' / cfg}:{shared / 'data' / 'weights' / weights}"


def photo(shared: Path, name: str) -> torch.Tensor:
    pixels = np.array(Image.open(shared / "data" / "photos" / name).convert("RGB"))
    return torch.from_numpy(pixels).permute(2, 0, 1)[None].float() / 255


@pytest.mark.slow
@pytest.mark.parametrize(("cfg", "seed", "kind"), [("yolov2-416", 7, "region"), ("yolov3-tiny-416", 3, "yolo")])
def test_full_networks_equal_darknet(
    cfg: str, seed: int, kind: str, shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    golden = shared / "data" / "golden"
    weights, image = tmp_path / "seeded.weights", tmp_path / "image.npy"
    monkeypatch.setattr(sys, "argv", ["", str(golden / f"{cfg}.cfg"), str(seed), str(weights), str(image)])
    runpy.run_path(str(golden / "random_weights.py"), run_name="__main__")
    network = read_weights(Network(read_cfg(golden / f"{cfg}.cfg")), weights).eval().fold()
    with torch.no_grad():
        maps = network(torch.from_numpy(np.load(image))[None])
    expected = np.load(golden / f"{cfg}.seed{seed}.npz", allow_pickle=False)
    assert len(maps) == len(expected.files)
    for index, (head, raw) in enumerate(zip(network.heads, maps, strict=True)):
        ours, theirs = (
            torch.cat(head.activate(head.split(raw)), 2)[0].flatten(0, 1).numpy(),
            expected[f"{kind}_{index}"],
        )
        assert np.abs(ours - theirs).max() <= 1e-4 * np.abs(theirs).max()


@pytest.mark.parametrize(
    ("name", "at_least"), [("yolo-lite", 0.85), ("yolo-fastest-xl", 0.95), ("yolov3-nano", 0.95), ("d2go", 0.95)]
)
def test_finds_the_person(name: str, at_least: float, shared: Path) -> None:
    detector = load_detector(spec_of(name, shared))
    with torch.no_grad():
        found = detector(photo(shared, "person.jpg"))
    assert max_person_score(found).item() > at_least
    best = person_boxes(found)[0][0]
    assert box_iou(best[:4], PERSON_BOX).item() > 0.6


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
@pytest.mark.parametrize("animals", ["dog.jpg", "horses.jpg"])
def test_animals_are_no_people(name: str, animals: str, shared: Path) -> None:
    with torch.no_grad():
        assert max_person_score(load_detector(spec_of(name, shared))(photo(shared, animals))).item() < 0.4


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
@pytest.mark.parametrize("picture", ["person.jpg", "horses.jpg"])
def test_a_gradient_step_lowers_the_score(name: str, picture: str, shared: Path) -> None:
    """With a person in the picture, and with none (every score under the threshold)."""
    detector = load_detector(spec_of(name, shared))
    before_hash = state_hash(detector)
    before, after = lowers_score(detector, photo(shared, picture))
    assert bool((after < before).all())
    assert state_hash(detector) == before_hash


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "size", "recall"), [("yolo-lite", 224, 0.85), ("yolo-fastest-xl", 416, 0.9), ("yolov3-nano", 416, 0.85)]
)
def test_finds_clean_bodies_and_nothing_else(name: str, size: int, recall: float, shared: Path) -> None:
    bodies = read_scene(shared / "data" / "bodies_anny.npz")
    backgrounds = load_backgrounds(shared / "data" / "backgrounds")
    detector = load_detector(f"{spec_of(name, shared)}@{size}")
    result = check_scene(detector, bodies, backgrounds, [0.0], images_per_view=4)
    assert result["clean_recall"] >= recall
    assert result["false_alarms"] <= 0.06


def verified(name: str, shared: Path) -> str:
    file = shared / "data" / "detectors" / f"{name}.onnx"
    if name != "builtin" and file.is_file() and find_spec("onnx2torch") is None:
        pytest.skip("pip install 'cloak-core[onnx]'")
    return name if name == "builtin" else f"onnx:{file}" if file.is_file() else spec_of(name, shared)


@pytest.mark.long
@pytest.mark.parametrize("name", ["builtin", "yolo-fastest-xl", "d2go", "fastestdet", "yolov5n"])
def test_real_detectors_keep_what_they_promise(name: str, shared: Path) -> None:
    detector = load_detector(verified(name, shared))
    report = verify(detector, sample_images(natural_size(detector), shared / "data" / "photos", 2))
    assert report["failed"] == [] and report["white_box"] and report["images"] == 8
    assert (report["parity_scores"] is None) == (name == "d2go")
    assert report["gradient_error"] < (0.5 if name == "d2go" else 0.1)


@pytest.mark.slow
def test_resume_is_bit_identical_on_a_real_detector(shared, tmp_path):
    detector = load_detector(spec_of("yolo-lite", shared) + "@224")
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
