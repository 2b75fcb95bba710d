"""What a stranger asks is answered at most three clicks from the home page, and options that are gone are answered for.

A click follows a link in a page's text; the navigation is left aside. A heading that no link leads to takes one more
click, in the page's list of headings.
"""

import re
from pathlib import Path

import pytest

from cloak_core.core.settings.retired import RETIRED

ROOT = Path(__file__).parents[2]
HOME = ROOT / "docs" / "index.md"
LINK = re.compile(r"(?<!!)\[[^\]]*\]\(([^)\s]+)\)")
CODE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
HEADING = re.compile(r"^#{1,4} (.+)$", re.MULTILINE)
MOST = 3
QUESTIONS = {
    "how do I test my YOLO": ("docs/howto/own-detector.md", "Test a YOLO, or any other file"),
    "what does it cost me to harden it": ("docs/hardening.md", "What it costs, and what still gets through"),
    "can I trust 79 %": ("docs/explanation/honest-figures.md", "Can I trust 79 %?"),
    "how do I add a technique": ("CONTRIBUTING.md", "A technique"),
    "how do I use it in CI": ("docs/howto/ci.md", "Use it in CI"),
    "what do the figures of the literature mean in your columns": (
        "docs/reference/published.md",
        "What the figures of the literature are in our columns",
    ),
    "how do I print the cloth": ("docs/howto/print.md", "Cloth by the metre"),
    "does it work on real people": ("docs/photographs.md", "What was measured"),
    "how do I use it in Blender": ("docs/blender.md", "Five steps"),
    "my detector is a Python module": ("docs/howto/own-detector.md", "A network that no family knows"),
    "which threshold counts": ("docs/explanation/honest-figures.md", "Which threshold counts"),
    "what was removed since 1.0 and what replaces it": (
        "docs/reference/migration.md",
        "Options that are gone since 1.0",
    ),
}
"""Each question, and the page and heading that answer it."""


def slug(heading: str) -> str:
    """The heading's anchor in the site."""
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower())


def prose(page: Path) -> str:
    return CODE.sub("", page.read_text("utf-8"))


def links(page: Path) -> list[tuple[Path, str]]:
    """Pages and anchors that a page's text leads to."""
    found = []
    for target in LINK.findall(prose(page)):
        path, _, anchor = target.partition("#")
        other = (page.parent / path).resolve() if path else page
        if ":" not in target and other.suffix == ".md" and other.exists():
            found.append((other, anchor))
    return found


def clicks(home: Path) -> dict[tuple[Path, str], list[str]]:
    """The shortest ways from the home page: page and anchor ("" is its top) -> what is clicked on, in order."""
    ways: dict[tuple[Path, str], list[str]] = {(home, ""): []}
    queue = [home]
    for page in queue:  # grows while it is walked: breadth first
        before = min((way for (other, _), way in ways.items() if other == page), key=len)
        for other, anchor in links(page):
            if all(known != other for known, _ in ways):
                queue.append(other)
            ways.setdefault((other, anchor), [*before, f"{other.stem}#{anchor}".rstrip("#")])
    return ways


def way_to(page: Path, heading: str, ways: dict[tuple[Path, str], list[str]]) -> list[str]:
    """The clicks to a heading, through a link to it or to its page."""
    headings = HEADING.findall(prose(page))
    assert heading in headings, f"{page.name} has no heading {heading!r}"
    straight = [way for (other, anchor), way in ways.items() if other == page and anchor == slug(heading)]
    listed = [] if heading == headings[0] else [f"the heading {heading!r}"]
    around = [[*way, *listed] for (other, _), way in ways.items() if other == page]
    assert around, f"no link leads to {page.name}"
    return min(straight + around, key=len)


@pytest.mark.parametrize("question", QUESTIONS)
def test_a_question_is_answered_in_three_clicks(question: str) -> None:
    name, heading = QUESTIONS[question]
    way = way_to(ROOT / name, heading, clicks(HOME))
    assert 0 < len(way) <= MOST, f"{question}? {' > '.join(way)}"


def test_every_option_that_is_gone_stands_beside_what_replaces_it() -> None:
    page = (ROOT / "docs" / "reference" / "migration.md").read_text("utf-8")
    for name, retired in RETIRED.items():
        option = f"`--{name.replace('_', '-')}`"
        (row,) = (line for line in page.splitlines() if line.startswith("| `--") and option in line.split(" | ")[0])
        assert set(re.findall(r"--[a-z-]+", retired.instead)) <= set(re.findall(r"--[a-z-]+", row)), row
