"""Videos, read and written through PyAV, which is imported when the first one is asked for; and GIFs through Pillow."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8

from cloak_core.core.pictures import MAX_PIXELS, save_picture
from cloak_core.files.errors import InputError, first_line
from cloak_core.files.reading import open_regular
from cloak_core.files.writing import new_folder, replace_file

if TYPE_CHECKING:
    from PIL import Image

SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi")
MAX_FILE_BYTES = 64 << 30
"""Of a video: it is read frame by frame."""
GIF_COLORS = 255
CRF = "18"
"""x264's constant quality: visually without loss."""


def require_av(path: Path) -> ModuleType:
    """Import PyAV. InputError: it is missing, with the command that installs it."""
    if importlib.util.find_spec("av") is None:
        raise InputError(f"{path}: videos need the package av: pip install 'cloak-core[film]'")
    import av

    return av


def read_frames(path: Path, every: int = 1, most: int | None = None) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    """Read every `every`-th frame of a video, upright, RGB, at most `most`. InputError: damaged, huge, or no video."""
    av = require_av(path)
    count = 0
    with open_regular(path, MAX_FILE_BYTES) as file:
        try:
            with av.open(file, "r") as container:
                frames = container.decode(video=0) if container.streams.video else ()
                for frame in islice(frames, 0, None if most is None else every * most, every):
                    if frame.width * frame.height > MAX_PIXELS:
                        raise InputError(f"{path}: {frame.width} x {frame.height} pixels, more than any picture here")
                    count += 1
                    # Phones film lying and say so: degrees counter-clockwise that bring it upright.
                    yield np.rot90(frame.to_ndarray(format="rgb24"), round(frame.rotation / 90) % 4).copy()
        except InputError:
            raise
        except (av.error.FFmpegError, ValueError) as error:
            words = getattr(error, "strerror", None) or first_line(error)
            raise InputError(f"{path}: not a readable video ({words})") from None
    if not count:
        raise InputError(f"{path}: no picture in this video")


def save_film(path: Path, frames: Iterable[Image.Image], fps: float) -> None:
    """Write frames of one size by the name of the file: .mp4 (H.264), .gif, or without a suffix a folder of PNGs.

    The file appears whole or not at all. InputError: another suffix, PyAV is missing, it cannot be written.
    """
    kind = check_film(path)
    if kind == "folder":
        with new_folder(path) as folder:
            for index, frame in enumerate(frames):
                save_picture(folder / f"{index:05d}.png", frame)
    elif kind == "gif":
        save_gif(path, list(frames), fps)
    else:
        _save_mp4(path, frames, fps)


def check_film(path: Path) -> str:
    """Tell the kind of film, mp4, gif or folder, before the work begins. InputError as for `save_film`."""
    suffix = path.suffix.lower()
    if suffix not in (".mp4", ".gif", ""):
        raise InputError(f"{path}: a film is a .mp4, a .gif, or a folder of PNGs (a name without a suffix)")
    if suffix == ".mp4":
        require_av(path)
    return suffix.removeprefix(".") or "folder"


def _save_mp4(path: Path, frames: Iterable[Image.Image], fps: float) -> None:
    from fractions import Fraction

    av = require_av(path)

    def write(file: object) -> None:
        with av.open(file, "w", format="mp4") as container:
            stream = None
            for frame in frames:
                if stream is None:
                    stream = container.add_stream("h264", rate=Fraction(fps).limit_denominator(1000))
                    stream.width, stream.height = frame.width // 2 * 2, frame.height // 2 * 2  # 4:2:0 halves both
                    stream.pix_fmt = "yuv420p"
                    stream.options = {"crf": CRF}
                even = frame.crop((0, 0, stream.width, stream.height))
                container.mux(stream.encode(av.VideoFrame.from_image(even)))
            if stream is not None:
                container.mux(stream.encode(None))

    replace_file(path, write)


def save_gif(path: Path, frames: list[Image.Image], fps: float) -> None:
    """Write a GIF that repeats for ever; all frames share one palette, so that what stands still stays as it is."""
    from PIL import Image

    shown = frames[:: max(1, len(frames) // 12)]
    width, height = frames[0].size
    sheet = Image.new("RGB", (width, height * len(shown)))
    for row, frame in enumerate(shown):
        sheet.paste(frame, (0, row * height))
    palette = sheet.quantize(GIF_COLORS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    flat = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    every = {"duration": round(1000 / fps), "loop": 0, "optimize": True, "disposal": 1}
    replace_file(path, lambda file: flat[0].save(file, "GIF", save_all=True, append_images=flat[1:], **every))
