"""Step 3: poses, axes, clothing, what is refused, and that the Blender scene is left as it was."""

import bpy
import numpy as np
import pytest
from cloak.blender import colors, faces
from cloak.blender.mesh_arrays import topology
from cloak.body import garments
from cloak.exchange.face_lists import read_face_list
from cloak.exchange.scenes import read_scene
from cloak.files.errors import InputError
from cloak.poses import export as scene_export
from cloak.poses.export import export_summary, poses_reason
from cloak.poses.poses import PoseChoice, list_poses
from cloak.training import runs
from made import add_ngons, made_run, make_egg, set_mode

NOW = PoseChoice()


def export(obj, choice=NOW):
    return scene_export.export_bodies(bpy.context, obj, choice)[0]


def rig(obj) -> bpy.types.Object:
    """An armature with one bone that swings the upper half."""
    data = bpy.data.armatures.new("Rig")
    armature = bpy.data.objects.new("Rig", data)
    bpy.context.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    set_mode("EDIT")
    bone = data.edit_bones.new("spine")
    bone.head, bone.tail = (0, 0, 0.9), (0, 0, 1.8)
    set_mode("OBJECT")
    group = obj.vertex_groups.new(name="spine")
    group.add([v.index for v in obj.data.vertices if v.co.z > 0.9], 1.0, "REPLACE")
    obj.modifiers.new("Armature", "ARMATURE").object = armature
    obj.parent = armature
    bpy.context.view_layer.objects.active = obj
    return armature


def swing(armature, name: str, last: int, angle: float) -> bpy.types.Action:
    bone = armature.pose.bones["spine"]
    bone.rotation_mode = "XYZ"
    armature.animation_data_create().action = bpy.data.actions.new(name)
    for frame, value in ((1, 0.0), (last, angle)):
        bone.rotation_euler.x = value
        bone.keyframe_insert("rotation_euler", frame=frame)
    return armature.animation_data.action


def test_axes_units_and_transform():
    obj = make_egg()
    obj.data.vertices[0].co = (0.1, -0.5, 1.5)  # a nose: Blender's front is -y
    obj.location, obj.scale = (1, 0, 0), (2, 2, 2)
    bpy.context.scene.unit_settings.scale_length = 0.5
    bpy.context.view_layer.update()
    bodies = export(obj)
    assert np.allclose(bodies.vertices[0, 0], [0.6, 1.5, 0.5], atol=1e-6)  # y up, facing +z, metres
    assert bodies.name == "Body" and bodies.pose_count == 1
    assert bodies.topology == topology(obj)


