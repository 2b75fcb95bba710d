# SPDX-License-Identifier: GPL-3.0-or-later
"""Success by azimuth, drawn in the viewport as a ring around the body's feet.

Outside the cloak, inside the body's own clothing: where both are blue, the detector finds nobody there anyway. Azimuths
stand where their cameras stood, so the ring is read by walking around the body.
"""

import functools
import math
from collections.abc import Sequence

import bpy
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Matrix, Vector

from ..blender import colors
from ..blender.marks import HEATMAP
from ..blender.mesh_arrays import box_of
from ..body.garments import is_dressed
from ..training import run_list
from ..ui.drawing import Shape, fill, short, size_of_words, width_of, write
from ..ui.window import Hooks
from .evaluations import Evaluation, Sector

FOUND, EVEN, HIDDEN = (0.84, 0.37, 0.0), (0.93, 0.90, 0.82), (0.0, 0.45, 0.70)
"""sRGB at success 0, a half and 1: orange to blue, which colour-blind eyes tell apart."""
OPAQUE = 0.85
INNER, MIDDLE, OUTER, TEXT = 0.62, 0.70, 0.92, 1.04
"""Radii as shares of the body's largest extent: of own clothing, between both, of the cloak, of the figures."""
STEP = 3.0  # degrees of a straight piece of the ring
NAMES = {0.0: "front", 90.0: "left", 180.0: "back", 270.0: "right"}
WIDEST = 30.0  # degrees: one azimuth alone says nothing of what is farther away from it than half of this


def color_of(success: float) -> tuple[float, float, float]:
    """sRGB of a success in [0, 1]."""
    return tuple(float(np.interp(success, (0, 0.5, 1), stops)) for stops in zip(FOUND, EVEN, HIDDEN, strict=True))


def on_circle(azimuth: float | np.ndarray) -> np.ndarray:
    """[..., 2] where an azimuth's camera stands, seen from above in Blender's axes; the front is -y."""
    turn = np.radians(azimuth)
    return np.stack([np.sin(turn), -np.cos(turn)], -1)


def ring_triangles(sectors: Sequence[Sector]) -> tuple[np.ndarray, np.ndarray]:
    """Corners [3 n, 2] around the origin, in shares of the body's extent, and their colours [3 n, 4] sRGB."""
    once = {sector.azimuth % 360: sector for sector in sectors}
    azimuths = np.sort(list(once))
    width = min(WIDEST, float(np.diff(azimuths, append=azimuths[0] + 360).min()))  # from one azimuth to the next
    turns = on_circle(np.linspace(-0.48, 0.48, max(1, math.ceil(width / STEP)) + 1) * width + azimuths[:, None])
    places, paints = [], []
    for sector, turn in zip(map(once.get, azimuths.tolist()), turns, strict=True):
        a, b = turn[:-1], turn[1:]
        bands = ((MIDDLE, OUTER, sector.cloak), (INNER, MIDDLE - 0.02, sector.clothing))
        for inner, outer, success in (band for band in bands if band[2] is not None):
            corners = (a * inner, a * outer, b * outer, a * inner, b * outer, b * inner)  # of two triangles
            places.append(np.stack(corners, 1).reshape(-1, 2))
            paints.append(np.tile((*color_of(success), OPAQUE), (len(places[-1]), 1)))
    return np.concatenate(places), np.concatenate(paints)


def stand(obj: bpy.types.Object) -> tuple[Vector, float]:
    """Return the ring's centre on the ground and the body's largest extent, in Blender's units."""
    low, high = box_of(obj)
    middle = (low + high) / 2
    return Vector((middle[0], middle[1], low[2])), float((high - low).max())


def shown(context: bpy.types.Context) -> tuple[bpy.types.Object, Evaluation] | None:
    """The body that wears its cloak, and the evaluation to draw; None for nothing."""
    obj, state = context.object, run_list.selected(context)
    if context.space_data is not None and not context.space_data.overlay.show_overlays:
        return None
    if obj is None or obj.type != "MESH" or state is None or state.evaluation is None:
        return None
    wanted = context.scene.cloak.judging.ring and obj.visible_get() and obj.data.polygons
    seen = wanted and state.evaluation.sectors and is_dressed(obj) and not colors.shows(obj, HEATMAP)
    return (obj, state.evaluation) if seen else None


@functools.lru_cache(1)
def ring_shape(sectors: tuple[Sector, ...]) -> Shape:
    """The ring as it was drawn last."""
    places, paints = ring_triangles(sectors)
    return Shape("TRIS", np.concatenate([places, np.zeros((len(places), 1))], 1), paints)


def draw_ring() -> None:
    """Viewport callback, in the space of the scene."""
    ring = shown(bpy.context)
    if ring is not None:
        place, extent = stand(ring[0])
        ring_shape(ring[1].sectors).draw(Matrix.LocRotScale(place, None, Vector((extent,) * 3)))


def draw_words() -> None:
    """Viewport callback, in pixels: figures at the ring, and its legend."""
    context = bpy.context
    ring = shown(context)
    if ring is None:
        return
    obj, evaluation = ring
    scale = size_of_words(context)
    place, extent = stand(obj)
    known = {sector.azimuth % 360: sector for sector in evaluation.sectors}
    for azimuth, name in NAMES.items():
        sector = known.get(azimuth)
        x, y = on_circle(azimuth) * extent * TEXT
        at = location_3d_to_region_2d(context.region, context.region_data, place + Vector((x, y, 0)))
        if sector is not None and at is not None:
            write(f"{name} {sector.cloak:.0%}", at.x, at.y, centered=True)
    # At the lower left: what the colours mean.
    x, y, step = 20 * scale, 20 * scale, 16 * scale
    write("found", x, y)
    start = x + width_of("found") + 6 * scale
    for index in range(11):
        fill(start + 10 * index * scale, y - 2 * scale, 10 * scale, 12 * scale, color_of(index / 10))
    write("hidden", start + 116 * scale, y)
    which = "the worst of several detectors" if len(evaluation.detectors) > 1 else evaluation.detectors[0]
    write(f"Success by azimuth at {evaluation.threshold:g}, {short(which)}", x, y + 3 * step + 4 * scale)
    write("outside: the cloak; inside: own clothing", x, y + 2 * step + 4 * scale)
    earlier = " (of earlier colours)" if evaluation.outdated else ""
    write(evaluation.describe() + earlier, x, y + step + 4 * scale)


HOOKS = Hooks(drawing=((draw_ring, "POST_VIEW"), (draw_words, "POST_PIXEL")), closing=ring_shape.cache_clear)
