"""Figures in prose are those of the record that they name.

`docs/figures.toml` has the address of each: `[[figure]]` with page, text (it stands once on the page and ends with the
figure), record and place; `[[table]]` with page, record, and what its rows and columns are called in the record.

A place in a .json: keys, with slashes between, an element of a list by its "name". In a .md: the first cells of a row,
then `>` and a column; the first table that has both counts. A cell's place is its row's, ` | ` and its column's;
without the ` | ` where that begins with `>` or `/`. What a cell has in brackets is a remark.
"""

import json
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ADDRESSES = tomllib.loads((ROOT / "docs" / "figures.toml").read_text("utf-8"))
TABLE = re.compile(r"(?:^\|.*\n)+", re.MULTILINE)
FIGURE = re.compile(r"(-?\d[\d,]*(?:\.\d+)?)( %)?\D*$")


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().removeprefix("|").removesuffix("|").split("|")]


def cited_cells(rows: dict[str, str], columns: dict[str, str], page: str) -> list[tuple[str, str]]:
    """The text and the place of each cell whose row and column are both named, of the one table that has them all."""
    (table,) = (t for t in TABLE.findall(page) if all(f"| {row} |" in t for row in rows))
    header, _, *body = map(cells, table.splitlines())
    return [
        (row[header.index(column)].split(" (")[0], rows[row[0]] + {">": " ", "/": ""}.get(place[0], " | ") + place)
        for row in body
        if row[0] in rows
        for column, place in columns.items()
    ]


def figure(words: str) -> tuple[str, bool]:
    """The last figure in the words, and whether it is a percentage."""
    found = FIGURE.search(words)
    assert found, f"no figure in {words!r}"
    return found[1].replace(",", ""), bool(found[2])


def recorded(path: Path, place: str) -> tuple[float, bool]:
    """What the record says, and whether as a percentage."""
    if path.suffix == ".json":
        value = json.loads(path.read_text("utf-8"))
        for key in place.split("/"):
            value = next(x for x in value if x["name"] == key) if isinstance(value, list) else value[key]
        return float(value), False
    line_start, column = place.split(" > ")
    first, header = cells(line_start), list[str]()
    for line in path.read_text("utf-8").splitlines():
        row = cells(line) if line.startswith("|") else []
        header = row if row and not header else header if row else []
        if row[: len(first)] == first and column in header:
            text, percent = figure(row[header.index(column)].split(" (")[0])
            return float(text), percent
    raise AssertionError(f"{path.name}: no row {line_start!r} with a column {column!r}")


def agrees(words: str, path: Path, place: str) -> bool:
    """Whether a figure is the record's, rounded as the figure is."""
    (text, percent), (value, in_percent) = figure(words), recorded(path, place)
    digits = len(text.partition(".")[2])
    value *= 100 ** (int(percent) - int(in_percent))
    return abs(value - float(text)) <= 0.5 * 10**-digits + 1e-9


@pytest.mark.parametrize("address", ADDRESSES["figure"], ids=lambda address: address["text"][-30:])
def test_figures_are_those_of_their_record(address: dict[str, str]) -> None:
    page = (ROOT / address["page"]).read_text("utf-8")
    assert page.count(address["text"]) == 1, "the text does not stand once on the page"
    assert agrees(address["text"], ROOT / address["record"], address["place"])


@pytest.mark.parametrize("address", ADDRESSES["table"], ids=lambda address: address["page"])
def test_tables_are_those_of_their_record(address: dict) -> None:
    found = cited_cells(address["rows"], address["columns"], (ROOT / address["page"]).read_text("utf-8"))
    assert len(found) == len(address["rows"]) * len(address["columns"])
    for words, place in found:
        assert agrees(words, ROOT / address["record"], place), f"{words!r} is not {address['record']} : {place}"


def test_addresses_stay_out_of_the_pages() -> None:
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    assert not [page for page in pages if "<!--" in page.read_text("utf-8")]


def test_a_stale_figure_is_found(tmp_path: Path) -> None:
    of_json, of_md = tmp_path / "a.json", tmp_path / "a.md"
    of_json.write_text('{"rows": [{"name": "x", "share": 0.937}], "time": 2.114}')
    of_md.write_text("| a | b |\n|---|---|\n| x | 1 % |\n\n| a | n | c |\n|---|---|---|\n| x | 2 | 93.7 % |\n")
    for words, record, place, stale in (
        ("2.1 ms", of_json, "time", "2.2 ms"),
        ("94 %", of_json, "rows/x/share", "93 %"),
        ("0.94", of_md, "x | 2 > c", "0.93"),
    ):
        assert agrees(words, record, place) and not agrees(stale, record, place)
    page = "| of | S | other |\n|---|---|---|\n| X | 0.94 (n 3) | 1 |\n| Y | 7 | 7 |\n"
    assert cited_cells({"X": "x | 2"}, {"S": "> c"}, page) == [("0.94", "x | 2 > c")]
    with pytest.raises(ValueError, match="unpack"):
        cited_cells({"Z": "x | 2"}, {"S": "> c"}, page)
    with pytest.raises(AssertionError, match="no row"):
        agrees("1", of_md, "y > b")