def test_triangles_keep_their_polygon_and_their_winding():
    obj = make_egg()
    add_ngons(obj)
    bodies = export(obj)
    corners = bodies.vertices[0][bodies.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = corners.mean(1) - bodies.vertices[0].mean(0)
    assert ((normals * outward).sum(1) > 0).mean() > 0.97  # all but a few in folded n-gons
    starts = np.concatenate(([0], np.cumsum(bodies.loop_total)))
    for triangle, face in zip(bodies.triangles[::37], bodies.triangle_face[::37], strict=True):
        assert set(triangle) <= set(bodies.loop_vertices[starts[face] : starts[face + 1]])
    assert np.array_equal(np.bincount(bodies.triangle_face), bodies.loop_total - 2)


def test_shape_keys_and_armature_over_a_frame_range_and_nothing_moved_afterwards():
    obj = make_egg()
    armature = rig(obj)
    action = swing(armature, "Bow", 11, 1.0)
    obj.shape_key_add(name="Basis")
    fat = obj.shape_key_add(name="Fat")
    for point in fat.data:
        point.co.x *= 2
    fat.value = 0.5
    scene = bpy.context.scene
    scene.frame_set(3)
    bone = armature.pose.bones["spine"]
    bone.location.z = 0.25  # not keyed
    bpy.context.view_layer.update()
    before = (scene.frame_current, bone.matrix_basis.copy(), fat.value, armature.animation_data.action)
    bodies = export(obj, PoseChoice("RANGE", 1, 11, 5))
    assert bodies.names == ("frame 1", "frame 6", "frame 11")
    assert (scene.frame_current, fat.value, armature.animation_data.action) == (3, 0.5, action)
    assert bone.matrix_basis == before[1]
    assert np.ptp(bodies.vertices[0, :, 0]) == pytest.approx(1.5 * 0.7, rel=0.01)  # the shape key is in
    heads = bodies.vertices[:, [v.co.z > 1.75 for v in obj.data.vertices]].mean(1)
    assert np.abs(heads[0, 2] - heads[2, 2]) > 0.5  # and the armature
    middle = scene_export.export_bodies(bpy.context, obj, PoseChoice("RANGE", 6, 6, 1))[0]
    assert np.allclose(middle.vertices[0], bodies.vertices[1], atol=1e-6)


def test_all_actions_that_move_the_body_and_no_others():
    obj = make_egg()
    armature = rig(obj)
    for name, last in (("Bow", 5), ("Nod", 3)):
        swing(armature, name, last, 0.5)
    bystander = bpy.data.objects.new("Bystander", None)
    bpy.context.collection.objects.link(bystander)
    bystander["speed"] = 1.0
    bystander.keyframe_insert('["speed"]', frame=1)
    armature.animation_data.action = None
    poses = list_poses(obj, PoseChoice("ACTIONS", step=2))
    assert [p.name for p in poses] == ["Bow 1", "Bow 3", "Bow 5", "Nod 1", "Nod 3"]
    basis = armature.pose.bones["spine"].matrix_basis.copy()
    bodies = export(obj, PoseChoice("ACTIONS", step=2))
    assert bodies.names == tuple(p.name for p in poses)
    assert armature.animation_data.action is None and armature.animation_data.use_nla
    assert armature.pose.bones["spine"].matrix_basis == basis
    assert not np.allclose(bodies.vertices[0], bodies.vertices[2])
    assert np.allclose(bodies.vertices[2], bodies.vertices[4], atol=1e-6)  # both end at 0.5


def test_bad_choices_of_poses():
    obj = make_egg()
    for choice, words in (
        (PoseChoice("RANGE", 5, 1, 1), "end lies before the start"),
        (PoseChoice("RANGE", 1, 9, 0), "at least 1"),
        (PoseChoice("RANGE", 1, 99_999, 1), "raise the frame step"),
        (PoseChoice("ACTIONS"), "No action moves 'Body'"),
    ):
        with pytest.raises(InputError, match=words):
            list_poses(obj, choice)


# --- clothing --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("levels", [0, 1])
def test_one_logo_goes_on_over_body_and_shirt(levels, tmp_path):
    """Colours come back to the object that each face belongs to, live and at the end, and Show Original takes both."""
    obj = make_egg(12)
    trousers, shirt = make_egg(8, 0.8, "A pair of trousers"), make_egg(10, 1.0, "Shirt")
    for worn in (shirt, trousers):  # which may have modifiers that make faces, with the logo and without
        worn.modifiers.new("Subdivision", "SUBSURF").levels = levels
        worn.parent = obj
    bpy.context.view_layer.objects.active = obj
    faces.new_logo(obj, "chest", np.isin(np.arange(len(obj.data.polygons)), [3, 50]))
    faces.new_logo(shirt, "chest", np.isin(np.arange(len(shirt.data.polygons)), [7, 9, 80]))
    obj.cloak.logo = "chest"
    bpy.context.view_layer.update()
    assert "the logo goes on over Shirt" in export_summary(bpy.context)
    done = scene_export.export(bpy.context, obj, "chest", NOW, tmp_path / "run.input")
    assert "with A pair of trousers, Shirt;" in export_summary(bpy.context)
    bodies, seen = read_scene(done.scene), trousers.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    before = len(obj.data.polygons) + len(seen.polygons)
    face_list = read_face_list(done.face_list, bodies)
    assert face_list.ids.tolist() == [3, 50, before + 7, before + 9, before + 80]
    assert bodies.face_count == before + len(shirt.data.polygons) == done.faces
    assert done.topology == topology(obj) != bodies.topology
    trained = np.random.default_rng(0).random((5, 3)).astype(np.float32)
    run = made_run(tmp_path, obj, face_list.ids, trained, bodies.topology, "run")

    def check() -> None:
        assert np.allclose(colors.written_colors(obj)[[3, 50]], trained[:2], atol=1e-5)
        assert np.allclose(colors.written_colors(shirt)[[7, 9, 80]], trained[2:], atol=1e-5)
        assert colors.is_dressed(obj) and colors.is_dressed(shirt) and not colors.is_dressed(trousers)

    live = runs.LiveColors(obj, run)
    assert live.update(bpy.context)
    check()
    garments.undress(obj)
    assert not colors.is_dressed(obj) and not colors.is_dressed(shirt)
    runs.import_colors(bpy.context, obj, run)
    check()
    garments.undress(obj)
    shirt.name = "Blouse"
    runs.import_colors(bpy.context, obj, run)
    check()


# --- colours of the body ---------------------------------------------------------------------------------------------


def test_outfit_comes_from_the_materials():
    obj = make_egg(8)
    count = len(obj.data.polygons)
    plain, painted = bpy.data.materials.new("plain"), bpy.data.materials.new("painted")
    for material in (plain, painted):
        material.use_nodes = True
    shader = plain.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (0.2158605, 0.2158605, 0.0, 1)  # 128/255
    image = bpy.data.images.new("texture", 2, 1)
    image.pixels.foreach_set(np.array([1, 0, 0, 1, 0, 0.25, 1, 1], np.float32))
    nodes = painted.node_tree.nodes
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = image
    painted.node_tree.links.new(texture.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    obj.data.materials.append(plain)
    obj.data.materials.append(painted)
    uv = obj.data.uv_layers.new(name="UV")
    uv.uv.foreach_set("vector", np.tile(np.float32([0.75, 0.5]), len(obj.data.loops)))
    slots = np.arange(count, dtype=np.int32) % 2
    obj.data.polygons.foreach_set("material_index", slots)
    colors = export(obj).face_colors[0]
    assert np.allclose(colors[slots == 0], [128 / 255, 128 / 255, 0], atol=1e-4)
    assert np.allclose(colors[slots == 1], [0, 0.25, 1], atol=1 / 255)


# --- refusals --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scale", "words"),
    [(1 / 600, "measures 3 mm: 2.2 m away it would be a few pixels"), (150, "270 m: a camera 2.2 m")],
)
def test_sizes_that_no_camera_sees_are_said_in_step_3(scale, words):
    obj = make_egg()
    obj.scale = (scale,) * 3
    bpy.context.view_layer.update()
    assert words in poses_reason(bpy.context) and "Unit Scale" in poses_reason(bpy.context)
    with pytest.raises(InputError, match=words):
        export(obj)
    bpy.context.scene.unit_settings.scale_length = 1 / scale  # modelled in other units
    assert poses_reason(bpy.context) == "" and export(obj).pose_count == 1


def test_nothing_is_half_written(tmp_path):
    obj = make_egg()
    faces.new_logo(obj, "chest", np.arange(len(obj.data.polygons)) < 9)
    obj.scale.x = -1
    bpy.context.view_layer.update()
    with pytest.raises(InputError, match="negative scale"):
        scene_export.export(bpy.context, obj, "chest", NOW, tmp_path / "input")
    obj.scale.x = 1
    bpy.context.view_layer.update()
    with pytest.raises(InputError, match="cannot be written"):
        scene_export.export(bpy.context, obj, "chest", NOW, scene_export.Path("/proc/cloak/input"))
    (tmp_path / "there").mkdir()
    with pytest.raises(InputError, match="exists already"):
        scene_export.export(bpy.context, obj, "chest", NOW, tmp_path / "there")
    assert [p.name for p in tmp_path.iterdir()] == ["there"] and not list((tmp_path / "there").iterdir())
