"""Cloth and other simulations, and caches from files: exported as they lie in each frame, played before or not."""

import bpy
import numpy as np
import pytest
from cloak.blender import faces
from cloak.poses import export as scene_export
from cloak.poses.export import poses_reason
from cloak.poses.poses import PoseChoice
from made import make_egg

FRAMES = PoseChoice("RANGE", 5, 21, 8)


def make_sheet(obj: bpy.types.Object, kind: str, columns: int = 8) -> bpy.types.Object:
    """A level sheet above the body, its child, that falls: simulated from frame 1 on."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=columns, y_subdivisions=8, size=0.6, location=(0, 0, 1.9))
    sheet = bpy.context.object
    sheet.name, sheet.parent = "Sheet", obj
    if kind == "NODES":
        sheet.modifiers.new("Falls", "NODES").node_group = make_falling()
    else:
        modifier = sheet.modifiers.new("Falls", kind)
        modifier.point_cache.frame_start, modifier.point_cache.frame_end = 1, 40
        if kind == "SOFT_BODY":
            modifier.settings.use_goal = False
    bpy.context.view_layer.objects.active = obj
    bpy.context.view_layer.update()
    return sheet


def make_falling() -> bpy.types.NodeTree:
    """Geometry that sinks by a centimetre in every frame."""
    tree = bpy.data.node_groups.new("Falling", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    names = ("NodeGroupInput", "GeometryNodeSimulationInput", "GeometryNodeSetPosition")
    begin, enter, move = (tree.nodes.new(name) for name in names)
    leave, end = (tree.nodes.new(name) for name in ("GeometryNodeSimulationOutput", "NodeGroupOutput"))
    enter.pair_with_output(leave)
    move.inputs["Offset"].default_value = (0, 0, -0.01)
    tree.links.new(begin.outputs[0], enter.inputs["Geometry"])
    for one, other in ((enter, move), (move, leave)):
        tree.links.new(one.outputs["Geometry"], other.inputs["Geometry"])
    tree.links.new(leave.outputs["Geometry"], end.inputs[0])
    return tree


def heights(bodies, obj: bpy.types.Object) -> np.ndarray:
    """[P, V] of the sheet's vertices."""
    return bodies.vertices[:, len(obj.data.vertices) :, 1]


def played(sheet: bpy.types.Object) -> np.ndarray:
    """The same, by playing the scene from its beginning."""
    found = []
    for frame in range(1, FRAMES.end + 1):
        bpy.context.scene.frame_set(frame)
        if frame in range(FRAMES.start, FRAMES.end + 1, FRAMES.step):
            evaluated = sheet.evaluated_get(bpy.context.evaluated_depsgraph_get())
            found.append([(evaluated.matrix_world @ vertex.co).z for vertex in evaluated.data.vertices])
    return np.array(found)


@pytest.mark.parametrize("kind", ["CLOTH", "SOFT_BODY", "NODES"])
def test_what_was_never_played_is_played(kind):
    """Left at a frame in its middle, with steps between poses, from a first pose after the simulation's start."""
    obj = make_egg(8)
    expected = played(make_sheet(obj, kind))
    assert np.diff(expected.mean(1)).max() < -0.05, "the sheet falls"
    bpy.data.objects.remove(bpy.data.objects["Sheet"])
    make_sheet(obj, kind)
    bpy.context.scene.frame_set(17)
    bodies = scene_export.export_bodies(bpy.context, obj, FRAMES)[0]
    assert np.abs(heights(bodies, obj) - expected).max() < 2e-3
    assert bpy.context.scene.frame_current == 17


@pytest.mark.skipif(not bpy.app.build_options.alembic, reason="this Blender was built without Alembic")
def test_an_alembic_cache_is_exported_frame_by_frame(tmp_path):
    """The body and its falling sheet as another program hands them over; a logo lies on both."""
    obj = make_egg(8)
    expected = played(make_sheet(obj, "CLOTH"))
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 1, FRAMES.end
    file = str(tmp_path / "walk.abc")
    bpy.ops.wm.alembic_export(filepath=file, as_background_job=False)
    for gone in list(bpy.data.objects):
        bpy.data.objects.remove(gone)
    bpy.ops.wm.alembic_import(filepath=file, as_background_job=False)
    body, sheet = bpy.data.objects["Body"], bpy.data.objects["Sheet"]
    bpy.context.view_layer.objects.active = body
    sheet.parent = body
    for worn in (body, sheet):
        faces.new_logo(worn, "chest", np.arange(len(worn.data.polygons)) < 3)
    bpy.context.view_layer.update()
    assert not poses_reason(bpy.context, FRAMES)
    bodies = scene_export.export_bodies(bpy.context, body, FRAMES, "chest")[0]
    assert np.abs(heights(bodies, body) - expected).max() < 2e-3
