"""Checking a detector on an image file, and how its network wants pixels, as far as one photograph tells."""

from pathlib import Path

import pytest
import torch
from PIL import Image

from cloak_core.detectors.check import check_image, plausibility, read_image
from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from tests.detectors.helpers import images, write_tiny


def save(tensor: torch.Tensor, path: Path) -> Path:
    Image.fromarray((tensor.permute(1, 2, 0) * 255).to(torch.uint8).numpy()).save(path)
    return path


def test_check_gives_score_boxes_and_picture(tmp_path: Path) -> None:
    detector = load_detector(write_tiny(tmp_path))
    file = save(images(1, 48, 80)[0], tmp_path / "in.png")
    result = check_image(detector, file, threshold=0.1, out=tmp_path / "out.png")
    assert set(result) == {"max_person", "boxes", "operating_point", "operating_point_assumed", "reported"}
    assert result["boxes"] and result["boxes"][0][4] == pytest.approx(result["max_person"])
    picture = Image.open(tmp_path / "out.png")
    assert picture.size == (80, 48) and picture.tobytes() != Image.open(file).tobytes()
    high = check_image(detector, file, threshold=0.9999)
    assert high == result | {"boxes": []}


def test_what_the_detector_itself_reports(tmp_path: Path) -> None:
    spec, file = write_tiny(tmp_path), save(images(1, 48, 80)[0], tmp_path / "in.png")
    usual = check_image(load_detector(spec), file)
    assert usual["operating_point_assumed"] and usual["operating_point"] == 0.25
    low, high = (check_image(load_detector(f"{spec}@conf={point}"), file) for point in (0.01, 0.99))
    assert low["reported"] > high["reported"] == 0 and not low["operating_point_assumed"]


def test_bad_images_are_named(tmp_path: Path) -> None:
    whole = save(images(1, 200, 200)[0], tmp_path / "whole.jpg").read_bytes()
    file = tmp_path / "in.jpg"
    with pytest.raises(InputError, match=r"in.jpg: no such file"):
        read_image(file)
    for content in (b"", b"no picture", whole[:-800]):
        file.write_bytes(content)
        with pytest.raises(InputError, match=r"in.jpg: not a readable picture"):
            read_image(file)


BOXES = torch.tensor([[10.0, 10, 30, 50, 0.9], [60, 20, 80, 40, 0.5]])


def mirrored(boxes: torch.Tensor, width: int = 100) -> torch.Tensor:
    return torch.stack([width - boxes[:, 2], boxes[:, 1], width - boxes[:, 0], boxes[:, 3], boxes[:, 4]], dim=1)


def test_boxes_that_a_mirror_image_shows_too_are_plausible() -> None:
    assert plausibility(BOXES, mirrored(BOXES), 100) == 1.0
    assert plausibility(BOXES, BOXES, 100) == plausibility(BOXES[:0], BOXES, 100) == 0.0
    crowd = torch.cat([BOXES, BOXES + torch.tensor([3.0, 40, 3, 40, 0])])
    assert 0 < plausibility(crowd, mirrored(BOXES), 100) < plausibility(BOXES, mirrored(BOXES), 100)
