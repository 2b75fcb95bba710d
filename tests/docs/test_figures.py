"""Figures in prose are those of the record that they name.

`docs/figures.toml` has the address of each: `[[figure]]` with page, text (it stands once on the page and ends with the
figure; points = true: in hundredths, without "%"), record and place; `[[table]]` with page, record, and what its rows
and columns are called in the record.

A place in a .json: keys, with slashes between, an element of a list by its "name". In a .csv: the first cells of a row,
then `>` and a column. A cell's place is its row's, ` | ` and its column's; without the ` | ` where that begins with
`>` or `/`. What a cell has in brackets is a remark.
"""

import csv
import json
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ADDRESSES = tomllib.loads((ROOT / "docs" / "figures.toml").read_text("utf-8"))
TABLE = re.compile(r"(?:^\|.*\n)+", re.MULTILINE)
USER = re.search(r"Use it:\n(.*?)\n  - ", (ROOT / "mkdocs.yml").read_text("utf-8"), re.DOTALL)[1]
REPORTS = [path.relative_to(ROOT).as_posix() for path in sorted((ROOT / "docs" / "reports").glob("*.md"))]
REPORTS.remove("docs/reports/reliability.md")  # written by the tests that measure what it says
PAGES = ["README.md", *re.findall(r": (docs/\S+\.md)", USER), *REPORTS]
"""Whose rates all stand in a record."""
RATE = re.compile(r"(?<![\w.@=/-])(?:\d[\d,]*(?:\.\d+)? %|[01]\.\d\d+\b)")
CODE = re.compile(r"`[^`\n]*`|^    [^\n]*$|^```.*?^```", re.MULTILINE | re.DOTALL)
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


def recorded(path: Path, place: str) -> float:
    """What the record says."""
    if path.suffix == ".json":
        value = json.loads(path.read_text("utf-8"))
        for key in place.split("/"):
            value = next(x for x in value if x["name"] == key) if isinstance(value, list) else value[key]
        return float(value)
    line_start, column = place.split(" > ")
    first = cells(line_start)
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    row = next((row for row in rows if row[: len(first)] == first), None)
    assert row and column in header, f"{path.name}: no row {line_start!r} with a column {column!r}"
    return float(row[header.index(column)])


def agrees(words: str, path: Path, place: str, points: bool = False) -> bool:
    """Whether a figure is the record's, rounded as the figure is."""
    (text, percent), value = figure(words), recorded(path, place)
    digits = len(text.partition(".")[2])
    return abs(value * (100 if percent or points else 1) - float(text)) <= 0.5 * 10**-digits + 1e-9


@pytest.mark.parametrize("address", ADDRESSES["figure"], ids=lambda address: address["text"][-30:])
def test_figures_are_those_of_their_record(address: dict[str, str]) -> None:
    page = (ROOT / address["page"]).read_text("utf-8")
    assert page.count(address["text"]) == 1, "the text does not stand once on the page"
    assert agrees(address["text"], ROOT / address["record"], address["place"], address.get("points", False))


@pytest.mark.parametrize("address", ADDRESSES["table"], ids=lambda address: address["page"])
def test_tables_are_those_of_their_record(address: dict) -> None:
    found = cited_cells(address["rows"], address["columns"], (ROOT / address["page"]).read_text("utf-8"))
    assert len(found) == len(address["rows"]) * len(address["columns"])
    for words, place in found:
        assert agrees(words, ROOT / address["record"], place), f"{words!r} is not {address['record']} : {place}"


def held(page: str, text: str) -> set[int]:
    """Where figures stand that are held against a record; the name of a row that is held counts as one."""
    places = set()
    for address in ADDRESSES["figure"]:
        if address["page"] == page:
            places.add(text.index(address["text"]) + FIGURE.search(address["text"]).start(1))
    for address in (address for address in ADDRESSES["table"] if address["page"] == page):
        for table in TABLE.finditer(text):
            if not all(f"| {row} |" in table[0] for row in address["rows"]):
                continue
            start, header = table.start(), cells(table[0].splitlines()[0])
            for line in table[0].splitlines(keepends=True):
                for name, cell in zip(header, re.finditer(r"(?<=\|)[^|\n]+", line), strict=False):
                    if cells(line)[0] in address["rows"] and (name in address["columns"] or cell.start() == 1):
                        places |= {start + i for i in range(*cell.span())}
                start += len(line)
    return places


def unheld(page: str, text: str) -> list[str]:
    """Percentages and rates in two digits, outside code, that stand in no record and are no plain ones."""
    prose = CODE.sub(lambda code: " " * len(code[0]), text)
    known = {"95 %", *ADDRESSES["plain"].get(page, ())}
    places = held(page, text)
    return [rate[0] for rate in RATE.finditer(prose) if rate[0] not in known and rate.start() not in places]


@pytest.mark.parametrize("page", PAGES)
def test_no_rate_stands_without_a_record(page: str) -> None:
    text = (ROOT / page).read_text("utf-8")
    assert unheld(page, text) == []
    assert unheld(page, text + "\nIt hides 12.5 % of them, or 0.125.\n") == ["12.5 %", "0.125"]


def test_addresses_stay_out_of_the_pages() -> None:
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    assert not [page for page in pages if "<!--" in page.read_text("utf-8")]
