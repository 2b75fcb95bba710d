"""Draw the rooms of cloak_core and who imports whom, from the table that tests/test_rooms.py holds the code against."""

from __future__ import annotations

import ast
import textwrap
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WIDE, HIGH, BETWEEN, GAP = 190, 86, 18, 30
"""A room's box and the free space beside and below it, in units of the picture."""
LANE = 14
"""From a box to the line that passes beside it, and from such a line to the next."""


def rooms_svg() -> str:
    """A picture of all rooms, the lowest at the bottom; an arrow leads to each room that is imported next below."""
    below = directions()
    floors = floors_of(below)
    columns = max(map(len, floors))
    width, height = columns * (WIDE + BETWEEN) - BETWEEN, len(floors) * (HIGH + GAP) - GAP
    corners = {
        room: ((width - len(floor) * (WIDE + BETWEEN) + BETWEEN) / 2 + i * (WIDE + BETWEEN), height - HIGH - y)
        for y, floor in zip(range(0, height, HIGH + GAP), floors, strict=False)
        for i, room in enumerate(floor)
    }
    floor_of = {room: number for number, floor in enumerate(floors) for room in floor}
    arrows = [(room, other) for room in corners for other in sorted(nearest(room, below))]
    far = [(room, other) for room, other in arrows if floor_of[room] - floor_of[other] > 1]
    shapes = [arrow(corners[room], corners[other]) for room, other in arrows if (room, other) not in far]
    for number, (room, other) in enumerate(far, 1):
        shapes.append(detour(corners[room], corners[other], width, number * LANE))
    shapes += [box(room, *corner) for room, corner in corners.items()]
    beside = len(far) * LANE + 2
    frame = f"{-beside} -2 {width + 2 * beside} {height + 4}"
    return "\n".join(
        [
            '<div class="rooms">',
            f'<svg viewBox="{frame}" role="img" aria-label="The rooms of cloak_core"'
            ' fill="none" stroke="currentColor" font-family="sans-serif">',
            '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8"'
            ' orient="auto"><path d="M0 0L8 4L0 8" /></marker></defs>',
            *shapes,
            "</svg></div>",
        ]
    )


def directions() -> dict[str, set[str]]:
    """Which rooms each room may import; the commands and the benchmarks may import all others."""
    tree = ast.parse((ROOT / "tests" / "test_rooms.py").read_text("utf-8"))
    (table,) = (
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "MAY_IMPORT"
    )
    below = ast.literal_eval(table)
    return below | {"bench": set(below), "commands": {*below, "bench"}}


def floors_of(below: dict[str, set[str]]) -> list[list[str]]:
    """List rooms from the lowest to the highest floor: each stands right above the highest that it may import."""
    floor: dict[str, int] = {}
    while len(floor) < len(below):
        ready = [room for room in below if room not in floor and below[room] <= floor.keys()]
        floor |= {room: max((floor[other] + 1 for other in below[room]), default=0) for room in ready}
    return [[room for room in below if floor[room] == number] for number in range(max(floor.values()) + 1)]


def nearest(room: str, below: dict[str, set[str]]) -> set[str]:
    """The rooms that it may import and reaches through no other room."""
    return below[room] - {far for other in below[room] for far in below[other]}


def box(room: str, x: float, y: float) -> str:
    """A room's frame, its name, and the first sentence of its docstring."""
    docstring = ast.get_docstring(ast.parse((ROOT / "cloak_core" / room / "__init__.py").read_text("utf-8"))) or ""
    lines = textwrap.wrap(
        " ".join(docstring.replace("`", "").split()).partition(". ")[0].rstrip("."), 31, max_lines=4, placeholder=" …"
    )
    text = [f'<text x="{x + 10}" y="{y + 19}" font-size="14" font-weight="bold">{room}</text>']
    text += [
        f'<text x="{x + 10}" y="{y + 36 + 14 * i}" font-size="10.5">{escape(line)}</text>'
        for i, line in enumerate(lines)
    ]
    frame = f'<rect x="{x}" y="{y}" width="{WIDE}" height="{HIGH}" rx="6" fill="var(--md-default-bg-color)" />'
    return frame + '<g fill="currentColor" stroke="none">' + "".join(text) + "</g>"


def arrow(start: tuple[float, float], end: tuple[float, float]) -> str:
    """A line from the bottom of one box to the top of another."""
    return (
        f'<path d="M{start[0] + WIDE / 2} {start[1] + HIGH}L{end[0] + WIDE / 2} {end[1]}"'
        ' opacity="0.6" marker-end="url(#tip)" />'
    )


def detour(start: tuple[float, float], end: tuple[float, float], width: float, away: float) -> str:
    """A line around the floors between two boxes, on the side that the lower one is nearer to, `away` from the edge."""
    is_left = end[0] + WIDE / 2 <= width / 2
    side = 0 if is_left else WIDE
    lane = -away if is_left else width + away
    return (
        f'<path d="M{start[0] + side} {start[1] + HIGH / 2}H{lane}V{end[1] + HIGH / 2}H{end[0] + side}"'
        ' opacity="0.6" marker-end="url(#tip)" />'
    )
