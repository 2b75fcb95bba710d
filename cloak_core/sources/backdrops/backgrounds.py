"""Backgrounds: a folder of images, or procedural scenes as the embedded default.

Images are kept in memory as uint8 at the size they were asked for, up to a bound, and those of folders decoded on disk;
what is in neither is made anew.
"""

from __future__ import annotations

import copy
import hashlib
import logging
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import Image, ImageOps
from torch import Tensor

from cloak_core.core.pictures import MAX_FILE_BYTES, open_picture
from cloak_core.files.caching import DiskCache, MemoryCache, cache_folder
from cloak_core.files.errors import InputError
from cloak_core.files.identity import code_hash, package_versions, sha256_arrays, sha256_record
from cloak_core.files.likeness import picture_look
from cloak_core.files.reading import read_bytes
from cloak_core.files.specs import select, split_selection, split_spec
from cloak_core.sources.backdrops.procedural import draw_scene

LIMIT_BYTES = 4 << 30
"""Of all decoded images together."""
IDENTITIES_BYTES = 64 << 20
SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")
MEMORY_BYTES = 1 << 30
"""Bound on the images that one set of backgrounds keeps in memory."""
PROCEDURAL_COUNT = 256
_SPLITS = ("train", "test")
_log = logging.getLogger("cloak")

Draw = Callable[[int, int, int], UInt8[np.ndarray, "H W 3"]]


class Picture(NamedTuple):
    """What a picture is, wherever and however it is stored."""

    pixels: str
    """SHA-256 (hex) of its decoded pixels, upright and at full size; of a picture that is drawn, its name."""
    look: str = ""
    """See `files.likeness.picture_look`; "" where nobody looked."""
    file: str = ""
    """SHA-256 (hex) of its file."""


class Backgrounds:
    """Images without people, by index; every image is resized and centre-cropped to the size asked for.

    `draw(index, height, width)` makes image `index` of the source as uint8 [H, W, 3]. Subsets share one cache.
    """

    def __init__(self, names: Sequence[str], draw: Draw, pictures: Sequence[Picture] = ()) -> None:
        self.names = tuple(names)
        """Of the images, in order."""
        self.pictures = tuple(pictures) or tuple(map(Picture, self.names))
        """What the images are."""
        self._draw = draw
        self._indices = tuple(range(len(self.names)))
        self._cache = MemoryCache(MEMORY_BYTES)

    def __len__(self) -> int:
        return len(self.names)

    def image(self, index: int, size: tuple[int, int] = (416, 416)) -> UInt8[Tensor, "3 H W"]:
        """Give image `index` (negative counts from the end) at `size` (height, width).

        Shared memory: do not write to it.
        """
        key = (self._indices[index], *size)
        image = self._cache.get(key)
        return self.keep(*key, self._draw(*key)) if image is None else image

    def keep(self, index: int, height: int, width: int, image: UInt8[np.ndarray, "H W 3"]) -> UInt8[Tensor, "3 H W"]:
        """Keep an image of the source in memory, and return it."""
        tensor = torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1)
        return self._cache.put((index, height, width), tensor)

    def batch(self, indices: Sequence[int] | Tensor, height: int = 416, width: int = 416) -> Float[Tensor, "B 3 H W"]:
        """Stack the images at `indices` as float32 in [0, 1], channels-last in memory."""
        images = torch.empty(len(indices), height, width, 3).permute(0, 3, 1, 2)
        for image, index in zip(images, indices, strict=True):
            image.copy_(self.image(int(index), (height, width)))
        return images.div_(255)

    def subset(self, indices: Sequence[int] | range) -> Backgrounds:
        """Take the images at `indices`, in that order."""
        part = copy.copy(self)
        part.names = tuple(self.names[i] for i in indices)
        part.pictures = tuple(self.pictures[i] for i in indices)
        part._indices = tuple(self._indices[i] for i in indices)
        return part

    def identities(self) -> list[str]:
        """List what tells an image from every other: its pixels' SHA-256, or a drawn one's name."""
        return [picture.pixels for picture in self.pictures]

    def split(self, every: int = 2, offset: int = 0) -> Backgrounds:
        """Take image `offset` and every `every`-th after it: `split(2, 0)` the first, third ..., `split(2, 1)` the
        rest."""
        return self.subset(range(offset, len(self), every))


def load_backgrounds(spec: str | Path, size: tuple[int, int] = (416, 416)) -> Backgrounds:
    """Load backgrounds from a folder, or procedural ones: `procedural[:train|test][:COUNT][:SEED]`.

    `SPEC[0::2]` takes some of them (`files.specs`).

    A folder's jpg, png and webp files are taken by name (sub-folders and hidden files are not). All of them are read
    at once, at `size` (height, width), so that a damaged file is found now: it is named in a warning and skipped.
    Raises `InputError` when nothing usable is there.
    """
    whole, selection = split_selection(str(spec))
    if isinstance(spec, str) and (whole == "procedural" or whole.startswith("procedural:")):
        backgrounds = _open_procedural(whole)
    else:
        backgrounds = _open_folder(Path(whole), size)
    return backgrounds if selection is None else backgrounds.subset(select(selection, backgrounds.names, str(spec)))


