"""Step 2: logos in both modes, their figures, face lists."""

import json

import bpy
import numpy as np
import pytest
from cloak.blender import faces
from cloak.blender.mesh_arrays import topology
from cloak.body.objects import logo_reason
from cloak.exchange.face_lists import write_face_list
from cloak.files.errors import InputError
from cloak.logo import operators
from made import centers, logo_ids, make_egg, select_only, set_mode


def test_a_logo_lives_through_edit_mode_saving_and_renaming(tmp_path):
    obj = make_egg()
    select_only(obj, range(100, 140))
    bpy.ops.cloak.logo_new(name="Brüstung")
    assert np.array_equal(logo_ids(obj, "Brüstung"), np.arange(100, 140))
    set_mode("OBJECT")
    assert np.array_equal(logo_ids(obj, "Brüstung"), np.arange(100, 140))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "body.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "body.blend"))
    obj = bpy.data.objects["Body"]
    assert faces.logo_names(obj.data) == ["Brüstung"] and obj.cloak.logo == "Brüstung"
    assert faces.read_faces(obj, "Brüstung").sum() == 40
    obj.data.attributes["Brüstung"].name = "chest"
    assert faces.logo_names(obj.data)[0] == "chest"
    assert obj.data.attributes[obj.cloak.logo_index].name == "chest"  # the only logo is the active one


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
def test_assign_remove_select(mode):
    obj = make_egg()
    select_only(obj, range(10))
    set_mode(mode)
    bpy.ops.cloak.logo_new(name="a")
    select_only(obj, range(5, 20))
    set_mode(mode)
    bpy.ops.cloak.logo_assign()
    assert np.array_equal(logo_ids(obj, "a"), np.arange(20))
    select_only(obj, range(3))
    set_mode(mode)
    bpy.ops.cloak.logo_unassign()
    bpy.ops.cloak.logo_select()
    assert np.array_equal(np.flatnonzero(faces.read_selection(obj)), np.arange(3, 20))
    bpy.ops.cloak.logo_remove()
    assert not faces.logo_names(obj.data)


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
def test_hidden_faces_of_a_logo_stay_unselected(mode):
    obj = make_egg()
    faces.write_faces(obj, "a", np.arange(len(obj.data.polygons)) < 6)
    obj.data.polygons.foreach_set("hide", np.arange(len(obj.data.polygons)) < 2)
    set_mode(mode)
    bpy.ops.cloak.logo_select()
    set_mode("OBJECT")
    assert [polygon.index for polygon in obj.data.polygons if polygon.select] == [2, 3, 4, 5]


def test_empty_and_foreign_logos_are_refused_by_name():
    other = make_egg(name="Other")
    faces.new_logo(other, "chest", np.ones(len(other.data.polygons), bool))
    obj = make_egg()
    with pytest.raises(InputError, match="Logo 'chest' is on 'Other', not on 'Body': make 'Other' the active object"):
        faces.require_logo(obj, "chest")
    assert "'Other' has one" in logo_reason(bpy.context)
    with pytest.raises(InputError, match="has no logo 'x'"):
        faces.require_logo(obj, "x")
    with pytest.raises(RuntimeError, match="No faces selected"):
        faces.select_faces(obj, np.zeros(len(obj.data.polygons), bool))
        bpy.ops.cloak.logo_new()
    faces.write_faces(obj, "void", np.zeros(len(obj.data.polygons), bool))
    with pytest.raises(InputError, match="'void' is empty"):
        faces.require_logo(obj, "void")
    faces.write_faces(obj, "two", np.arange(len(obj.data.polygons)) < 2)
    assert faces.require_logo(obj, "two+void").sum() == 2


# --- face lists ------------------------------------------------------------------------------------------------------


def test_export_and_import_of_a_face_list(tmp_path):
    obj = make_egg()
    path = tmp_path / "Gesichter ä.npy"
    select_only(obj, [5, 3, 99])
    bpy.ops.cloak.logo_new(name="few")
    bpy.ops.cloak.logo_export(filepath=str(path))
    ids = np.load(path)
    assert ids.dtype == np.int64 and ids.tolist() == [3, 5, 99]
    sidecar = json.loads(path.with_suffix(".json").read_text())
    assert sidecar["topology"] == topology(obj) and sidecar["index_of"] == "polygon"
    bpy.ops.cloak.logo_import(filepath=str(path))
    assert logo_ids(obj, obj.cloak.logo).tolist() == [3, 5, 99]


