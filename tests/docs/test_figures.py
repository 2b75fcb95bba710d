"""Figures in prose are those of the record that they name.

`docs/figures.toml` has the address of each: `[[figure]]` with page, text (it stands once on the page and ends with the
figure), record and place; `[[table]]` with page, record, and what its rows and columns are called in the record. Older
pages name the record in a comment behind the figure: `98 %<!-- FILE : PLACE -->`.

FILE lies beside the page. PLACE in a .json: keys, with slashes between, an element of a list by its "name". In a .md:
the first cells of a row, then `>` and a column; the first table that has both counts.

A table names its record once, in a comment before it, so that people can still read it: `<!-- of FILE`, then in lines
of their own what its rows and columns are called there (`ROW = PLACE`, `COLUMN = PLACE`), then `-->`. Rows and columns
that it names are held against it. A cell's place is its row's, ` | ` and its column's; without the ` | ` where
that begins with `>`. What a cell has in brackets is a remark.
"""

import json
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
CITED = re.compile(r"([^\n]*?)<!-- ([\w./-]+\.(?:json|md)) : (.+?) -->")
TABLE = re.compile(r"<!-- of ([\w./-]+\.md)\n((?:.+ = .+\n)+)-->\n+((?:\|.*\n)+)")
FIGURE = re.compile(r"(-?\d[\d,]*(?:\.\d+)?)( %)?\D*$")


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().removeprefix("|").removesuffix("|").split("|")]


def table_citations(file: str, names: str, table: str) -> list[tuple[str, str, str]]:
    """The same for each cell whose row and column are both named; a name that the table lacks is an error."""
    places = dict(line.split(" = ", 1) for line in names.splitlines())
    header, _, *rows = map(cells, table.splitlines())
    missing = places.keys() - {*header, *(row[0] for row in rows)}
    assert not missing, f"not in the table: {missing}"
    named = [(row, places[row[0]]) for row in rows if row[0] in places]
    columns = [(header.index(name), place) for name, place in places.items() if name in header]
    return [
        (row[i].split(" (")[0], file, of_row + (" " if place.startswith(">") else " | ") + place)
        for row, of_row in named
        for i, place in columns
    ]


def citations(text: str) -> list[tuple[str, str, str]]:
    """Of each comment, and of each cell of a table that names its record: the words before, the file, the place."""
    single = [(found[1], found[2], found[3]) for found in CITED.finditer(text)]
    return single + [cited for found in TABLE.finditer(text) for cited in table_citations(found[1], found[2], found[3])]


def figure(words: str) -> tuple[str, bool]:
    """The last figure in the words, and whether it is a percentage."""
    found = FIGURE.search(words)
    assert found, f"no figure before the comment: {words!r}"
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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_figures_are_those_of_the_records_they_name(page: Path) -> None:
    for words, file, place in citations(page.read_text("utf-8")):
        assert agrees(words, page.parent / file, place), f"{words[-60:]!r} is not {file} : {place}"


ADDRESSES = tomllib.loads((ROOT / "docs" / "figures.toml").read_text("utf-8"))


@pytest.mark.parametrize("address", ADDRESSES.get("figure", []), ids=lambda address: address["text"][-30:])
def test_figures_with_an_address_are_those_of_their_record(address: dict[str, str]) -> None:
    page = (ROOT / address["page"]).read_text("utf-8")
    assert page.count(address["text"]) == 1, "the text does not stand once on the page"
    assert agrees(address["text"], ROOT / address["record"], address["place"])


@pytest.mark.parametrize("address", ADDRESSES.get("table", []), ids=lambda address: address["page"])
def test_tables_with_an_address_are_those_of_their_record(address: dict) -> None:
    tables = re.findall(r"(?:^\|.*\n)+", (ROOT / address["page"]).read_text("utf-8"), re.MULTILINE)
    names = "".join(f"{here} = {there}\n" for here, there in (address["rows"] | address["columns"]).items())
    (table,) = (t for t in tables if all(f"| {row} |" in t for row in address["rows"]))
    found = table_citations(address["record"], names, table)
    assert len(found) == len(address["rows"]) * len(address["columns"])
    for words, record, place in found:
        assert agrees(words, ROOT / record, place), f"{words!r} is not {record} : {place}"


def test_a_stale_figure_is_found(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"rows": [{"name": "x", "share": 0.937}], "time": 2.114}')
    (tmp_path / "a.md").write_text(
        "| a | b |\n|---|---|\n| x | 1 % |\n\n| a | n | c |\n|---|---|---|\n| x | 2 | 93.7 % |\n"
    )
    page = "2.1 ms<!-- a.json : time --> and 94 %<!-- a.json : rows/x/share --> or 0.94<!-- a.md : x | 2 > c -->"
    assert [agrees(words, tmp_path / file, place) for words, file, place in citations(page)] == [True, True, True]
    table = "<!-- of a.md\nX = x | 2\nS = > c\n-->\n"
    table += "| of | S | other |\n|---|---|---|\n| X | 0.94 (n 3) | 1 |\n| Y | 7 | 7 |\n"
    assert [agrees(words, tmp_path / file, place) for words, file, place in citations(table)] == [True]
    assert [
        agrees(words, tmp_path / file, place) for words, file, place in citations(table.replace("0.94", "0.95"))
    ] == [False]
    with pytest.raises(AssertionError, match="not in the table"):
        citations(table.replace("| X |", "| Z |"))
    stale = page.replace("94 %", "93 %").replace("2.1", "2.2").replace("0.94", "0.9")
    assert [agrees(words, tmp_path / file, place) for words, file, place in citations(stale)] == [False, False, True]
    with pytest.raises(AssertionError, match="no row"):
        agrees("1", tmp_path / "a.md", "y > b")
