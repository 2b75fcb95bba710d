"""What a card lets people wear beside trained cloaks: published patterns, on renders and in photographs."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.commands.wear import expanded
from cloak_core.files.errors import InputError
from cloak_core.studies.card.protocol import GREY_HEAD, HEADS
from cloak_core.studies.card.words import worn_rows
from cloak_core.studies.opening import open_pattern
from cloak_core.studies.wearing.patterns import pattern_specs, read_patterns


@pytest.mark.slow
def test_patterns_are_worn_on_renders_and_beside_the_largest_cloak_by_people(worn: Path) -> None:
    card = json.loads((worn / "glow/card.json").read_text())
    assert card["left_patterns"] == ["white@tile=0.2"], "the size has two"
    (row,) = card["patterns"]
    assert row["name"] == "white@tile=0.5", "a patch is worn in photographs alone"
    assert row["n"] == 6 and row["success"] < row["clothing"] <= 1, "white glows"
    rows = card["photographs"]["rows"]
    shown = ["made against it", "zoo:builtin-sample", "white@tile=0.5", "white@patch=0.3"]
    assert list(rows)[:4] == shown and card["photographs"]["people"] == 2
    assert [rows[name]["state"] for name in shown] == ["at least", "measured", "measured", "measured"]
    assert rows["clothing"]["success_05"] is not None and rows["clothing"]["masr"] is not None
    assert list(rows)[4:7] == [*HEADS, GREY_HEAD] and list(worn_rows(card)) == shown, "no headline of covered heads"


TABLE = """
[tcega]
file = "white.png"
put_on = "cloth"
metres = 0.25
trained_on = "YOLOv2"
source = "somewhere"
licence = "MIT"

[other]
file = "white.png"
put_on = "patch"
metres = 0.3
trained_on = "nothing"
source = "here"
licence = "CC0-1.0"
"""


def test_a_pattern_folder_says_how_each_picture_is_put_on(tmp_path: Path) -> None:
    Image.fromarray(np.full((8, 8, 3), 255, np.uint8)).save(tmp_path / "white.png")
    with pytest.raises(InputError, match=r"lacks patterns\.toml .*put_on, metres"):
        pattern_specs(str(tmp_path))
    (tmp_path / "patterns.toml").write_text(TABLE)
    specs = [f"{tmp_path}/white.png@tile=0.25", f"{tmp_path}/white.png@patch=0.3"]
    assert (
        pattern_specs(str(tmp_path)) == pattern_specs(f"{tmp_path}/patterns.toml") == expanded(str(tmp_path)) == specs
    )
    assert pattern_specs("white.png@tile=0.5") == ["white.png@tile=0.5"]
    assert [open_pattern(spec)[0].period for spec in specs] == [0.25, None]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('file = "white.png"\nput_on = "cloth"', 'file = "gone.png"\nput_on = "cloth"', "file 'gone.png' is missing"),
        ('file = "white.png"\nput_on = "cloth"', 'file = "../x.png"\nput_on = "cloth"', "lies outside its folder"),
        ('put_on = "cloth"', 'put_on = "hat"', "put_on is 'hat', neither cloth nor patch"),
        ("metres = 0.25", "metres = 9", "metres is 9, not between 0.01 and 5"),
        ("metres = 0.25", "metres = true", "metres is True"),
        ('licence = "MIT"', "", r"\[tcega\] lacks licence"),
        ('licence = "MIT"', 'licence = "MIT"\nsize = 3', r"\[tcega\] has size, which is none of"),
        ('source = "somewhere"', "source = 3", "source is 3, not text"),
    ],
)
def test_what_is_wrong_with_a_pattern_folder_is_named(old: str, new: str, said: str, tmp_path: Path) -> None:
    Image.fromarray(np.full((8, 8, 3), 255, np.uint8)).save(tmp_path / "white.png")
    (tmp_path / "patterns.toml").write_text(TABLE.replace(old, new, 1))
    with pytest.raises(InputError, match=rf"patterns.toml: .*{said}"):
        read_patterns(tmp_path)
