# SPDX-License-Identifier: GPL-3.0-or-later
"""Cloak's own people as objects: their skin and, where they wear any, their clothes over it."""

from pathlib import Path

import bpy
import numpy as np

from ..blender import colors
from ..blender.marks import OUTFIT, layer_name
from ..blender.mesh_arrays import box_of, choose
from ..exchange.bodies import Bodies
from ..files.errors import InputError
from .objects import blender_axes

BODY, GARMENTS = "body", ("shirt", "trousers")
"""Regions of the clothed people that are objects of their own, in the order in which faces are numbered through."""
CLOTHES = "clothes"  # the logo that lies on all garments
ASSETS = Path(__file__).parents[1] / "assets"  # of the built extension: some sample people, and ready cloaks
GAP = 0.3  # distance between a new body and its neighbour, in Blender's units


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
    obj.name = obj.data.name = name
    choose(context, obj)
    stand_clear(context, obj)
    return obj


def part_of(bodies: Bodies, name: str) -> Bodies:
    """Extract the faces of a region as separate bodies, with colours, poses and regions.

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
    """Move a new body to the right until it intersects no visible mesh, such as the cube of a new file."""
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


def add_from_scene(context: bpy.types.Context, bodies: Bodies) -> bpy.types.Object:
    """A new mesh object from a scene package: poses as shape keys over the frames 1..P, regions as logos.

    The outfits become our colour attributes in the role `OUTFIT`, the first shown by a material.
    """
    mesh = bpy.data.meshes.new(bodies.name)
    poses = blender_axes(bodies.vertices)
    loop_total, loop_vertices = bodies.loop_total, bodies.loop_vertices
    if loop_total is None:
        loop_total, loop_vertices = np.full(bodies.triangle_count, 3, np.int32), bodies.triangles.ravel()
    faces = np.split(loop_vertices, np.cumsum(loop_total)[:-1])
    mesh.from_pydata(np.ascontiguousarray(poses[0], np.float32), (), faces, shade_flat=False)
    if mesh.validate():
        raise InputError(f"scene '{mesh.name}': Blender had to repair its faces, so face ids would not fit any more")
    for name, mask in bodies.regions.items():
        mesh.attributes.new(name, "BOOLEAN", "FACE").data.foreach_set("value", mask)
    obj = bpy.data.objects.new(bodies.name, mesh)
    context.collection.objects.link(obj)
    for number, outfit in enumerate(bodies.face_colors, 1):
        colors.write_face_colors(obj, OUTFIT if number == 1 else f"{OUTFIT}.{number}", outfit)
    mesh.materials.append(colors.attribute_material(layer_name(mesh, OUTFIT), OUTFIT, "Cloak Outfit"))
    colors.show_attribute(obj, OUTFIT)
    if bodies.pose_count > 1:
        _key_poses(obj, poses, bodies.names)
    if context.mode == "OBJECT":
        choose(context, obj)
    return obj


def _key_poses(obj: bpy.types.Object, poses: np.ndarray, names: tuple[str, ...]) -> None:
    """Key pose p as a shape key that is 1 on frame p + 1 and 0 on all others."""
    obj.shape_key_add(name=names[0], from_mix=False)
    for index in range(1, len(poses)):
        key = obj.shape_key_add(name=names[index], from_mix=False)
        key.data.foreach_set("co", np.ascontiguousarray(poses[index], np.float32).ravel())
        for frame, value in ((index, 0.0), (index + 1, 1.0), (index + 2, 0.0)):
            key.value = value
            key.keyframe_insert("value", frame=frame)
        key.value = 0.0
    obj.data.shape_keys.name = f"{obj.name} poses"
