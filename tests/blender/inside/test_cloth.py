"""A run of a cloth that repeats: on the model as an image, as fine as it is printed; nothing is left when it is off."""

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from cloak.blender import colors, faces, mesh_arrays, pictures
from cloak.body import garments
from cloak.body.objects import ASSETS
from cloak.exchange.face_lists import read_face_list
from cloak.poses.export import export
from cloak.poses.poses import PoseChoice
from cloak.training import runs
from cloak.training.run_list import read_state
from cloths_made import METRES, SQUARES, cloth_run, random_squares, save_picture, wall
from made import made_run, make_egg, set_mode


def test_the_logo_shows_the_picture_and_the_rest_its_own_material(clothed):
    obj, ids, _ = clothed
    slot = [obj.material_slots[p.material_index].material for p in obj.data.polygons]
    assert {m.name for i, m in enumerate(slot) if i not in set(ids.tolist())} == {"Skin"}
    (material,) = {slot[i] for i in ids.tolist()}
    (texture,) = (node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeTexImage")
    assert (texture.interpolation, texture.extension) == ("Closest", "REPEAT")
    assert texture.image.packed_file is not None and tuple(texture.image.size) == (SQUARES, SQUARES)
    assert [layer.name for layer in obj.data.uv_layers] == ["cloak.cloth"]
    assert np.allclose(colors.written_colors(obj)[ids], 0.5, atol=1e-5), "the faces' means stand beside it"
    assert np.allclose(colors.own_face_colors(obj), 0.8, atol=0.15), "the cloak is not part of the body's own look"


def leftovers() -> tuple:
    """What a cloth could leave in a file."""
    images = [image.name for image in bpy.data.images]
    materials = [material for material in bpy.data.materials if material.node_tree]
    shown = [m.name for m in materials for n in m.node_tree.nodes if n.bl_idname == "ShaderNodeTexImage"]
    return images, shown, [layer.name for mesh in bpy.data.meshes for layer in mesh.uv_layers]


def test_nothing_of_a_cloth_stays_when_it_is_off(clothed, tmp_path):
    obj, _, _ = clothed
    for _ in range(2):
        bpy.context.scene.cloak.look = "LOOKDEV"
        bpy.context.scene.cloak.look = "SEEN"
        bpy.ops.cloak.result_load()
        assert leftovers() == (["cloak.cloth"], ["Cloak as Detectors Saw"], ["cloak.cloth"])
        bpy.ops.cloak.result_toggle()
        assert not colors.is_dressed(obj) and leftovers() == ([], [], [])
        bpy.ops.cloak.result_toggle()
        assert colors.is_dressed(obj)
    (tmp_path / "other").mkdir()
    runs.import_colors(bpy.context, obj, made_run(tmp_path / "other", obj, [3], np.float32([[1, 0, 0]])))
    assert leftovers() == ([], [], []) and colors.is_dressed(obj), "another run, of colours of faces"


def test_any_picture_is_worn_as_cloth(tmp_path):
    obj, squares = wall(0.4), random_squares()[:4]
    obj.data.attributes.new("logo", "BOOLEAN", "FACE").data.foreach_set("value", np.arange(9) != 4)
    save_picture(tmp_path / "print.png", squares)
    bpy.context.scene.cloak.output = str(tmp_path / "runs")
    bpy.ops.cloak.cloth_picture(filepath=str(tmp_path / "print.png"), width=METRES)
    run = runs.run_of(obj)
    image, worn = colors.worn_cloth(obj.data)
    assert run.name == "Grid print" and np.flatnonzero(~worn).tolist() == [4] and read_state(run).state == "done"
    assert np.abs(pictures.image_pixels(image)[::-1, :, :3] - squares).max() < 1e-6
    uv = mesh_arrays.read(obj.data.uv_layers["cloak.cloth"].uv, "vector", 2)
    assert np.allclose([uv.min(0), uv.max(0)], [[-0.5, -1], [0.5, 1]], atol=1e-5), "half as high as it is wide"
    bpy.ops.cloak.result_toggle()
    bpy.ops.cloak.result_toggle()
    assert leftovers()[0] == ["cloak.cloth"]
    folder = str(tmp_path / "nothing.png")
    for wrong, words in ((folder, "nothing.png: "), (str(run / "config.json"), "not a picture that Blender can read")):
        with pytest.raises(RuntimeError, match=words):
            bpy.ops.cloak.cloth_picture(filepath=wrong)
    assert len(list((tmp_path / "runs").iterdir())) == 2, "the run and its input"


@pytest.mark.parametrize("modifier", ["TRIANGULATE", "SUBSURF"])
def test_a_picture_goes_onto_bodies_whose_modifiers_make_faces(tmp_path, modifier):
    obj = make_egg(12)
    obj.modifiers.new("more", modifier)
    faces.new_logo(obj, "logo", np.arange(len(obj.data.polygons)) < 50)
    save_picture(tmp_path / "print.png", np.full((2, 2, 3), 0.2, np.float32))
    bpy.context.scene.cloak.output = str(tmp_path / "runs")
    bpy.ops.cloak.cloth_picture(filepath=str(tmp_path / "print.png"), width=METRES)
    assert colors.worn_cloth(obj.data)[1].sum() == 50
    assert np.abs(colors.written_colors(obj)[:50] - 0.2).max() < 1.01 / 255


def test_the_cloth_is_saved_with_the_file_and_comes_off_after(clothed, tmp_path):
    obj, ids, squares = clothed
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "cloaked.blend"))
    (runs.run_of(obj) / "cloth.png").rename(tmp_path / "elsewhere.png")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "cloaked.blend"))
    obj = bpy.data.objects["Body"]
    image, worn = colors.worn_cloth(obj.data)
    assert np.abs(pictures.image_pixels(image)[::-1, :, :3] - squares).max() < 1e-6
    assert np.flatnonzero(worn).tolist() == ids.tolist()
    bpy.ops.cloak.result_toggle()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "cloaked.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "cloaked.blend"))
    assert leftovers() == ([], [], [])


