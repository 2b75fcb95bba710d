"""The contact sheet of dressed people: rows and people by name, and who is hidden."""

from pathlib import Path

import pandas as pd
import pytest
from PIL import Image, ImageDraw

from cloak_core.core.evaluation.results import CORNERS
from cloak_core.studies.wearing.wearing import CAPTION, FOUND, HEAD, HIDDEN, TILE, TITLE, Album


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


def test_the_sheet_counts_those_whom_it_does_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(ImageDraw.ImageDraw, "text", lambda _, place, words, *more, **options: said.append(words))
    album = Album(tmp_path, [f"{k}.jpg" for k in range(19)], {"": 0.5})
    nobody = pd.DataFrame(columns=["detector", "score", *CORNERS])
    for person in range(19):
        album.add("grey", person, Image.new("RGB", (8, 8)), nobody)
    album.write()
    assert any("hidden in 19 of 19 (19 people judged, 12 of them shown)" in words for words in said)
