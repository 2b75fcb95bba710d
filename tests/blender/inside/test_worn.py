"""What the camera sees: one answer for figures, export, judging and renders."""

import math

import bpy
import pytest
from cloak.blender import colors, faces
from cloak.body import garments
from cloak.files.errors import InputError
from cloak.logo import overlay
from cloak.poses import export as scene_export
from cloak.poses.export import export_summary
from cloak.poses.poses import PoseChoice
from cloak.result.evaluations import export_worn, judged_reason
from cloak.result.judging import check_reason
from cloak.training import runs
from conftest import folder_of, run_job
from made import centers, make_egg


@pytest.fixture
def chest(stub, tmp_path) -> bpy.types.Object:
    """A body whose logo lies in front, at half its height."""
    obj = make_egg()
    places = centers(obj)
    faces.new_logo(obj, "chest", (places[:, 1] < -0.1) & (abs(places[:, 2] - 0.9) < 0.3))
    bpy.context.scene.cloak.output, bpy.context.scene.cloak.steps = str(tmp_path / "runs"), 4
    return obj


def add_shirt(obj: bpy.types.Object, tied: bool = True, name: str = "Shirt") -> bpy.types.Object:
    """A garment around the middle of the body."""
    shirt = make_egg(16, 1.1, name)
    shirt.scale, shirt.location.z = (1.2, 1.2, 1), 0.35
    shirt.parent = obj if tied else None
    bpy.context.view_layer.objects.active = obj
    bpy.context.view_layer.update()
    return shirt


def test_what_lies_on_the_body_is_seen_and_what_stands_beside_it_is_not(chest):
    shirt, hat = add_shirt(chest), add_shirt(chest, tied=False, name="Hat")
    bpy.ops.mesh.primitive_cube_add(size=2, location=(0, 0, 1))
    other = make_egg(12, name="Neighbour")
    other.location.x = 2
    bpy.ops.mesh.primitive_plane_add(size=10)
    bpy.context.view_layer.objects.active = chest
    bpy.context.view_layer.update()
    assert garments.worn_by(chest) == [hat, shirt]
    assert "with Hat, Shirt" in export_summary(bpy.context)
    hat.hide_set(True)
    assert garments.worn_by(chest) == [shirt]
    bpy.data.objects["Shirt"].cloak.left_out = True
    assert garments.worn_by(chest) == [] and garments.wearable(chest) == [shirt]


def test_figures_say_what_covers_the_logo_and_count_only_what_is_seen(chest):
    bare = overlay.active_stats(chest)
    assert bare.covered == () and bare.projected_area > 0.1
    assert math.isclose(bare.whole_projected_area, math.pi * 0.35 * 0.9, rel_tol=0.02)
    shirt = add_shirt(chest)
    ((name, share),) = overlay.active_stats(chest).covered
    assert name == "Shirt" and share > 0.9
    assert overlay.active_stats(chest).projected_area < 0.1 * bare.projected_area
    bpy.ops.cloak.logo_onto(garment="Shirt")
    worn = overlay.active_stats(chest)
    assert worn.covered == () and worn.projected_area > 0.8 * bare.projected_area
    assert faces.logo_names(shirt.data) == ["chest"]
    over = centers(shirt)[faces.read_faces(shirt, "chest")]
    assert (over[:, 1] < 0).all(), "the back stays plain"
    shirt.data.attributes.remove(shirt.data.attributes["chest"])
    bpy.data.objects["Shirt"].cloak.left_out = True
    assert overlay.active_stats(chest) == bare


def test_training_and_judging_see_the_same_pieces_or_say_which_differs(chest):
    shirt = add_shirt(chest)
    bpy.ops.cloak.train_start()
    assert run_job().state == "done"
    run = folder_of(chest)
    bodies = export_worn(bpy.context, chest, run, PoseChoice(), run.parent / "seen")
    assert bodies.face_count == len(chest.data.polygons) + len(shirt.data.polygons)
    assert judged_reason(bpy.context) == check_reason(bpy.context) == ""
    shirt.hide_set(True)
    assert "was trained with 'Shirt': show it again, or train again" in judged_reason(bpy.context)
    assert judged_reason(bpy.context) == check_reason(bpy.context)
    shirt.hide_set(False)
    add_shirt(chest, name="Coat")
    assert "was trained without 'Coat': leave it out" in judged_reason(bpy.context)
    with pytest.raises(InputError, match="without 'Coat'"):
        export_worn(bpy.context, chest, run, PoseChoice(), run.parent / "seen")
    bpy.data.objects["Coat"].cloak.left_out = True
    assert judged_reason(bpy.context) == ""
    assert scene_export.read_export(runs.input_folder(run)).faces == bodies.face_count


@pytest.mark.parametrize("rigged", [False, True])
def test_colours_go_to_what_the_body_itself_wears_whatever_it_is_called(chest, rigged):
    """A copied character's to the copy's shirt; one's own that is named "Shirt" stays as it is."""
    shirt = add_shirt(chest)
    bpy.ops.cloak.logo_onto(garment="Shirt")
    if rigged:
        rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
        bpy.context.collection.objects.link(rig)
        for one in (chest, shirt):
            one.modifiers.new("Rig", "ARMATURE").object = rig
    bpy.ops.cloak.train_start()
    assert run_job().state == "done" and colors.is_dressed(shirt)
    garments.undress(chest)
    copies = [one.copy() for one in (chest, shirt)]
    for copy in copies:
        copy.data = copy.data.copy()
        bpy.context.collection.objects.link(copy)
    body, worn = copies
    worn.parent = body
    shirt.name, worn.name = "Waistcoat", "Shirt"
    bpy.context.view_layer.objects.active = body
    bpy.context.view_layer.update()
    assert garments.worn_by(body) == ([chest, worn] if rigged else [worn]), "not the shirt of the body in its place"
    bpy.ops.cloak.result_load()
    assert list(map(colors.is_dressed, (body, worn, chest, shirt))) == [True, True, False, False]
    bpy.context.view_layer.objects.active = chest
    bpy.ops.cloak.result_load()
    assert colors.is_dressed(shirt), "renamed, and still the one"
    bpy.data.batch_remove([shirt, worn])
    with pytest.raises(RuntimeError, match="'Body' wears no 'Shirt' with the faces of the export"):
        bpy.ops.cloak.result_load()


def test_a_stamp_takes_what_is_seen_and_no_face_under_clothing(chest):
    shirt = add_shirt(chest)
    shirt.data.attributes.new("G", "FLOAT", "FACE")  # the user's
    settings = bpy.context.scene.cloak
    settings.stamp_center, settings.stamp_size = 0.5, 0.4
    bpy.ops.cloak.logo_stamp(add=False)
    name = chest.cloak.logo
    assert name == "G.001" and faces.read_faces(shirt, name).sum() > 10 and not faces.read_faces(chest, name).any()
    assert overlay.active_stats(chest).covered == ()
    shirt.cloak.left_out = True
    bpy.ops.cloak.logo_stamp(add=True)
    assert faces.read_faces(chest, name).sum() > 10
