# SPDX-License-Identifier: GPL-3.0-or-later
"""Cloak's own people as objects: their skin and, where they wear any, their clothes over it."""

from __future__ import annotations

import bpy
import numpy as np

from ..blender.mesh_arrays import box_of
from ..exchange.bodies import Bodies
from .objects import add_from_scene

BODY, GARMENTS = "body", ("shirt", "trousers")
"""Regions of the clothed people that are objects of their own, in the order in which faces are numbered through."""
CLOTHES = "clothes"
"""The logo that lies on all garments."""
GAP = 0.3
"""Between a new body and what stands beside it, in Blender's units."""


def add_people(context: bpy.types.Context, bodies: Bodies, clothed: bool, name: str) -> bpy.types.Object:
    """A new body that is selected; its garments are its children.

    The body of clothed people has all their logos, also those that no skin is part of: `CLOTHES`, the shirt, the chest
    on it. An export of body and garments has the faces of `bodies`, in their order.
    """
    obj = add_from_scene(context, part_of(bodies, BODY) if clothed else bodies)
    for garment in GARMENTS if clothed else ():
        worn = add_from_scene(context, part_of(bodies, garment))
        worn.name = worn.data.name = garment.capitalize()
        worn.parent = obj
        worn.select_set(False)
    obj.name = obj.data.name = name
    obj.select_set(True)
    context.view_layer.objects.active = obj
    stand_clear(context, obj)
    return obj


def part_of(bodies: Bodies, name: str) -> Bodies:
    """The faces of a region as bodies of their own, with their colours, poses and those regions that they have.

    The skin, `BODY`, keeps the names of all regions. Vertices keep their order.
    """
    mask = bodies.regions[name]
    regions = {key: region for key, region in bodies.regions.items() if key != BODY}
    regions = {CLOTHES: np.logical_or.reduce([bodies.regions[garment] for garment in GARMENTS]), **regions}
    own = mask[bodies.triangle_face]
    vertices, loops = np.unique(bodies.loop_vertices[np.repeat(mask, bodies.loop_total)], return_inverse=True)
    return Bodies(
        vertices=bodies.vertices[:, vertices],
        triangles=np.searchsorted(vertices, bodies.triangles[own]).astype(np.int32),
        triangle_face=(np.cumsum(mask) - 1)[bodies.triangle_face[own]].astype(np.int32),
        face_colors=bodies.face_colors[:, mask],
        regions={key: region[mask] for key, region in regions.items() if name == BODY or region[mask].any()},
        names=bodies.names,
        loop_total=bodies.loop_total[mask],
        loop_vertices=loops.reshape(-1).astype(np.int32),
        name=name,
    )


def stand_clear(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Move a new body to the right until it stands in no other visible mesh, such as the cube of a new file."""
    context.view_layer.update()
    low, high = box_of(obj)
    own = {obj, *obj.children_recursive}
    meshes = [o for o in context.visible_objects if o.type == "MESH" and o not in own and len(o.data.vertices)]
    start = low[0]
    for other_low, other_high in sorted(map(box_of, meshes), key=lambda box: box[0][0]):
        if (low < other_high).all() and (other_low < high).all():
            step = other_high[0] + GAP - low[0]
            low[0], high[0] = low[0] + step, high[0] + step
    obj.location.x += low[0] - start