def test_it_lies_as_in_the_first_pose_of_the_training(tmp_path):
    """Whatever pose the body has when the colours come back."""
    obj = wall(0.4)
    obj.data.attributes.new("logo", "BOOLEAN", "FACE").data.foreach_set("value", np.ones(9, bool))
    run = cloth_run(tmp_path, obj, np.arange(9), random_squares())
    export(bpy.context, obj, "logo", PoseChoice(), runs.input_folder(run))
    obj.rotation_euler.z = np.pi / 2
    obj.location = (5, 5, 0)
    bpy.context.view_layer.update()
    runs.import_colors(bpy.context, obj, run)
    uv = mesh_arrays.read(obj.data.uv_layers["cloak.cloth"].uv, "vector", 2)
    assert np.allclose([uv.min(0), uv.max(0)], [[-0.5, -0.5], [0.5, 0.5]], atol=1e-5)


def test_what_is_wrong_with_a_cloth_is_said_and_nothing_is_changed(tmp_path):
    obj = make_egg()
    run = cloth_run(tmp_path, obj, [3], random_squares())
    obj.cloak.run = str(run)
    (run / "config.json").write_text("{}")
    with pytest.raises(RuntimeError, match=r"config\.json: does not say how wide cloth\.png is"):
        bpy.ops.cloak.result_load()
    (run / "config.json").write_text('{"settings": {"tile_cm": 25}}')
    (run / "cloth.png").write_text("no picture")
    with pytest.raises(RuntimeError, match=r"cloth\.png: not a picture that Blender can read"):
        bpy.ops.cloak.result_load()
    assert leftovers() == ([], [], []) and not obj.data.color_attributes and not colors.is_dressed(obj)
    set_mode("EDIT")
    with pytest.raises(RuntimeError, match="Leave Edit Mode"):
        bpy.ops.cloak.result_load()


