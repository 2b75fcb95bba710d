"""One person in a photograph who can be dressed, and the crop that shows her.

A set of people holds the place of each crop and its mask in a thousand bytes or two; the pixels come from the
photograph's own file when somebody looks at them. The last ones stay decoded, up to `DECODED_BYTES` in a process.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image, ImageOps

from cloak_core.core.pictures import open_picture
from cloak_core.files.caching import MemoryCache
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays
from cloak_core.sources.photographs.annotation import Landmarks

DECODED_BYTES = 256 << 20
_decoded = MemoryCache(DECODED_BYTES)
Box = tuple[float, float, float, float]
"""x0, y0, x1, y1."""


@dataclass(frozen=True, eq=False)
class Crop:
    """A part of a photograph in a file, and the mask of a person in it."""

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
            picture, _ = upright_picture(self.path)
            image = _decoded.put(key, cut(picture, self.region, self.shape))
        return image

    @property
    def mask(self) -> Bool[np.ndarray, "h w"]:
        """True on the person."""
        height, width = self.shape
        bits = np.frombuffer(zlib.decompress(self.packed), np.uint8)
        return np.unpackbits(bits, count=height * width).view(bool).reshape(height, width)


@dataclass(frozen=True, eq=False)
class Person:
    """One person who can be dressed: a crop of a photograph with her mask, box and landmarks in its pixels."""

    photograph: str
    """File name."""
    number: int
    """The annotation's id."""
    crop: Crop
    box: Box
    landmarks: Landmarks
    others: tuple[Box, ...] = ()
    """Boxes of the other annotated people."""
    licence: str = ""
    pixels: str = ""
    """SHA-256 (hex) of the whole photograph: decoded, upright, at full size."""
    look: str = ""
    """Of the whole photograph, see `files.likeness.picture_look`."""

    @property
    def image(self) -> UInt8[np.ndarray, "h w 3"]:
        """The crop's pixels, decoded when they are asked for."""
        return self.crop.image

    @property
    def mask(self) -> Bool[np.ndarray, "h w"]:
        """True where the crop shows her."""
        return self.crop.mask

    @property
    def shape(self) -> tuple[int, int]:
        """The crop's height and width."""
        return self.crop.shape

    @property
    def name(self) -> str:
        """PHOTOGRAPH#ID."""
        return f"{self.photograph}#{self.number}"

    @cached_property
    def identity(self) -> str:
        """SHA-256 (hex) of all that decides how she is dressed and judged, whatever her photograph is called.

        The crop's pixels, mask, her box and the others', and the landmarks with visibility and depth (world coordinates
        reach a fit as depth alone).
        """
        return self.identity_with(self.image)

    def identity_with(self, image: UInt8[np.ndarray, "h w 3"]) -> str:
        """Compute `identity` from the crop's pixels, where they are at hand."""
        boxes, *landmarks = self.numbers
        return sha256_arrays(image, self.mask, boxes, *landmarks)

    @property
    def numbers(self) -> tuple[np.ndarray, ...]:
        """What of her is neither pixels nor mask: boxes, landmarks, their visibility and depth."""
        boxes = np.array([self.box, *self.others], np.float64)
        depth = np.zeros(0) if self.landmarks.depth is None else self.landmarks.depth
        return boxes, self.landmarks.xy, self.landmarks.visibility, depth

    def known_as(self, identity: str, **changes: str) -> Person:
        """The person with other words about her photograph; her identity is known and needs no pixel."""
        changed = replace(self, **changes)
        changed.__dict__["identity"] = identity
        return changed


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
    with open_picture(path, data) as picture:
        upright = ImageOps.exif_transpose(picture).convert("RGB")
        return np.array(upright), upright.size != picture.size


def cut(
    picture: UInt8[np.ndarray, "H W 3"] | Bool[np.ndarray, "H W"], region: Sequence[int], shape: tuple[int, int]
) -> UInt8[np.ndarray, "h w 3"] | Bool[np.ndarray, "h w"]:
    """Cut a region (left, top, right, bottom) out of a photograph or a mask, resized to a height and width."""
    left, top, right, bottom = region
    part = picture[top:bottom, left:right]
    if part.shape[:2] != shape:
        kernel = Image.Resampling.BILINEAR if picture.ndim == 2 else Image.Resampling.LANCZOS
        part = np.array(Image.fromarray(part).resize(shape[::-1], kernel))
    return np.ascontiguousarray(part)
