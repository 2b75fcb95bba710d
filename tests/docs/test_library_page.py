"""The Python of the library's page runs as it stands, with smaller counts."""

import re
from pathlib import Path

import pytest

from tests.docs.blocks import FENCED, ROOT
from tests.sources.photographs.made_people import write_people

PAGE = ROOT / "docs" / "howto" / "library.md"
SMALLER = {
    r"steps=\d+": "steps=2, size=96, batch=2, translation=4",
    r"most_images=\d+": "most_images=2, size=96, shift=4, bare=1, angles='0'",
    r"images_per_view=1": "images_per_view=1, size=96, shift=4, bare=1, most_images=2",
    r"people=others\)": "people=others, size=96, shift=4, bare=1)",
    r'out="worn"\)': 'out="worn", size=96, bare=1)',
}
"""What a page shows -> what takes seconds; each stands in the page."""
BLOCKS = [m[2] for m in FENCED.finditer(PAGE.read_text("utf-8")) if m[1] == "python"]


@pytest.mark.long
@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_a_block_runs(number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    write_people(tmp_path, 4)
    text = BLOCKS[number]
    for shown, smaller in SMALLER.items():
        text = re.sub(shown, smaller, text)
    exec(compile(text, str(PAGE), "exec"), {"__name__": "page"})


def test_every_smaller_count_stands_in_the_page() -> None:
    assert all(re.search(shown, "".join(BLOCKS)) for shown in SMALLER)