@pytest.mark.parametrize("modifier", ["", "SUBSURF"])
def test_a_garment_wears_its_part_of_the_cloth(tmp_path, modifier):
    """In an export that numbers body and garment through, each has its own corners."""
    obj = make_egg()
    shirt = wall(0.4)
    shirt.parent = obj
    if modifier:  # there are no polygons of the meshes in the export then
        shirt.modifiers.new("more", modifier)
    bpy.context.view_layer.objects.active = obj
    for one in (obj, shirt):
        count = len(one.data.polygons)
        one.data.attributes.new("logo", "BOOLEAN", "FACE").data.foreach_set("value", np.ones(count, bool))
    run = tmp_path / "run"
    done = export(bpy.context, obj, "logo", PoseChoice(), runs.input_folder(run))
    ids = read_face_list(done.face_list).ids
    made_run(tmp_path, obj, ids, np.full((len(ids), 3), 0.5, np.float32), name="run")
    save_picture(run / "cloth.png", random_squares())
    (run / "config.json").write_text(json.dumps({"settings": {"tile_cm": 100 * METRES}}))
    runs.import_colors(bpy.context, obj, run)
    assert leftovers()[2] == ["cloak.cloth", "UVMap", "cloak.cloth"]
    uv = mesh_arrays.read(shirt.data.uv_layers["cloak.cloth"].uv, "vector", 2)
    assert np.allclose([uv.min(0), uv.max(0)], [[-0.5, -0.5], [0.5, 0.5]], atol=1e-5)
    garments.undress(obj)
    assert leftovers() == ([], [], ["UVMap"])


# --- the asset library -----------------------------------------------------------------------------------------------

PRINTS = {f"print-{name}" for name in ("balls", "ellipses", "crowd", "dots", "checks", "stripes")}


@pytest.fixture
def library() -> Path:
    """The library's file, found as the Asset Browser finds it."""
    (ours,) = (found for found in bpy.context.preferences.filepaths.asset_libraries if found.name == "Cloak")
    (file,) = Path(ours.path).glob("*.blend")
    return file


def take(file: Path, name: str) -> bpy.types.Material:
    """What dragging an asset onto an object brings into the file."""
    with bpy.data.libraries.load(str(file), assets_only=True) as (there, here):
        here.materials = [name]
    assert name in there.materials
    return here.materials[0]


def test_every_cloth_of_ours_is_an_asset(library):
    with bpy.data.libraries.load(str(library), assets_only=True) as (there, here):
        here.materials = list(there.materials)
    assert {material.name for material in here.materials} == PRINTS | {"transfer-people"}
    for material in here.materials:
        assert material.asset_data.license == "CC0-1.0" and "0.25 m" in material.asset_data.description
        assert tuple(material.preview.image_size) == (128, 128)
        assert np.ptp(np.array(material.preview.image_pixels_float).reshape(-1, 4)[:, :3]) > 0.5, "a picture of it"
    image = pictures.cloth_of(bpy.data.materials["transfer-people"])
    there = pictures.read_picture(ASSETS / "transfer-people" / "cloth.png")
    assert image.packed_file and np.array_equal(pictures.image_pixels(image), there)


def test_a_cloth_is_laid_as_large_as_it_is_printed(library):
    obj = wall(0.5)
    obj.data.uv_layers.new(name="cloak.ready_cloth").uv.foreach_set("vector", np.full(72, 0.25, np.float32))
    with pytest.raises(RuntimeError, match="drag one from the Asset Browser"):
        bpy.ops.cloak.lay_cloth()
    obj.data.materials.append(take(library, "print-dots"))
    bpy.ops.cloak.lay_cloth()
    uv, users = (mesh_arrays.read(obj.data.uv_layers[f"cloak.ready_cloth{n}"].uv, "vector", 2) for n in (".001", ""))
    assert np.allclose([uv.min(0), uv.max(0)], [[-1, -1], [1, 1]], atol=1e-5), "two pieces of 25 cm along half a metre"
    assert np.allclose(users, 0.25), "the user's map of that name is left alone"
    assert obj.data.uv_layers.active.name == "UVMap", "the user's own"
    (node,) = (n for n in obj.active_material.node_tree.nodes if n.bl_idname == "ShaderNodeUVMap")
    assert node.uv_map == "cloak.ready_cloth.001"
