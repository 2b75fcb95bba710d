"""Malformed tables and videos: lists of photographs, their boxes, keyframes of a camera."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.commands.malformed.making import DETECTOR, Case, Evil, put

JUDGE = f"judge photos --detector {DETECTOR} --out new"
FILM = f"film run --scene scene --backgrounds photos --detector {DETECTOR} --size 32 --samples 1 --fps 1 --out new"


def tables() -> Iterator[Case]:
    bad = {
        "nothing": b"",
        "a null character": b"file,cloak\n0.png\0,yes\n",
        "no UTF-8": b"file,cloak\n\xff\xfe,yes\n",
        "an open quote": b'file,cloak\n"0.png,yes\n',
        "a column twice": b"file,cloak,cloak\n0.png,yes,no\n",
        "a head alone": b"file,cloak,time\n",
        "a cell too many": b"file,cloak\n0.png,yes,no\n",
        "a million commas": b"," * 1_000_000,
        "a cell of 2 MB": b"file,cloak\n" + b"x" * 2_000_000 + b",yes\n",
        "a file outside": b"file,cloak\n/etc/passwd,yes\n",
        "a file above": b"file,cloak\n../logo.npy,yes\n",
        "a folder": b"file,cloak\n.,yes\n",
        "a box of nan": b"file,cloak,x1,y1,x2,y2\n0.png,yes,nan,1,2,3\n",
        "a box beyond all numbers": b"file,cloak,x1,y1,x2,y2\n0.png,yes,0,0,1e999,9\n",
        "a pickle": pickle.dumps(Evil()),
    }
    for name, data in bad.items():
        yield Case(f"list of photographs: {name}", put("bad.csv", data), f"{JUDGE} --pictures bad.csv")
        yield Case(f"keyframes: {name}", put("bad.csv", data), f"{FILM} --camera bad.csv")
    for name, rows in {"1e9 seconds": b"0\n1e9\n", "1e400 seconds": b"1e400\n", "backwards": b"2\n1\n"}.items():
        yield Case(f"keyframes: {name}", put("bad.csv", b"time\n" + rows), f"{FILM} --camera bad.csv")
    for name, data in {"nothing": b"", "text": b"no video", "a pickle": pickle.dumps(Evil())}.items():
        yield Case(f"video: {name}", _in_with("bad.mp4", data), f"judge . --detector {DETECTOR} --out new")


def _in_with(name: str, data: bytes) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        (folder / "with").mkdir()
        (folder / "with" / name).write_bytes(data)

    return make
