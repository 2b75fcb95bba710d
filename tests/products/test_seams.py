"""The garment's own pieces, and marks that meet when they are sewn."""

from dataclasses import replace

import numpy as np
import pytest

from cloak_core.core.geometry import face_areas
from cloak_core.core.logo import Cover, select_region
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.patterns.faces import FacePattern
from cloak_core.products.layout import lay_out, signed_areas
from cloak_core.products.printing import print_pattern
from cloak_core.products.seams import SPACING, find_borders, seam_marks
from cloak_core.sources.bodies.people.samples import sample_bodies

AROUND, UP = 24, 10
RADIUS, HEIGHT = 0.1, 0.5


def sleeve(mirrored: bool = False) -> Bodies:
    """An open tube whose UV map is one rectangle: its left and right sides are sewn together, its ends are hems."""
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    rows = [np.stack([RADIUS * np.sin(angle), np.full(AROUND, y), RADIUS * np.cos(angle)], 1) for y in levels()]
    u, v = np.meshgrid(np.arange(AROUND + 1) / AROUND, levels() / HEIGHT)
    uv = np.stack([-u if mirrored else u, v], axis=-1).reshape(-1, 2)
    triangles, on_map = [], []
    for row in range(UP):
        for column in range(AROUND):
            a, b = row * AROUND + column, row * AROUND + (column + 1) % AROUND
            p = row * (AROUND + 1) + column
            triangles += [(a, b, b + AROUND), (a, b + AROUND, a + AROUND)]
            on_map += [(p, p + 1, p + AROUND + 2), (p, p + AROUND + 2, p + AROUND + 1)]
    vertices = np.concatenate(rows)[None].astype(np.float32)
    return Bodies(vertices, np.int32(triangles), uv=uv.astype(np.float32), triangle_uv=np.int32(on_map))


def levels() -> np.ndarray:
    """Not evenly, so that marks lie within edges."""
    return HEIGHT * (np.arange(UP + 1) / UP) ** 1.3


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_garments_own_pieces_keep_their_shape_and_are_not_mirrored(mirrored):
    body = sleeve(mirrored)
    layout = lay_out(body, np.arange(body.face_count), own_pattern=True)
    assert layout.chart_count == 1 and (signed_areas(layout.corners) > 0).all()
    assert signed_areas(layout.corners).sum() == pytest.approx(face_areas(body).sum(), rel=1e-5)
    width, height = np.ptp(layout.corners.reshape(-1, 2), axis=0)
    # The map is a square, the tube is not: its area is kept, and its stretch is said.
    assert width == pytest.approx(height, rel=1e-5) and layout.stretch_mean > 1.05


def test_the_two_sides_of_a_sleeve_carry_the_same_marks_at_the_same_heights():
    body = sleeve()
    layout = lay_out(body, np.arange(body.face_count), own_pattern=True)
    marks = seam_marks(layout, body)
    count = round(HEIGHT / SPACING)
    assert [mark.name for mark in marks] == [f"A{n}" for n in range(1, count + 1) for _ in range(2)]
    low, high = layout.corners.reshape(-1, 2).min(axis=0), layout.corners.reshape(-1, 2).max(axis=0)
    for number, (one, other) in enumerate(zip(marks[::2], marks[1::2], strict=True)):
        assert one.point[1] == pytest.approx(other.point[1], abs=1e-6)
        assert sorted([one.point[0], other.point[0]]) == pytest.approx([low[0], high[0]], abs=1e-6)
        assert one.outwards == pytest.approx(-other.outwards) and abs(one.outwards[0]) == pytest.approx(1)
        assert np.sign(one.outwards[0]) == (1 if one.point[0] > other.point[0] else -1)
        share = (one.point[1] - low[1]) / (high[1] - low[1])
        assert min(abs(share - (number + 0.5) / count), abs(1 - share - (number + 0.5) / count)) < 1e-3


def test_marks_of_one_name_are_one_place_on_the_body():
    body = sample_bodies("unseen").select_poses([0])
    layout = lay_out(body, select_region(body, "chest"))
    borders, marks = find_borders(layout, body), seam_marks(layout, body)
    assert len(marks) >= 4
    _, merged = np.unique(np.round(body.vertices[0] / 1e-6), axis=0, return_inverse=True)
    place = np.zeros((merged.max() + 1, 3))
    place[merged.reshape(-1)] = body.vertices[0]

    def on_body(mark) -> np.ndarray:
        start, end = borders.lines[:, 0], borders.lines[:, 1]
        along = ((mark.point - start) * (end - start)).sum(1) / np.maximum(((end - start) ** 2).sum(1), 1e-18)
        away = np.linalg.norm(start + along.clip(0, 1)[:, None] * (end - start) - mark.point, axis=1)
        edge = np.where(borders.chart == mark.chart, away, np.inf).argmin()
        first, last = place[borders.ends[edge]]
        return first + along[edge] * (last - first)

    for one, other in zip(marks[::2], marks[1::2], strict=True):
        assert one.name == other.name and np.linalg.norm(on_body(one) - on_body(other)) < 1e-6


@pytest.mark.slow
def test_an_allowance_surrounds_the_pieces_and_takes_room(tmp_path):
    body = sleeve()
    colors = np.full((body.face_count, 3), 0.5, np.float32)
    grey = FacePattern(Cover(np.arange(body.face_count), body.topology), colors=colors)
    told = [
        print_pattern(body, grey, tmp_path / str(cm), dpi=30, own_pattern=True, allowance=cm / 100) for cm in (0.0, 5.0)
    ]
    assert told[0]["marks"] == told[1]["marks"] == round(HEIGHT / SPACING) and told[1]["pages"] > told[0]["pages"]
    with pytest.raises(InputError, match="an allowance of 6 cm"):
        print_pattern(body, grey, tmp_path / "wide", allowance=0.06)
    with pytest.raises(InputError, match="has no UV map"):
        print_pattern(replace(body, uv=None, triangle_uv=None), grey, tmp_path / "none", own_pattern=True)
    assert not (tmp_path / "wide").exists() and not (tmp_path / "none").exists()
