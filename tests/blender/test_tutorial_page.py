"""The tutorial for Blender shows what its script clicks on, and the script's pictures lie where the page looks."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "blender_tutorial.md").read_text("utf-8")
SCRIPT = (ROOT / "tools" / "blender" / "show_newcomer.py").read_text("utf-8")
CLICKS = re.findall(r'\bclick\(\s*"([^"]+)",\s*"([^"]+)"', SCRIPT)
"""The words that are clicked on, and the names of the pictures."""


def test_the_page_names_every_click_in_its_order() -> None:
    places = [PAGE.find(f"*{words}*") for words, _ in CLICKS]
    assert len(CLICKS) >= 6 and min(places) > 0 and places == sorted(places), dict(zip(CLICKS, places, strict=True))


def test_the_page_names_every_click_on_a_body_of_ones_own() -> None:
    story = (ROOT / "tools" / "blender" / "story_clothed.py").read_text("utf-8")
    clicked = re.findall(r'\.click\(\s*"([^"]+)",\s*"', story)
    section = PAGE.partition("## With a clothed body of your own")[2].partition("\n## ")[0]
    places = [section.find(f"*{words}*") for words in clicked]
    assert len(clicked) >= 6 and min(places) > 0 and places == sorted(places), dict(zip(clicked, places, strict=True))
    assert section.count("\n9. ") == 1 and "\n10. " not in section and "CLICKS = 9" in story


def test_the_pictures_are_those_that_the_script_takes() -> None:
    shown = re.findall(r"\]\(images/(newcomer/[^)]+)\)", PAGE)
    there = sorted(f"newcomer/{path.name}" for path in (ROOT / "docs/images/newcomer").iterdir())
    assert shown == there, "in the order of their numbers"
    taken = {name for _, name in CLICKS} | set(re.findall(r'photograph\("(\w+)"', SCRIPT)) | {"strip"}
    assert {Path(name).stem.partition("-")[2] for name in shown} == taken - {"failed"}


def test_the_pictures_stay_small() -> None:
    assert sum(path.stat().st_size for path in (ROOT / "docs/images/newcomer").iterdir()) < 1_500_000
