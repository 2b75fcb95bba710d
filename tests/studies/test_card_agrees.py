"""Every figure on a card's page is one of card.json: shares, intervals, counts, thresholds, in text and in plots."""

import json
import math
import re
from collections.abc import Iterator
from html import unescape
from pathlib import Path

import pytest

from cloak_core.studies.card import words
from cloak_core.studies.report.words import duration, percent

TEMPLATE = Path(words.__file__).parents[1] / "report" / "templates" / "card.html"
FIGURE = re.compile(r"(?<![\w.#-])\d+(?:,\d{3})*(?:\.\d+)?(?: ?%)?(?![\w%])")
WORDED = "overlap of at least 0.5; at 0.6; 95 %; AP50 95; half; 0.05 0.95; 0 1"
"""Figures of sentences that the code has, not the template."""


def leaves(value: object) -> Iterator[object]:
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    yield from (leaf for part in parts for leaf in leaves(part))
    if isinstance(value, dict):
        yield from value
    if not isinstance(value, (dict, list)):
        yield value


def written(card: dict) -> set[str]:
    """Every way in which the page may write a value of the card."""
    found: set[str] = set()
    for value in leaves(card):
        if isinstance(value, bool) or value is None:
            continue
        if isinstance(value, str):
            found.update(FIGURE.findall(value))
            continue
        found |= {f"{value:g}", f"{value:,}", str(value), f"{100 * value:.1f}", f"{value:.2f}"}
        if 0 <= value <= 1:
            found |= {
                percent(float(value)),
                percent(float(value)).removesuffix(" %"),
                f"{value:.0%}",
                f"{100 * value:.0f}",
            }
        found.add(f"{math.floor(100 * value) / 100:.2f}")  # a score below the threshold is not rounded up to it
    return found


def figures(page: str) -> tuple[set[str], set[str]]:
    """Figures of the page's text, and of its plots but for their axes."""
    page = re.sub(r"<(style|pre|head)\b.*?</\1>", "", page, flags=re.DOTALL)
    plots = re.findall(r"<svg\b(?! class=\"shot\").*?</svg>", page, flags=re.DOTALL)
    text = re.sub(r"<svg\b.*?</svg>", "", page, flags=re.DOTALL)
    said = lambda part: set(FIGURE.findall(unescape(re.sub(r"<[^>]+>", " ", part))))
    labels = [label for plot in plots for label in re.findall(r"<text\b[^>]*>(.*?)</text>", plot, re.DOTALL)]
    return said(text), {figure for label in labels for figure in said(label) if figure.endswith("%")}


def unknown(folder: Path, page: str) -> set[str]:
    """Figures on the page that neither the card has, nor what stands under its pictures."""
    card, pictures = (json.loads((folder / name).read_text("utf-8")) for name in ("card.json", "pictures.json"))
    template = re.sub(r"{[{%].*?[}%]}", " ", TEMPLATE.read_text("utf-8"), flags=re.DOTALL)
    took = FIGURE.findall(duration(card["seconds"]))
    constant = {*took, *FIGURE.findall(" ".join([template, *words.ALWAYS, WORDED]))}
    known = written(card) | written(pictures) | constant
    in_text, in_plots = figures(page)
    assert len(in_text) > 10
    return (in_text - known) | (in_plots - written(card) - {f"{tick} %" for tick in range(0, 101, 10)})


@pytest.mark.slow
@pytest.mark.parametrize("name", ["glow", "dark"])
def test_every_figure_on_the_page_is_the_cards(name: str, made: tuple[Path, dict, list]) -> None:
    folder = made[0] / name
    page = (folder / "card.html").read_text("utf-8")
    assert not unknown(folder, page)
    assert unknown(folder, page.replace("</h1>", "</h1><p>hidden in 77 %, 1,234 images</p>")) == {"77 %", "1,234"}
