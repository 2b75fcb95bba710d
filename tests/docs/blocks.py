"""Finds the commands in pages: blocks that are indented, or fenced as sh, and lines in them that call `cloak`."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "records" / "README.md"]
PAGES += [page for page in sorted((ROOT / "docs").glob("*.md")) if page.stem != "tutorial"]  # runs exactly as printed
PAGES += sorted((ROOT / "docs" / "howto").glob("*.md"))
REPORTS = [
    page for room in ("reports", "reference", "explanation") for page in sorted((ROOT / "docs" / room).glob("*.md"))
]
"""Their commands are understood, and not run."""
FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"(?:\A|\n\n)((?:    .*\n)(?:(?:    .*|[ ]*)\n)*)")


def blocks(page: Path) -> list[str]:
    """Texts of all blocks of shell that a page has, in order; fences of other languages are none."""
    text = page.read_text("utf-8") + "\n"
    found = [(m.start(), m[2]) for m in FENCED.finditer(text) if m[1] in ("sh", "console")]
    text = FENCED.sub(lambda m: re.sub(r"[^\n]", " ", m[0]), text)
    found += [(m.start(), re.sub(r"^    ", "", m[1], flags=re.MULTILINE)) for m in INDENTED.finditer(text)]
    return [block for _, block in sorted(found)]


def lines(page: Path) -> list[str]:
    """Lines of all blocks; one that a backslash continues is one, comments are left out."""
    text = "\n".join(blocks(page)).replace("\\\n", " ")
    return [line.strip() for line in text.splitlines() if line.strip() and not line.strip().startswith("#")]


def words(line: str) -> list[str]:
    """A line's words, as a shell has them; without brackets around what may be left out, nor `...` but for a value."""
    found = shlex.split(re.sub(r" \[(--[^\]]*)\]", r" \1", line), comments=True)
    if found[-1:] == ["..."]:
        found.pop()
    return [word for before, word in zip(["", *found], found, strict=False) if word != "..." or before.startswith("--")]


def commands(page: Path) -> list[list[str]]:
    """The words behind `cloak` of every line that calls it."""
    split = [words(line) for line in lines(page) if line.startswith("cloak ")]
    return [found[1:] for found in split]
