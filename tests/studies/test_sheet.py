"""The contact sheet of dressed people: rows and people by name, and who is hidden."""

from pathlib import Path

import pandas as pd
from PIL import Image

from cloak_core.core.evaluation.results import CORNERS
from cloak_core.studies.wearing.pages import CAPTION, FOUND, HEAD, HIDDEN, TILE, TITLE, Album


def near(pixel: tuple[int, ...], color: tuple[int, ...]) -> bool:
    return max(abs(a - b) for a, b in zip(pixel, color, strict=True)) < 30


def test_the_sheet_marks_who_is_hidden(tmp_path: Path) -> None:
    image = Image.new("RGB", (96, 96), (90, 90, 90))
    box = {"detector": 0, "score": 0.9, **dict(zip(CORNERS, (10.0, 10.0, 60.0, 90.0), strict=True))}
    found = pd.DataFrame([box])
    album = Album(tmp_path, ["a.jpg#1", "b.jpg#2"], {"onnx:models/net.onnx": 0.5})
    for clothes, boxes in {"clothing": (found, found), "red@tile=0.5": (found, found.assign(score=0.4))}.items():
        for person in (0, 1):
            album.add(clothes, person, image, boxes[person])
    album.write()
    sheet = Image.open(tmp_path / "sheet.jpg")
    height = TILE + CAPTION + TITLE
    assert sheet.size == (720, HEAD + 2 * height)
    strip = HEAD + TITLE + TILE + CAPTION - 4
    assert near(sheet.getpixel((TILE - 8, strip)), FOUND) and near(sheet.getpixel((2 * TILE - 8, strip)), FOUND)
    assert near(sheet.getpixel((TILE - 8, strip + height)), FOUND)
    assert near(sheet.getpixel((2 * TILE - 8, strip + height)), HIDDEN)
    assert (tmp_path / "pictures").is_dir()
    assert HIDDEN[0] > HIDDEN[1] and FOUND[1] > FOUND[0]  # as on a card: red is hidden, green is found
