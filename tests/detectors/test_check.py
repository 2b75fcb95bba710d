"""Checking a detector on an image file."""

from pathlib import Path

import pytest
import torch
from PIL import Image

from cloak_core.detectors.check import check_image, draw_boxes, read_image
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


def test_reading_follows_orientation_and_mode(tmp_path: Path) -> None:
    picture = Image.new("RGB", (40, 20), (255, 0, 0))
    exif = picture.getexif()
    exif[0x0112] = 6
    picture.save(tmp_path / "turned.jpg", exif=exif)
    assert read_image(tmp_path / "turned.jpg").shape == (3, 40, 20)
    Image.new("L", (5, 4), 128).save(tmp_path / "grey.png")
    assert read_image(tmp_path / "grey.png").unique().tolist() == pytest.approx([128 / 255])


def test_drawing_stays_inside() -> None:
    boxes = torch.tensor([[-50.0, -50.0, 500.0, 30.0, 0.9], [70.0, 10.0, 60.0, 5.0, 0.5]])
    assert draw_boxes(images(1, 48, 80)[0], boxes).size == (80, 48)


@pytest.mark.parametrize("content", [b"", b"no picture", None])
def test_bad_images_are_named(content: bytes | None, tmp_path: Path) -> None:
    detector, file = load_detector(write_tiny(tmp_path)), tmp_path / "in.png"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(InputError, match=r"in.png: (no such file|not a readable picture)"):
        check_image(detector, file)


def test_truncated_image_is_named(tmp_path: Path) -> None:
    file = save(images(1, 200, 200)[0], tmp_path / "in.jpg")
    file.write_bytes(file.read_bytes()[:-800])
    with pytest.raises(InputError, match=r"in.jpg: not a readable picture"):
        read_image(file)


def test_out_is_checked_before_the_work(tmp_path: Path) -> None:
    detector = load_detector(write_tiny(tmp_path))
    with pytest.raises(InputError, match=r"give a .png or .jpg"):
        check_image(detector, tmp_path / "none.png", out=tmp_path / "nowhere" / "x.png")
