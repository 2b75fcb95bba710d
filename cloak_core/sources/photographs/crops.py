"""Crops of photographs that are decoded when somebody looks at them.

A set of people holds the place of each crop and its mask in a thousand bytes or two; the pixels come from the
photograph's own file. The last ones stay decoded, up to `DECODED_BYTES` in a process.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt8

from cloak_core.core.pictures import open_picture
from cloak_core.files.caching import MemoryCache
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_ahead

DECODED_BYTES = 256 << 20
_decoded = MemoryCache(DECODED_BYTES)


@dataclass(frozen=True, eq=False)
class HeldCrop:
    """A crop in memory."""

    image: UInt8[np.ndarray, "h w 3"]
    mask: Bool[np.ndarray, "h w"]

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, pixels."""
        return self.mask.shape

    def expect(self) -> None:
        """Do nothing: it is there."""


@dataclass(frozen=True, eq=False)
class FileCrop:
    """A crop of a photograph in a file."""

    path: Path
    stamp: tuple[int, int]
    """Of the file when it was read first: bytes, and nanoseconds of its last change."""
    region: tuple[int, int, int, int]
    """Left, top, right, bottom in pixels of the upright photograph."""
    shape: tuple[int, int]
    """Height and width that the region is resized to."""
    packed: bytes
    """See `pack_mask`."""

    @property
    def image(self) -> UInt8[np.ndarray, "h w 3"]:
        """The pixels, decoded now or before; not to be written to. InputError: the file changed, or is gone."""
        key = (self.path, self.stamp, self.region, self.shape)
        image = _decoded.get(key)
        if image is None:
            if file_stamp(self.path) != self.stamp:
                raise InputError(f"{self.path}: the photograph changed while it was used")
            image = _decoded.put(key, cut(upright_picture(self.path)[0], self.region, self.shape))
        return image

    @property
    def mask(self) -> Bool[np.ndarray, "h w"]:
        """True on the person."""
        height, width = self.shape
        bits = np.frombuffer(zlib.decompress(self.packed), np.uint8)
        return np.unpackbits(bits, count=height * width).view(bool).reshape(height, width)

    def expect(self) -> None:
        """Have the system read the file ahead of need."""
        read_ahead(self.path)


Crop = HeldCrop | FileCrop
"""A part of a photograph, and the mask of a person in it."""


def pack_mask(mask: Bool[np.ndarray, "h w"]) -> bytes:
    """Pack a mask into a thousand bytes or two."""
    return zlib.compress(np.packbits(mask).tobytes(), 1)


def file_stamp(path: Path) -> tuple[int, int]:
    """Tell a file's size and the time of its last change. InputError: it is gone."""
    try:
        status = os.stat(path)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    return status.st_size, status.st_mtime_ns


def upright_picture(path: Path, data: bytes | None = None) -> tuple[UInt8[np.ndarray, "h w 3"], bool]:
    """Decode a photograph the way up that its EXIF record says, and tell whether that turned it.

    data: the file's content, where it is read. InputError: see `open_picture`.
    """
    from PIL import ImageOps

    with open_picture(path, data) as picture:
        upright = ImageOps.exif_transpose(picture).convert("RGB")
        return np.array(upright), upright.size != picture.size


def cut(image: UInt8[np.ndarray, "H W 3"], region: Sequence[int], shape: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"]:
    """Cut a region (left, top, right, bottom) out of a photograph, resized to a height and width."""
    from PIL import Image

    left, top, right, bottom = region
    part = image[top:bottom, left:right]
    if part.shape[:2] != shape:
        part = np.array(Image.fromarray(part).resize(shape[::-1], Image.Resampling.LANCZOS))
    return np.ascontiguousarray(part)


def cut_mask(mask: Bool[np.ndarray, "H W"], region: Sequence[int], shape: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """Cut a region out of a mask, see `cut`."""
    from PIL import Image

    left, top, right, bottom = region
    part = mask[top:bottom, left:right]
    if part.shape != shape:
        part = np.array(Image.fromarray(part).resize(shape[::-1], Image.Resampling.BILINEAR))
    return np.ascontiguousarray(part)
