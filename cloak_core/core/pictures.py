"""Opening pictures that anyone may have made: photographs, textures, stamps."""

from __future__ import annotations

import contextlib
import io
import struct
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8

from cloak_core.files.errors import InputError, first_line
from cloak_core.files.reading import read_bytes
from cloak_core.files.writing import replace_file

if TYPE_CHECKING:
    from PIL import Image

MAX_PIXELS = 128 << 20
"""The largest cameras of telephones have 108 million."""
MAX_FILE_BYTES = 256 << 20
ORIENTATION = 0x0112
"""EXIF's tag."""
FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "GIF", "PPM", "TGA", "TIFF")
"""No other is tried: some of Pillow's formats start programs (PostScript)."""


_warnings = threading.Lock()


@contextlib.contextmanager
def open_picture(path: Path, data: bytes | memoryview | None = None) -> Iterator[Image.Image]:
    """Open a picture of 8 bits a channel, decoded inside the block; `data`: the file's content, where it is read.

    Deeper ones are scaled to 8 bits, see `in_eight_bits`: Pillow's own conversion cuts them off, to white or black.

    InputError, also for what decoding it runs into: no regular file, larger than `MAX_FILE_BYTES`, more than
    `MAX_PIXELS`, damaged, or no picture.
    """
    from PIL import Image

    data = read_bytes(path, MAX_FILE_BYTES) if data is None else data
    try:
        with _opened(io.BytesIO(data)) as picture:
            if picture.width * picture.height > MAX_PIXELS:
                raise InputError(f"{path}: {picture.width} x {picture.height} pixels, more than any picture taken here")
            yield in_eight_bits(picture, path)
    except InputError:
        raise
    except (Image.UnidentifiedImageError, ImportError):
        # A package of the user's may have put an `open` of its own in Pillow's place that imports further readers.
        raise InputError(f"{path}: not a readable picture (none of {', '.join(FORMATS)})") from None
    except (OSError, ValueError, SyntaxError, EOFError, struct.error, Image.DecompressionBombError) as error:
        raise InputError(f"{path}: not a readable picture ({first_line(error)})") from None


def _opened(data: io.BytesIO) -> Image.Image:
    """Open without Pillow's warning of pictures of more than 89 million pixels: `MAX_PIXELS` decides here."""
    from PIL import Image

    with _warnings, warnings.catch_warnings():  # which threads share
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        return Image.open(data, formats=FORMATS)


def in_eight_bits(picture: Image.Image, path: Path) -> Image.Image:
    """Scale 16- and 32-bit grey (integers from 0, or floats from 0 to 1) to 8-bit grey; others stay as they are.

    InputError: floats or integers beyond what such a picture holds, of which nobody knows what is white.
    """
    from PIL import Image

    if not picture.mode.startswith(("I", "F")):
        return picture
    values = np.asarray(picture)
    low, high = float(values.min(initial=0)), float(values.max(initial=0))
    white = 1.0 if picture.mode.startswith("F") else 65535.0 if high <= 65535 else 2.0**31 - 1
    if not (low >= 0 and high <= white):
        raise InputError(f"{path}: its pixels are from {low:g} to {high:g}, not 0 to {white:g}: save it in 8 bits")
    # Integers are cut, not rounded: identities of backgrounds are over these pixels.
    eight = np.rint(255 * values) if white == 1 else values // (257 if white == 65535 else 1 << 23)
    scaled = Image.fromarray(eight.astype(np.uint8))
    scaled.info = picture.info
    scaled.getexif()[ORIENTATION] = picture.getexif().get(ORIENTATION, 1)
    return scaled


def perspective(start: Float[np.ndarray, "4 2"], end: Float[np.ndarray, "4 2"]) -> Float[np.ndarray, " 8"]:
    """Solve for the projective map of four points to four others: Pillow's eight coefficients, the ninth is 1.

    LinAlgError: three of them lie on a line.
    """
    rows = []
    for (x, y), (u, v) in zip(start, end, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
    return np.linalg.solve(np.array(rows), end.reshape(-1))


def read_picture(
    path: Path, mode: str = "RGB", data: bytes | memoryview | None = None
) -> UInt8[np.ndarray, "h w channels"]:
    """Read a picture's pixels in a mode of Pillow ("RGB": without its transparency; "RGBA"), row 0 at the top."""
    with open_picture(path, data) as picture:
        return np.array(picture.convert(mode))


def save_picture(path: Path, picture: Image.Image, **options: object) -> None:
    """Replace a picture file atomically: a JPEG by its suffix .jpg or .jpeg, else a PNG; `options` are Pillow's."""
    kind = "JPEG" if path.suffix.lower() in (".jpg", ".jpeg") else "PNG"
    replace_file(path, lambda file: picture.save(file, kind, **options))
