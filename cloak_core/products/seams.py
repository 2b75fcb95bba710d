"""Which borders of a layout are sewn together, and marks that meet when they are.

A seam is a stretch of border edges that two charts share (or one chart has twice, as a sleeve does). Along it marks
stand at the same places on both sides, under the same name; a border that nothing is sewn to is a hem and has none.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Integer

from cloak_core.exchange.bodies import Bodies
from cloak_core.products.layout import SAME, Layout, welded

SPACING = 0.08
"""Metres between marks, about; a short seam has one."""


@dataclass(frozen=True, eq=False)
class Mark:
    """A place on a chart's border that meets its like on another."""

    name: str
    """The seam's letters and the mark's number, alike on both sides: "B3"."""
    chart: int
    point: np.ndarray
    """[2] metres on the sheet."""
    outwards: np.ndarray
    """[2], of length 1: away from the chart."""


@dataclass(frozen=True, eq=False)
class Borders:
    """The border edges of all charts, E of them."""

    chart: Integer[np.ndarray, " E"]
    ends: Integer[np.ndarray, "E 2"]
    """Vertices, equal ones merged, in the order of the triangle: the chart lies to the left."""
    lines: Float[np.ndarray, "E 2 2"]
    """Both ends on the sheet, metres."""
    lengths: Float[np.ndarray, " E"]
    """On the body, metres."""


def seam_marks(layout: Layout, bodies: Bodies) -> list[Mark]:
    """List the marks of all seams, the two of a name one after the other."""
    borders = find_borders(layout, bodies)
    sides: dict[tuple[int, int], list[int]] = defaultdict(list)
    for edge, (low, high) in enumerate(np.sort(borders.ends, axis=1).tolist()):
        sides[low, high].append(edge)
    between: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
    for pair in sides.values():
        if len(pair) == 2:
            edge_a, edge_b = sorted(pair, key=lambda edge: (borders.chart[edge], edge))
            between[int(borders.chart[edge_a]), int(borders.chart[edge_b])].append((edge_a, edge_b))
    seams = [seam for charts in sorted(between) for seam in _seams(borders, between[charts])]
    return [mark for number, seam in enumerate(seams) for mark in _marks(borders, seam, _letters(number))]


def find_borders(layout: Layout, bodies: Bodies) -> Borders:
    """Find the edges at which a chart ends."""
    vertices = welded(bodies.vertices[0], SAME)[bodies.triangles[layout.triangles]]
    ends = np.stack([vertices, np.roll(vertices, -1, axis=1)], axis=2).reshape(-1, 2)
    lines = np.stack([layout.corners, np.roll(layout.corners, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    solid = bodies.vertices[0][bodies.triangles[layout.triangles]].astype(np.float64)
    lengths = np.linalg.norm(np.roll(solid, -1, axis=1) - solid, axis=2).reshape(-1)
    chart = np.repeat(layout.chart, 3)
    # Inner edges stand twice in a chart and lie at the same place on the sheet; a sleeve's seam lies at two places.
    where = np.round(np.sort(lines.sum(axis=1), axis=1) / SAME).astype(np.int64)
    keys = np.concatenate([chart[:, None], np.sort(ends, axis=1), where], axis=1)
    _, inverse, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    border: Bool[np.ndarray, " E"] = (count[inverse.reshape(-1)] == 1) & (ends[:, 0] != ends[:, 1])
    return Borders(chart[border], ends[border], lines[border], lengths[border])


Seam = list[tuple[int, int, int]]
"""Edges in order: the two border edges that are sewn together, and the vertex at which the seam comes to them."""


def _seams(borders: Borders, edges: list[tuple[int, int]]) -> list[Seam]:
    """Join the edges between two charts into unbroken lines, each from one end to the other (a ring from anywhere)."""
    at: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for edge in edges:
        for vertex in borders.ends[edge[0]].tolist():
            at[vertex].append(edge)
    left = dict.fromkeys(edges)
    seams = []
    # Ends and crossings first, so that a line is not begun in its middle.
    for start in sorted(at, key=lambda vertex: (len(at[vertex]) == 2, vertex)):
        while any(edge in left for edge in at[start]):
            seam: Seam = []
            vertex = start
            while following := [edge for edge in at[vertex] if edge in left]:
                if seam and len(at[vertex]) != 2:
                    break
                seam.append((*following[0], vertex))
                del left[following[0]]
                vertex = sum(borders.ends[following[0][0]].tolist()) - vertex
            seams.append(seam)
    return seams


def _marks(borders: Borders, seam: Seam, letters: str) -> list[Mark]:
    lengths = borders.lengths[[edge for edge, _, _ in seam]]
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    count = max(1, round(along[-1] / SPACING))
    marks = []
    for number in range(count):
        place = along[-1] * (number + 0.5) / count
        step = min(int(np.searchsorted(along, place, side="right")) - 1, len(seam) - 1)
        fraction = (place - along[step]) / max(lengths[step], 1e-12)
        *edges, entry = seam[step]
        for edge in edges:
            # Measured from the same vertex on both sides, whichever way round each triangle goes.
            start, end = borders.lines[edge]
            ahead = fraction if borders.ends[edge, 0] == entry else 1 - fraction
            direction = end - start
            outwards = np.array([direction[1], -direction[0]]) / max(np.linalg.norm(direction), 1e-12)
            name = f"{letters}{number + 1}" if count > 1 else letters
            marks.append(Mark(name, int(borders.chart[edge]), start + ahead * direction, outwards))
    return marks


def _letters(number: int) -> str:
    """Name by letters: A, B ... Z, AA, AB ..."""
    letters = ""
    number += 1
    while number:
        number, rest = divmod(number - 1, 26)
        letters = chr(ord("A") + rest) + letters
    return letters
