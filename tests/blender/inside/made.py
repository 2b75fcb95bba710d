"""Bodies to test with, made on the spot."""

import bmesh
import bpy
import numpy as np


def link(mesh: bpy.types.Mesh, name: str = "Body") -> bpy.types.Object:
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = obj
    obj.select_set(True)
    return obj


def make_egg(rings: int = 24, height: float = 1.8, name: str = "Body") -> bpy.types.Object:
    """A closed body as tall as a person: quads with triangle fans at both poles, symmetric in X."""
    bm = bmesh.new()
    bmesh.ops.create_uvsphere(bm, u_segments=2 * rings, v_segments=rings, radius=1.0)
    bmesh.ops.scale(bm, vec=(0.35, 0.25, height / 2), verts=bm.verts)
    bmesh.ops.translate(bm, vec=(0, 0, height / 2), verts=bm.verts)
    mesh = bpy.data.meshes.new(name)
    bm.to_mesh(mesh)
    bm.free()
    return link(mesh, name)


def add_ngons(obj: bpy.types.Object, every: int = 7) -> None:
    """Merge pairs of neighbouring quads into hexagons, all over the body."""
    bm = bmesh.new()
    bm.from_mesh(obj.data)
    used, chosen = set(), []
    for edge in list(bm.edges)[::every]:
        if len(edge.link_faces) == 2 and all(len(f.verts) == 4 and f not in used for f in edge.link_faces):
            used.update(edge.link_faces)
            chosen.append(edge)
    bmesh.ops.dissolve_edges(bm, edges=chosen, use_verts=False)
    bm.to_mesh(obj.data)
    bm.free()
    assert any(len(polygon.vertices) > 4 for polygon in obj.data.polygons)


def make_grid(faces: int = 55_000, name: str = "Grid") -> bpy.types.Object:
    """At least `faces` triangles on a plane that stands up and faces the front."""
    side = int(np.ceil((faces / 2) ** 0.5)) + 1
    x, z = np.meshgrid(np.linspace(-1, 1, side), np.linspace(0, 2, side))
    points = np.stack([x.ravel(), 0.01 * np.sin(9 * x.ravel()), z.ravel()], -1)
    a = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    triangles = np.concatenate([np.stack([a, a + 1, a + side + 1], -1), np.stack([a, a + side + 1, a + side], -1)])
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points.tolist(), [], triangles.tolist())
    return link(mesh, name)


def set_mode(mode: str) -> None:
    bpy.ops.object.mode_set(mode=mode)


def select_only(obj: bpy.types.Object, ids) -> None:
    """Select faces in Edit Mode and stay there."""
    from cloak import faces

    mask = np.zeros(len(obj.data.polygons), bool)
    mask[list(ids)] = True
    set_mode("EDIT")
    bpy.context.tool_settings.mesh_select_mode = (False, False, True)
    faces.select_faces(obj, mask)


def centers(obj: bpy.types.Object) -> np.ndarray:
    values = np.empty(3 * len(obj.data.polygons), np.float32)
    obj.data.polygons.foreach_get("center", values)
    return values.reshape(-1, 3)