def _open_procedural(spec: str) -> Backgrounds:
    fields = split_spec(spec)[1:]
    split = fields.pop(0) if fields and fields[0] in _SPLITS else "train"
    if len(fields) > 2 or not all(f.isdecimal() for f in fields):
        raise InputError(f"{spec}: expected procedural[:train|test][:COUNT][:SEED]")
    count, seed = [*map(int, fields), *(PROCEDURAL_COUNT, 0)[len(fields) :]]
    if not 1 <= count <= 1_000_000:
        raise InputError(f"{spec}: COUNT must lie in 1..1000000")
    stream = _SPLITS.index(split)

    def draw(index: int, height: int, width: int) -> UInt8[np.ndarray, "H W 3"]:
        return draw_scene(np.random.default_rng([stream, seed, index]), height, width)

    return Backgrounds([f"procedural:{split}:{seed}/{i}" for i in range(count)], draw)


def _open_folder(folder: Path, size: tuple[int, int]) -> Backgrounds:
    if not folder.exists():
        raise InputError(f"{folder}: no such folder of backgrounds")
    if not folder.is_dir():
        raise InputError(f"{folder}: backgrounds are a folder of images, this is a file")
    files = [p for p in sorted(folder.iterdir()) if p.suffix.lower() in SUFFIXES and not p.name.startswith(".")]
    if not files:
        raise InputError(f"{folder}: no jpg, png or webp image in this folder (sub-folders are not searched)")
    reader = _Reader()

    def read(path: Path) -> tuple[UInt8[np.ndarray, "H W 3"], Picture] | InputError:
        try:
            return reader.read(path, *size)
        except InputError as error:
            return error

    room = max(1, MEMORY_BYTES // (3 * size[0] * size[1]))
    good: list[tuple[Path, Picture]] = []
    bad: list[InputError] = []
    ready: list[np.ndarray] = []
    with ThreadPoolExecutor(min(8, os.cpu_count() or 1)) as pool:
        for file, opened in zip(files, pool.map(read, files), strict=True):
            if isinstance(opened, InputError):
                _log.warning("%s; skipped", opened)
                bad.append(opened)
                continue
            good.append((file, opened[1]))
            if len(ready) < room:
                ready.append(opened[0])
    if not good:
        one = str(bad[0]).removeprefix(f"{folder}{os.sep}")
        raise InputError(f"{folder}: none of its {len(files)} images can be read ({one})")
    draw = lambda i, h, w: reader.read(good[i][0], h, w, good[i][1])[0]
    names, pictures = [path.name for path, _ in good], [picture for _, picture in good]
    backgrounds = Backgrounds(names, draw, pictures)
    for i, image in enumerate(ready):
        backgrounds.keep(i, *size, image)
    return backgrounds


class _Reader:
    """Reads pictures, decoded and resized once on disk, so that no run pays for the same photograph twice.

    One file of raw bytes for each picture and size, named after the SHA-256 of the picture's own file and what decodes
    it, and one of what the picture is (files/caching.py).
    """

    def __init__(self) -> None:
        folder = cache_folder("images")
        self._images = DiskCache(folder, ".rgb", LIMIT_BYTES, "decoded images")
        self._pictures = DiskCache(folder, ".picture", IDENTITIES_BYTES, "identities of images")
        code = code_hash("sources/backdrops/backgrounds.py", "files/likeness.py")
        self._decoder = sha256_record([code, package_versions("pillow")])[:8]

    def read(
        self, path: Path, height: int, width: int, picture: Picture | None = None
    ) -> tuple[UInt8[np.ndarray, "H W 3"], Picture]:
        """Read a file upright, resized to cover height x width and centre-cropped; and what picture it is.

        picture: where it is known, the file itself need not be read.
        """
        if picture is not None and (image := self._decoded(picture.file, height, width)) is not None:
            return image, picture
        data = read_bytes(path, MAX_FILE_BYTES)
        key = hashlib.sha256(data).hexdigest()
        image, kept = self._decoded(key, height, width), self._pictures.get(f"{key}-{self._decoder}")
        pixels, comma, look = ("" if kept is None else kept.tobytes().decode("ascii", "replace")).partition(",")
        picture = Picture(pixels, look, key)
        if image is None or not comma:
            whole = _decode(path, data)
            if not comma:
                pixels = np.asarray(whole)
                picture = Picture(sha256_arrays(pixels), picture_look(pixels), key)
                self._pictures.put(f"{key}-{self._decoder}", f"{picture.pixels},{picture.look}".encode())
            image = np.array(ImageOps.fit(whole, (width, height), Image.Resampling.BICUBIC))
            self._images.put(f"{key}-{height}x{width}-{self._decoder}", image.tobytes())
        return image, picture

    def _decoded(self, key: str, height: int, width: int) -> UInt8[np.ndarray, "H W 3"] | None:
        data = self._images.get(f"{key}-{height}x{width}-{self._decoder}")
        return None if data is None or len(data) != height * width * 3 else data.reshape(height, width, 3)


def _decode(path: Path, data: bytes) -> Image.Image:
    """Decode the whole picture, upright: a JPEG file and a lossless copy of it give the same pixels."""
    with open_picture(path, data) as image:
        ImageOps.exif_transpose(image, in_place=True)
        image.load()
        if image.has_transparency_data:
            rgba = image.convert("RGBA")
            return Image.alpha_composite(Image.new("RGBA", rgba.size, "white"), rgba).convert("RGB")
        return image if image.mode == "RGB" else image.convert("RGB")
