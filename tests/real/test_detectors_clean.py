"""Real detectors on clean renders and bare photographs, by the protocol of the measuring data's README."""

from pathlib import Path

import pytest

from cloak_core.detectors.loading import load_detector
from cloak_core.exchange.scenes import read_scene
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.studies.clean import check_scene
from tests.real.test_detectors_real import spec_of


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "size", "recall"), [("yolo-lite", None, 0.85), ("yolo-fastest-xl", 416, 0.9), ("yolov3-nano", 416, 0.85)]
)
def test_finds_clean_bodies_and_nothing_else(name: str, size: int | None, recall: float, shared: Path) -> None:
    bodies = read_scene(shared / "data" / "bodies_anny.npz")
    backgrounds = load_backgrounds(shared / "data" / "backgrounds")
    detector = load_detector(spec_of(name, shared), input_size=size)
    result = check_scene(detector, bodies, backgrounds, [0.0], images_per_view=4)
    assert result["clean_recall"] >= recall
    assert result["false_alarms"] <= 0.06
