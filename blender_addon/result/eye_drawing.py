# SPDX-License-Identifier: GPL-3.0-or-later
"""What the detector's eye saw, drawn over the viewport: boxes with scores, and a line for each kind of clothing."""

from __future__ import annotations

import bpy

from ..files.errors import InputError
from ..session import session
from ..trainer.onlooker import Seen
from ..ui.drawing import WHITE, fill, frame, short, size_of_words, width_of, write
from ..ui.window import Hooks
from . import eye
from .viewpoints import camera_frame, of_view

KINDS = {"clothing": ("Own clothing", (0.84, 0.37, 0.0)), "cloak": ("Cloak", (0.0, 0.55, 0.85))}
"""What is looked at: its name, and the sRGB colour of its boxes."""
LEFT, BELOW_TOP, LINE = 70, 110, 18
"""Position of the lines, in pixels."""
Rectangle = tuple[float, float, float, float]
"""Left, bottom, right, top in pixels."""


def place_of_picture(context: bpy.types.Context, watching: eye.Eye) -> Rectangle | None:
    """Return the last picture's rectangle in this viewport; None if the viewport shows something else."""
    region, view, seen_from = context.region, context.region_data, watching.viewpoint
    if seen_from is None or view is None:
        return None
    try:
        if not of_view(context.scene, region, view, watching.object).is_like(seen_from):
            return None
    except InputError:
        return None
    whole = (0.0, 0.0, float(region.width), float(region.height))
    return camera_frame(context) if view.view_perspective == "CAMERA" else whole


def box_in(place: Rectangle, box: tuple[float, ...], seen: Seen) -> Rectangle:
    """A box of the picture (its rows count from the top) in a viewport."""
    left, bottom, right, top = place
    across, up = (right - left) / seen.width, (top - bottom) / seen.height
    x1, y1, x2, y2 = box[:4]
    return left + x1 * across, top - y2 * up, left + x2 * across, top - y1 * up


def draw() -> None:
    """Viewport callback."""
    watching, context = session.eye, bpy.context
    if watching is None or watching.object is None or not context.space_data.overlay.show_overlays:
        return
    scale = size_of_words(context)
    place = place_of_picture(context, watching)
    if place is not None and watching.seen is not None:
        _draw_boxes(watching.seen, place, scale)
    x, y = LEFT * scale, context.region.height - BELOW_TOP * scale
    for words, color in lines(watching, place is not None):
        write(words, x, y, color)
        y -= LINE * scale


def lines(watching: eye.Eye, fits: bool) -> list[tuple[str, tuple[float, float, float]]]:
    """Return the lines at the upper left and their colours. fits: the viewport shows the last picture."""
    told = [("Detector's eye" + ("" if fits and not watching.waiting else " (looking...)"), WHITE)]
    if watching.message:
        return [("Detector's eye", WHITE), (watching.message, KINDS["clothing"][1])]
    if watching.seen is None or not fits:
        return told
    for spec, glances in watching.seen.glances.items():
        point = next(iter(glances.values())).operating_point
        told.append((f"{short(spec)} reports from {point:g}", WHITE))
        for kind, glance in glances.items():
            name, color = KINDS[kind]
            told.append((f"    {name}: {glance.describe()}", color))
    return told


def _draw_boxes(seen: Seen, place: Rectangle, scale: float) -> None:
    """Draw the reported boxes, those of the cloak with thicker lines."""
    for glances in seen.glances.values():
        for kind, glance in glances.items():
            color, thickness = KINDS[kind][1], (3 if kind == "cloak" else 2) * scale
            for box in (box for box in glance.boxes if box[4] > glance.operating_point):
                x1, y1, x2, y2 = box_in(place, box, seen)
                frame(x1, y1, x2, y2, color, thickness)
                words = f"{KINDS[kind][0]} {box[4]:.2f}"
                top = y2 if kind == "cloak" else y1 - 18 * scale  # so that two boxes' words do not meet
                fill(x1, top, width_of(words) + 8 * scale, 18 * scale, color, 0.85)
                write(words, x1 + 4 * scale, top + 5 * scale)


HOOKS = Hooks(drawing=((draw, "POST_PIXEL"),))