def test_a_foreign_face_list_is_refused_with_both_hashes(tmp_path):
    stranger = make_egg(rings=10, name="Stranger")
    write_face_list(tmp_path / "list.npy", np.array([1]), topology(stranger))
    obj = make_egg()
    with pytest.raises(InputError) as caught:
        faces.import_face_list(obj, tmp_path / "list.npy")
    assert topology(obj) in str(caught.value) and topology(stranger) in str(caught.value)
    np.save(tmp_path / "bare.npy", np.array([10**6]))
    with pytest.raises(InputError, match="beyond the"):
        faces.import_face_list(obj, tmp_path / "bare.npy")
    np.arange(3, dtype=np.int32).tofile(tmp_path / "noise.npy")
    with pytest.raises(InputError, match="not a readable"):
        faces.import_face_list(obj, tmp_path / "noise.npy")
    assert not faces.logo_names(obj.data)


# --- heat map --------------------------------------------------------------------------------------------------------


def test_heatmap_and_the_logo_taken_from_it(stub):
    from conftest import run_job

    obj = make_egg()
    bpy.ops.cloak.heatmap()
    job = run_job()
    assert job.state == "done", job.message
    assert "cloak.heatmap" in obj.data.color_attributes
    assert not job.log.parent.exists()  # nothing is left of the measurement but the map
    bpy.context.scene.cloak.heat_share = 0.1
    bpy.ops.cloak.logo_from_heat()
    mask, areas = faces.read_faces(obj, "Heat"), faces.face_areas(obj)
    assert areas[mask].sum() / areas.sum() == pytest.approx(0.1, abs=areas.max() / areas.sum())
    density = np.arange(len(mask)) / areas  # the stub's heat is the face's index
    assert density[mask].min() >= density[~mask].max()  # not simply the faces of the greatest index
    assert not mask[np.argsort(density)[0]] and mask.sum() != mask[-int(mask.sum()) :].sum()


# --- what belongs together already -----------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
def test_a_logo_of_a_material_counts_what_the_cloak_covers(mode):
    from cloak.blender import colors

    obj = make_egg()
    shirt = centers(obj)[:, 2] > 0.9
    for name in ("skin", "shirt"):
        obj.data.materials.append(bpy.data.materials.new(name))
    obj.data.polygons.foreach_set("material_index", shirt.astype(np.int32))
    colors.write_face_colors(obj, "colors", np.zeros((len(shirt), 3)))
    colors.dress(obj, np.flatnonzero(shirt)[:20])
    set_mode(mode)
    bpy.ops.cloak.logo_from_material(slot="1")
    assert obj.cloak.logo == "shirt" and np.array_equal(logo_ids(obj, "shirt"), np.flatnonzero(shirt))
    bpy.ops.cloak.logo_from_material(slot="0", add=True)
    assert len(logo_ids(obj, "shirt")) == len(shirt)


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
@pytest.mark.parametrize(("name", "title"), [("Körper teile", "Körper teile 7"), (".sculpt_face_set", "Face Set 7")])
def test_a_logo_of_a_face_set_or_of_any_integer_attribute(mode, name, title):
    obj = make_egg()
    upper = centers(obj)[:, 2] > 0.9
    with pytest.raises(RuntimeError, match=r"poll\(\).*no face sets"):
        bpy.ops.cloak.logo_from_face_set()
    values = obj.data.attributes.new(name, "INT", "FACE").data
    values.foreach_set("value", np.where(upper, 7, -1).astype(np.int32))
    set_mode(mode)
    assert [value for value, _, _ in operators.face_sets(obj)] == [f"-1 {name}", f"7 {name}"]
    bpy.ops.cloak.logo_from_face_set(face_set=f"7 {name}")
    assert np.array_equal(logo_ids(obj, title), np.flatnonzero(upper))
