# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies: the mesh object that wears the logo. Checks, topology, subdivision, and bodies built from a scene package.

Plain functions over objects and meshes; whatever is wrong with the user's object is an `InputError` whose one line says
what to do next.
"""

import functools
from collections.abc import Callable
from pathlib import Path

import bmesh
import bpy
import numpy as np

from ..blender import colors
from ..blender.faces import logo_names
from ..blender.marks import ORIGINAL_FACE, OUTFIT, PREFIX, free_name, layer_name, mark
from ..blender.mesh_arrays import box_of, choose
from ..exchange.bodies import Bodies
from ..files.errors import InputError
from ..session import session
from ..ui.window import show_progress

NO_BODY = "Choose a body first"
BODY, GARMENTS = "body", ("shirt", "trousers")
"""Regions of the clothed people that are objects of their own, in the order in which faces are numbered through."""
CLOTHES = "clothes"  # the logo that lies on all garments
ASSETS = Path(__file__).parents[1] / "assets"  # of the built extension: some sample people, and ready cloaks
GAP = 0.3  # distance between a new body and its neighbour, in Blender's units


def active_body(context: bpy.types.Context) -> bpy.types.Object:
    """Return the active object; raise `InputError` unless it is a mesh that may be changed."""
    obj = context.view_layer.objects.active if context.view_layer else None
    require_body(obj)
    return obj


def object_of(uid: int) -> bpy.types.Object | None:
    """The object with this `session_uid`, which stays when it is renamed; None when it is gone."""
    return next((obj for obj in bpy.data.objects if obj.session_uid == uid), None)


def below(obj: bpy.types.Object, among: set | None) -> set:
    """Those among some objects (None for all) that are the object's children, or theirs."""
    if among is None:
        return set(obj.children_recursive)
    return {one for one in among if one.parent and (one.parent == obj or below(obj, {one.parent}))}


def require_body(obj: bpy.types.Object | None) -> None:
    """Raise `InputError` unless `obj` is a local, single-user mesh object with faces."""
    if obj is None:
        raise InputError("No active object: click the character's mesh in the viewport")
    if obj.type != "MESH":
        meshes = [child.name for child in session.kept(below, obj) if child.type == "MESH"]
        hint = f"click '{min(meshes)}' instead" if meshes else "click the character's mesh in the viewport"
        raise InputError(f"'{obj.name}' is not a mesh ({obj.type.lower()}): {hint}")
    mesh = obj.data
    library = obj.library or mesh.library
    if library or obj.override_library or mesh.override_library:
        what = f"linked from {library.name}" if library else "a library override"
        raise InputError(f"'{obj.name}' is {what}: Object > Relations > Make Local > Selected Objects and Data")
    users = mesh.users - mesh.use_fake_user
    if users > 1:
        raise InputError(
            f"Mesh '{mesh.name}' is shared by {users} objects: Object > Relations > Make Single User > Object & Data"
        )
    if obj.mode != "EDIT" and not mesh.polygons:
        raise InputError(f"'{obj.name}' has no faces: click the character's mesh in the viewport")


def require_upright(obj: bpy.types.Object) -> None:
    """Raise `InputError` when the object's transform mirrors or flattens the body."""
    determinant = obj.matrix_world.determinant()
    if not np.isfinite(determinant) or determinant == 0:
        raise InputError(f"'{obj.name}' is scaled to nothing: set its scale, then apply it (Ctrl A > Scale)")
    if determinant < 0:
        raise InputError(
            f"'{obj.name}' has a negative scale, which turns its faces inside out: apply it (Ctrl A > Scale), "
            "then Mesh > Normals > Recalculate Outside"
        )


def subdivide(obj: bpy.types.Object, triangulate: bool = True) -> tuple[int, int]:
    """One level of simple subdivision in place: triangles 1 -> 4, quads 1 -> 4, n-gons 1 -> n quads.

    With `triangulate` every face ends as triangles. Shape keys, vertex groups, materials, UVs and face attributes (so
    also logos) carry over; each face keeps the index it came from in our attribute `ORIGINAL_FACE`.
    """
    mesh, editing = obj.data, obj.mode == "EDIT"
    bm = bmesh.from_edit_mesh(mesh) if editing else bmesh.new()
    if not editing:
        bm.from_mesh(mesh)
    before = len(bm.faces)
    if not layer_name(mesh, ORIGINAL_FACE):
        layer = bm.faces.layers.int.new(free_name(obj, PREFIX + ORIGINAL_FACE))
        mark(mesh, ORIGINAL_FACE, layer.name)
        for index, face in enumerate(bm.faces):
            face[layer] = index
    show_progress(0.05)
    _split(obj, bm, keep_quads=not triangulate)
    after = len(bm.faces)
    if editing:
        bmesh.update_edit_mesh(mesh, destructive=True)
    else:
        bm.to_mesh(mesh)
        bm.free()
        mesh.update()
    return before, after


