"""Pictures of every depth: 16- and 32-bit grey is scaled, whoever reads it; what has no white is named."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.core.pictures import ORIENTATION, open_picture, read_picture
from cloak_core.detectors.check import read_image
from cloak_core.files.errors import InputError
from cloak_core.studies.opening import open_pattern
from tests.commands.malformed.making import png_of

RAMP = np.linspace(0, 1, 40).reshape(5, 8)
DEPTHS = {
    "16.png": (RAMP * 65535).astype(np.uint16),
    "16.tif": (RAMP * 65535).astype(np.uint16),
    "32.tif": (RAMP * (2**31 - 1)).astype(np.int32),
    "float.tif": RAMP.astype(np.float32),
}


def saved(folder: Path, name: str, **options: object) -> Path:
    Image.fromarray(DEPTHS[name]).save(folder / name, **options)
    return folder / name


@pytest.mark.parametrize("name", DEPTHS)
def test_deep_grey_is_scaled_wherever_it_is_read(name: str, tmp_path: Path) -> None:
    path = saved(tmp_path, name)
    for pixels in (
        read_picture(path),
        read_picture(path, "RGBA")[..., :3],
        (read_image(path).permute(1, 2, 0) * 255).round().numpy(),
        open_pattern(f"{path}@tile=0.5")[0].colors.reshape(5, 8, 3) * 255,
    ):
        assert pixels.shape == (5, 8, 3) and np.abs(pixels[..., 0] - 255 * RAMP).max() <= 1


@pytest.mark.parametrize("bad", [RAMP * 3, RAMP - 0.5, np.where(RAMP > 0.5, np.nan, RAMP)])
def test_floats_beyond_white_are_named(bad: np.ndarray, tmp_path: Path) -> None:
    Image.fromarray(bad.astype(np.float32)).save(tmp_path / "a.tif")
    with pytest.raises(InputError, match=r"a\.tif: its pixels are from .* not 0 to 1: save it in 8 bits"):
        read_picture(tmp_path / "a.tif")


def test_a_deep_picture_keeps_its_orientation(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[ORIENTATION] = 6
    path = saved(tmp_path, "16.png", exif=exif)
    assert read_image(path).shape == (3, 8, 5)


def test_formats_that_start_programs_are_no_pictures(tmp_path: Path) -> None:
    Image.new("RGB", (4, 4)).save(tmp_path / "a.eps")
    with pytest.raises(InputError, match=r"a\.eps: not a readable picture"):
        read_picture(tmp_path / "a.eps")
    Image.new("L", (4, 3), 7).save(tmp_path / "a.bmp")
    assert read_picture(tmp_path / "a.bmp").tolist() == [[[7, 7, 7]] * 4] * 3
    (tmp_path / "large.png").write_bytes(png_of(12000, 12000))
    with pytest.raises(InputError, match="12000 x 12000 pixels, more than"), open_picture(tmp_path / "large.png"):
        pass
