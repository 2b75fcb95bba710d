"""Modifiers: they block only where faces really change, and a logo is carried to the faces they make."""

import bpy
import numpy as np
import pytest
from cloak.blender import colors, faces
from cloak.blender.evaluated import CARRIED, carried_faces, numbered_faces
from cloak.blender.mesh_arrays import topology
from cloak.exchange.face_lists import read_face_list
from cloak.exchange.scenes import read_scene
from cloak.files.errors import InputError
from cloak.poses import export as scene_export
from cloak.poses.export import poses_reason
from cloak.poses.poses import PoseChoice
from cloak.training import runs
from made import centers, made_run, make_egg

NOW = PoseChoice()


def nodes(obj, *names: str) -> bpy.types.Modifier:
    """A Geometry Nodes modifier that sends the mesh through nodes of these types."""
    tree = bpy.data.node_groups.new("Nodes", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    last = tree.nodes.new("NodeGroupInput").outputs[0]
    for name in names:
        node = tree.nodes.new(name)
        tree.links.new(last, node.inputs[0])
        last = node.outputs[0]
    tree.links.new(last, tree.nodes.new("NodeGroupOutput").inputs[0])
    modifier = obj.modifiers.new("Nodes", "NODES")
    modifier.node_group = tree
    return modifier


def half_egg() -> bpy.types.Object:
    """The half at x > 0, with a logo on its chest."""
    obj = make_egg(16)
    import bmesh

    bm = bmesh.new()
    bm.from_mesh(obj.data)
    bmesh.ops.delete(bm, geom=[v for v in bm.verts if v.co.x < -1e-4], context="VERTS")
    bm.to_mesh(obj.data)
    bm.free()
    middle = centers(obj)
    faces.new_logo(obj, "chest", (middle[:, 2] > 1) & (middle[:, 1] < 0))
    return obj


MAKE_FACES = {
    "subdivision": lambda obj: setattr(obj.modifiers.new("Subdivision", "SUBSURF"), "levels", 1),
    "mirror": lambda obj: obj.modifiers.new("Mirror", "MIRROR"),
    "solidify": lambda obj: setattr(obj.modifiers.new("Solidify", "SOLIDIFY"), "thickness", 0.02),
    "nodes": lambda obj: nodes(obj, "GeometryNodeSubdivideMesh"),
    "array": lambda obj: [obj.modifiers.new(kind.title(), kind) for kind in ("ARRAY", "TRIANGULATE")],
}
KEEP_FACES = {
    "smooth by angle": lambda obj: nodes(obj, "GeometryNodeSetShadeSmooth"),
    "empty nodes": nodes,
    "nodes without a tree": lambda obj: obj.modifiers.new("Nodes", "NODES"),
    "multires at level 0": lambda obj: obj.modifiers.new("Multires", "MULTIRES"),
    "decimate by nothing": lambda obj: obj.modifiers.new("Decimate", "DECIMATE"),
}


@pytest.mark.parametrize("add", KEEP_FACES.values(), ids=KEEP_FACES)
def test_modifiers_that_change_no_face_do_not_block(add, tmp_path):
    obj = make_egg(10)
    faces.new_logo(obj, "chest", np.arange(len(obj.data.polygons)) < 30)
    add(obj)
    bpy.context.view_layer.update()
    assert poses_reason(bpy.context) == ""
    done = scene_export.export(bpy.context, obj, "chest", NOW, tmp_path / "input")
    assert read_scene(done.scene).topology == done.topology == topology(obj)


# --- logos are carried -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("add", MAKE_FACES.values(), ids=MAKE_FACES)
def test_a_logo_and_its_colours_are_carried_to_the_faces_that_modifiers_make(add, tmp_path):
    obj = half_egg()
    own = len(obj.data.polygons)
    ids = np.flatnonzero(faces.read_faces(obj, "chest"))
    add(obj)
    bpy.context.view_layer.update()
    assert poses_reason(bpy.context) == ""
    done = scene_export.export(bpy.context, obj, "chest", NOW, tmp_path / "run.input")
    bodies = read_scene(done.scene)
    assert np.array_equal(read_face_list(done.face_list, bodies).ids, ids)
    assert bodies.face_count == own and done.topology == topology(obj)
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    assert len(evaluated.polygons) > own
    assert bodies.triangle_count == sum(len(p.vertices) - 2 for p in evaluated.polygons)
    # The triangles of the logo are those of the evaluated mesh's own copy of the attribute.
    carried = np.array([value.value for value in evaluated.attributes["chest"].data])
    expected = sum(len(p.vertices) - 2 for p in evaluated.polygons if carried[p.index])
    assert np.isin(bodies.triangle_face, ids).sum() == expected > len(ids)
    assert CARRIED not in obj.data.attributes
    # Every evaluated face shows the colour of the own face that its triangles were exported with.
    trained = np.random.default_rng(0).random((len(ids), 3)).astype(np.float32)
    runs.import_colors(bpy.context, obj, made_run(tmp_path, obj, ids, trained, bodies.topology, "run"))
    with numbered_faces([obj]):
        graph = bpy.context.evaluated_depsgraph_get()
        mesh = obj.evaluated_get(graph).to_mesh()
        own = carried_faces(obj, mesh)
        shown = np.empty(4 * len(mesh.loops), np.float32)
        mesh.color_attributes["cloak.colors"].data.foreach_get("color", shown)
        counts = np.array([p.loop_total for p in mesh.polygons])
    face_of_corner = np.repeat(own, counts)
    place = np.searchsorted(ids, face_of_corner)
    worn = np.isin(face_of_corner, ids)
    expected = colors.srgb_to_linear(trained)[place[worn]]
    assert worn.any() and np.allclose(shown.reshape(-1, 4)[worn, :3], expected, atol=1e-5)


def test_faces_that_a_modifier_takes_away_are_not_trained(tmp_path):
    obj = make_egg(10)
    mask = centers(obj)[:, 1] < 0
    faces.new_logo(obj, "front", mask)
    group = obj.vertex_groups.new(name="upper")
    group.add([v.index for v in obj.data.vertices if v.co.z > 0.9], 1.0, "REPLACE")
    obj.modifiers.new("Mask", "MASK").vertex_group = "upper"
    bpy.context.view_layer.update()
    done = scene_export.export(bpy.context, obj, "front", NOW, tmp_path / "input")
    ids = read_face_list(done.face_list, read_scene(done.scene)).ids
    upper = {v.index for v in obj.data.vertices if v.co.z > 0.9}
    assert ids.tolist() == [p.index for p in obj.data.polygons if mask[p.index] and set(p.vertices) <= upper]


# --- where they cannot be --------------------------------------------------------------------------------------------


def test_a_modifier_that_loses_the_faces_is_named_and_a_copy_offered(tmp_path):
    obj = make_egg(12)
    faces.new_logo(obj, "chest", np.arange(len(obj.data.polygons)) < 30)
    obj.modifiers.new("Half", "SUBSURF").levels = 1
    remesh = obj.modifiers.new("Clay", "REMESH")
    remesh.mode, remesh.voxel_size = "VOXEL", 0.1
    obj.modifiers.new("Bend", "SIMPLE_DEFORM")
    bpy.context.view_layer.update()
    reason = poses_reason(bpy.context)
    assert "'Clay'" in reason and "'Half'" not in reason and "Apply a Copy" in reason
    with pytest.raises(InputError, match="'Clay'"):
        scene_export.export(bpy.context, obj, "chest", NOW, tmp_path / "input")
    assert CARRIED not in obj.data.attributes and not list(tmp_path.iterdir())
    before = len(obj.data.polygons)
    bpy.ops.cloak.apply_copy()
    copy = bpy.context.view_layer.objects.active
    assert copy != obj and obj.hide_get() and len(obj.data.polygons) == before and len(obj.modifiers) == 3
    assert [m.name for m in copy.modifiers] == ["Bend"]
    faces.new_logo(copy, "chest", np.arange(len(copy.data.polygons)) < 30)
    bpy.context.view_layer.update()
    assert poses_reason(bpy.context) == ""
    scene_export.export(bpy.context, copy, "chest", NOW, tmp_path / "input")