def _split(obj: bpy.types.Object, bm: bmesh.types.BMesh, keep_quads: bool) -> None:
    hidden_name, corner_name = free_name(obj, PREFIX + "hidden"), free_name(obj, PREFIX + "corner")
    hidden = any(face.hide for face in bm.faces)
    if hidden:  # splitting does not hand the flag down reliably
        layer = bm.faces.layers.int.new(hidden_name)
        for face in bm.faces:
            face[layer] = face.hide
    has_ngons = any(len(f.verts) > 4 for f in bm.faces)
    corner = bm.verts.layers.int.new(corner_name)
    for vert in bm.verts if has_ngons else ():
        vert[corner] = True
    show_progress(0.1)
    middles = bmesh.ops.subdivide_edges(bm, edges=bm.edges[:], cuts=1, use_grid_fill=True)["geom_inner"]
    show_progress(0.5)
    if has_ngons:
        for element in middles:
            if isinstance(element, bmesh.types.BMVert):
                element[corner] = False  # new vertices take over the flags of the old
        _split_ngons(bm, corner_name, keep_quads)
    if not keep_quads:
        bmesh.ops.triangulate(bm, faces=[f for f in bm.faces if len(f.verts) > 3])
    show_progress(0.9)
    if hidden:
        layer = bm.faces.layers.int[hidden_name]
        for face, flag in [(face, face[layer]) for face in bm.faces]:
            if face.hide != flag:
                face.hide_set(flag)
        bm.faces.layers.int.remove(layer)
    bm.verts.layers.int.remove(bm.verts.layers.int[corner_name])


def _split_ngons(bm: bmesh.types.BMesh, corner_name: str, keep_quads: bool) -> None:
    """Faces that edge subdivision left as one polygon with 2n corners get a centre, as Simple subdivision has it."""
    corner = bm.verts.layers.int[corner_name]
    for face in [f for f in bm.faces if len(f.verts) > 4]:
        ring = list(face.verts)
        (center,) = bmesh.ops.poke(bm, faces=[face], center_mode="MEAN")["verts"]
        _average(bm, center, [v for v in ring if v[corner]])
        if keep_quads:
            spokes = [e for e in center.link_edges if e.other_vert(center)[corner]]
            bmesh.ops.dissolve_edges(bm, edges=spokes, use_verts=False)


def _average(bm: bmesh.types.BMesh, vert: bmesh.types.BMVert, ring: list[bmesh.types.BMVert]) -> None:
    """Give `vert` the mean position, shape keys and weights of `ring`."""
    for layer in bm.verts.layers.shape.values():
        vert[layer] = sum((v[layer] for v in ring[1:]), ring[0][layer].copy()) / len(ring)
    deform = bm.verts.layers.deform.active
    if deform is not None:
        groups = {group for v in ring for group in v[deform].keys()}  # noqa: SIM118
        vert[deform].clear()
        for group in groups:
            vert[deform][group] = sum(v[deform].get(group, 0.0) for v in ring) / len(ring)


def blender_axes(vertices: np.ndarray) -> np.ndarray:
    """Scene axes (y up, facing +z) to Blender's (z up, facing -y): [..., 3] -> [..., 3]."""
    return np.stack((vertices[..., 0], -vertices[..., 2], vertices[..., 1]), -1)


def scene_axes(vertices: np.ndarray) -> np.ndarray:
    """The inverse of `blender_axes`."""
    return np.stack((vertices[..., 0], vertices[..., 2], -vertices[..., 1]), -1)


# --- Cloak's own people as objects: their skin and, where they wear any, their clothes over it ------------------------


def add_people(context: bpy.types.Context, bodies: Bodies, clothed: bool, name: str) -> bpy.types.Object:
    """A new body that is selected; its garments are its children.

    The body keeps the logos on its clothes, too (`CLOTHES`, the shirt, the chest on it), though it has no faces there.
    An export of body and garments has the faces of `bodies`, in their order.
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


# --- reasons ----------------------------------------------------------------------------------------------------------


def refusal(check: Callable, *arguments: object) -> str:
    """What `check` has against its arguments; "" when nothing."""
    try:
        check(*arguments)
    except InputError as error:
        return str(error)
    return ""


def body_reason(context: bpy.types.Context) -> str:
    """Why there is no usable body."""
    return refusal(active_body, context)


def of_the_body(reason: Callable[[bpy.types.Context, bpy.types.Object], str]) -> Callable[[bpy.types.Context], str]:
    """A reason that asks about the active body; where there is none, why not."""

    @functools.wraps(reason)
    def asked(context: bpy.types.Context, *details: object) -> str:
        return body_reason(context) or reason(context, active_body(context), *details)

    return asked


@of_the_body
def logo_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why there is no logo to train."""
    if logo_names(obj.data):
        return ""
    if others := session.kept(_wearing_logos, obj):
        return f"No logo on '{obj.name}'; '{min(o.name for o in others)}' has one: click that, or make one here"
    return "Make a logo first"


def _wearing_logos(obj: bpy.types.Object, among: set | None) -> set:
    objects = bpy.context.view_layer.objects if among is None else among
    has_logo = functools.cache(logo_names)  # thousands of objects may share a mesh
    return {o for o in objects if o.type == "MESH" and o != obj and has_logo(o.data)}


@of_the_body
def upright_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why nothing can be stamped onto the body."""
    return refusal(require_upright, obj)
