"""A run of a cloth that repeats: on the model as an image, as fine as it is printed; nothing is left when it is off."""

import json
import os
import struct
import subprocess
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from cloak.blender import colors, faces, mesh_arrays
from cloak.body import garments
from cloak.body import objects as body
from cloak.body.samples import ASSETS
from cloak.exchange.colors import write_colors
from cloak.exchange.face_lists import read_face_list
from cloak.exchange.scenes import read_scene
from cloak.poses.export import export
from cloak.poses.poses import PoseChoice
from cloak.result import bake, eye, render_check
from cloak.session import session
from cloak.training import runs
from cloak.training.run_states import read_state
from conftest import MODULE, ROOT, elsewhere
from made import add_camera, make_egg, set_mode
from test_colors import made_run
from test_eye import asked, watch
from test_marks import users_colors

SQUARES, METRES = 8, 0.4


def save_picture(path: Path, squares: np.ndarray) -> None:
    """A PNG of squares [h, w, 3], the first row at the top."""
    image = bpy.data.images.new("squares", squares.shape[1], squares.shape[0])
    pixels = np.ones((*squares.shape[:2], 4), np.float32)
    pixels[..., :3] = squares[::-1]
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    bpy.data.images.remove(image)


def cloth_run(folder: Path, obj: bpy.types.Object, ids: np.ndarray, squares: np.ndarray) -> Path:
    """A run of a cloth on faces of an object, whose own colours are grey."""
    run = made_run(folder, obj, ids, np.full((len(ids), 3), 0.5, np.float32))
    save_picture(run / "cloth.png", squares)
    (run / "config.json").write_text(json.dumps({"format": "cloak run", "settings": {"tile_cm": 100 * METRES}}))
    return run


def random_squares(seed: int = 0) -> np.ndarray:
    return np.round(255 * np.random.default_rng(seed).random((SQUARES, SQUARES, 3))).astype(np.float32) / 255


@pytest.fixture
def clothed(tmp_path):
    """An egg whose upper faces wear a cloth, and the squares."""
    obj, squares = make_egg(), random_squares()
    obj.data.materials.append(bpy.data.materials.new("Skin"))
    ids = np.flatnonzero([p.center.z > 0.5 for p in obj.data.polygons])
    obj.cloak.run = str(cloth_run(tmp_path, obj, ids, squares))
    bpy.ops.cloak.result_load()
    return obj, ids, squares


def wall(size: float = 2.0) -> bpy.types.Object:
    """A wall of few large faces that faces the front, about the origin."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=3, y_subdivisions=3, size=size, rotation=(np.pi / 2, 0, 0))
    bpy.context.view_layer.update()
    return bpy.context.object


def wanted_at(x: np.ndarray, z: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """What the trainer sees at places of a front panel: `Cloth.square_at`, metres right and down."""
    row, column = np.floor(-z / METRES * SQUARES).astype(int), np.floor(x / METRES * SQUARES).astype(int)
    return squares[row % SQUARES, column % SQUARES]


def seen_pixels(path: Path, side: int) -> np.ndarray:
    image = bpy.data.images.load(str(path))
    return mesh_arrays.image_pixels(image).reshape(side, side, -1)[..., :3]


def test_a_render_shows_the_square_that_the_trainer_sees(tmp_path):
    """Squarely, unlit: square by square what is in cloth.png, at the place that the trainer computes."""
    obj, squares, side = wall(), random_squares(), 200
    runs.import_colors(bpy.context, obj, cloth_run(tmp_path, obj, np.arange(9), squares))
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 2.0
    camera.location, camera.rotation_euler = (0, -3, 0), (np.pi / 2, 0, 0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    render_check.set_up(scene, side, 1)
    scene.render.filter_size, scene.render.dither_intensity = 0.01, 0
    scene.render.filepath = str(tmp_path / "wall.png")
    bpy.ops.render.render(write_still=True)
    place = (np.arange(side) + 0.5) / side * 2 - 1
    x, z = np.meshgrid(place, place)
    off = np.abs(seen_pixels(tmp_path / "wall.png", side) - wanted_at(x, z, squares)).max(-1)
    assert (off <= 1.001 / 255).mean() > 0.9995, "but for a pixel that is cut by the side of a square"


CORE = """
import sys
import numpy as np
import torch
from cloak_core.core.baking import on_cloth
from cloak_core.core.cameras import Camera
from cloak_core.core.logo import load_logo
from cloak_core.core.paint import compose
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.studies.printed_cloth import cloth_of_run
from pathlib import Path
scene, run, out, distance, side = *sys.argv[1:4], float(sys.argv[4]), int(sys.argv[5])
bodies = load_scene(scene).select_poses([0])
logo = load_logo(bodies, Path(run, "logo.npy"))
settings = RenderSettings(light=Light(ambient=1.0, diffuse=0.0, specular=0.0))
camera = Camera(azimuth=0.0, distance=distance, width=side, height=side)
view = ViewCache(bodies, settings, on_cloth=True).bake(0, camera, logo.face_ids)
cloth = cloth_of_run(Path(run))
grey = torch.full((1, 3, side, side), 0.5)
worn = compose([on_cloth(view, cloth.cloth)], torch.from_numpy(cloth.colors), grey)[0]
nobody = compose([on_cloth(view, cloth.cloth)], torch.zeros(len(cloth.colors), 3), grey)[0]
np.savez(out, worn=worn.permute(1, 2, 0).numpy(), logo=(nobody == 0).all(0).numpy())
"""
"""The trainer's view of the cloth under even light."""


def test_a_body_in_a_ready_cloth_looks_as_the_trainer_renders_it(tmp_path, monkeypatch):
    """On the sample body, near enough that a square of the cloth is three pixels wide."""
    distance, side = 0.6, 832
    bpy.context.scene.cloak.output = str(tmp_path / "runs")
    bpy.ops.cloak.ready_cloak(cloak="transfer-people")
    obj, set_up = bpy.context.object, render_check.set_up
    run = runs.run_of(obj)

    def sharp(scene: bpy.types.Scene, size: int, samples: int) -> None:
        set_up(scene, size, samples)
        scene.render.filter_size, scene.render.dither_intensity = 0.01, 0

    monkeypatch.setattr(render_check, "set_up", sharp)
    monkeypatch.setattr(render_check, "DISTANCE", distance)
    render_check.render_view(obj, tmp_path / "blender.png", 0.0, side, 8)
    (tmp_path / "core.py").write_text(CORE)
    words = [str(ASSETS / "sample"), str(run), str(tmp_path / "core.npz"), str(distance), str(side)]
    command = [os.environ["CLOAK_TRAINER"], str(tmp_path / "core.py"), *words]
    subprocess.run(command, check=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    core = np.load(tmp_path / "core.npz")
    shown, logo = seen_pixels(tmp_path / "blender.png", side)[::-1], core["logo"]
    off = np.abs(shown - core["worn"]).max(-1)[logo]
    aside = np.abs(np.roll(shown, 3, 1) - core["worn"]).max(-1)[logo]
    means = np.abs(shown - core["worn"][logo].mean(0)).max(-1)[logo]
    assert logo.mean() > 0.2
    assert np.median(off) < 2 / 255 and off.mean() < 0.15 * min(aside.mean(), means.mean())


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
    assert np.abs(mesh_arrays.image_pixels(image)[::-1, :, :3] - squares).max() < 1e-6
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


def test_a_solid_viewport_is_told_to_be_coarser(clothed):
    obj, _, _ = clothed
    space = SimpleNamespace(type="VIEW_3D", shading=SimpleNamespace(type="SOLID"))
    assert "Material Preview" in colors.solid_reason(obj, space)
    space.shading.type = "MATERIAL"
    assert colors.solid_reason(obj, space) == colors.solid_reason(obj, None) == ""
    colors.undress(obj)
    space.shading.type = "SOLID"
    assert colors.solid_reason(obj, space) == ""


def test_a_map_of_the_users_stays_the_active_one(tmp_path):
    obj = make_egg()
    layer = obj.data.uv_layers.new(name="cloak.cloth")
    layer.uv.foreach_set("vector", np.full(2 * len(obj.data.loops), 0.25, np.float32))
    users_colors(obj, "mine")
    runs.import_colors(bpy.context, obj, cloth_run(tmp_path, obj, np.arange(9), random_squares()))
    assert [layer.name for layer in obj.data.uv_layers] == ["cloak.cloth", "cloak.cloth.001"]
    assert obj.data.uv_layers.active.name == "cloak.cloth"
    colors.undress(obj)
    assert [layer.name for layer in obj.data.uv_layers] == ["cloak.cloth"] and "mine" in obj.data.color_attributes
    assert np.allclose(mesh_arrays.read(obj.data.uv_layers[0].uv, "vector", 2), 0.25)


def test_undo_takes_the_cloth_along(tmp_path):
    obj = make_egg()
    obj.cloak.run = str(cloth_run(tmp_path, obj, np.arange(100), random_squares()))
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.cloak.result_load()
    bpy.ops.ed.undo_push(message="worn")
    assert leftovers()[2] == ["cloak.cloth"]
    bpy.ops.ed.undo()
    assert leftovers() == ([], [], [])
    bpy.ops.ed.redo()
    obj = bpy.data.objects["Body"]
    assert colors.worn_cloth(obj.data)[0].name == "cloak.cloth" and leftovers()[2] == ["cloak.cloth"]


def test_the_cloth_is_saved_with_the_file_and_comes_off_after(clothed, tmp_path):
    obj, ids, squares = clothed
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "cloaked.blend"))
    (runs.run_of(obj) / "cloth.png").rename(tmp_path / "elsewhere.png")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "cloaked.blend"))
    obj = bpy.data.objects["Body"]
    image, worn = colors.worn_cloth(obj.data)
    assert np.abs(mesh_arrays.image_pixels(image)[::-1, :, :3] - squares).max() < 1e-6
    assert np.flatnonzero(worn).tolist() == ids.tolist()
    bpy.ops.cloak.result_toggle()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "cloaked.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "cloaked.blend"))
    assert leftovers() == ([], [], [])


def test_a_copy_keeps_the_cloth_that_the_original_takes_off(clothed):
    obj, _, _ = clothed
    copy = obj.copy()
    copy.data = obj.data.copy()
    bpy.context.collection.objects.link(copy)
    colors.undress(obj)
    assert colors.worn_cloth(copy.data)[0] is not None and colors.worn_cloth(obj.data)[0] is None
    colors.undress(copy)
    assert leftovers() == ([], [], [])


def test_the_cloth_goes_on_to_faces_that_are_subdivided(clothed):
    obj, ids, _ = clothed
    body.subdivide(obj)
    image, worn = colors.worn_cloth(obj.data)
    assert image is not None and worn.sum() >= 4 * len(ids)


def test_live_colours_show_the_cloth_as_it_is_now(tmp_path):
    obj = make_egg()
    run = cloth_run(tmp_path, obj, np.arange(50), random_squares())
    live = runs.LiveColors(obj, run)
    assert live.update(bpy.context) and not live.update(bpy.context)
    save_picture(run / "cloth.png", random_squares(5))
    os.utime(run / "colors.npy", ns=(1, 1))
    assert live.update(bpy.context)
    pixels = mesh_arrays.image_pixels(colors.worn_cloth(obj.data)[0])
    assert np.abs(pixels[::-1, :, :3] - random_squares(5)).max() < 1e-6
    assert leftovers()[0] == ["cloak.cloth"]
    colors.undress(obj)
    os.utime(run / "colors.npy", ns=(2, 2))
    assert live.update(bpy.context) and leftovers() == ([], [], []), "Show Original stays"


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


@pytest.mark.parametrize("own_map", [False, True])
def test_baked_texels_are_the_cloths(tmp_path, own_map):
    obj, squares = wall(), random_squares()
    if own_map:
        obj.data.uv_layers[0].name = "UVMap"  # the grid's own: x and z from 0 to 1
    else:
        obj.data.uv_layers.remove(obj.data.uv_layers[0])
    runs.import_colors(bpy.context, obj, cloth_run(tmp_path, obj, np.arange(9), squares))
    done = bake.bake(obj, 240)
    assert (done.uv_map, done.off) == ("UVMap" if own_map else "cloak.uv", 0)
    pixels = mesh_arrays.image_pixels(done.image)
    texels = set(map(tuple, np.round(255 * pixels[..., :3]).astype(int).reshape(-1, 3).tolist()))
    assert len(texels & set(map(tuple, np.round(255 * squares).astype(int).reshape(-1, 3).tolist()))) == SQUARES**2
    if own_map:
        place = (np.arange(240) + 0.5) / 240 * 2 - 1
        assert (np.abs(pixels[..., :3] - wanted_at(*np.meshgrid(place, place), squares)).max(-1) < 0.002).mean() > 0.99


def test_a_glb_has_the_picture_itself_on_a_map_that_repeats(clothed, tmp_path):
    squares = clothed[2]
    bpy.ops.cloak.export_glb(filepath=str(tmp_path / "body.glb"), size=256)
    assert [m.name for m in bpy.data.materials if colors.is_cloak(m)] == ["Cloak as Detectors Saw"]
    data = (tmp_path / "body.glb").read_bytes()
    (length,) = struct.unpack("<I", data[12:16])
    told = json.loads(data[20 : 20 + length])
    samplers = [told["samplers"][t["sampler"]] for t in told["textures"]]
    assert any(s["magFilter"] == 9728 and s.get("wrapS", 10497) == s.get("wrapT", 10497) == 10497 for s in samplers)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "body.glb"))
    (image,) = (i for i in bpy.data.images if tuple(i.size) == (SQUARES, SQUARES))
    assert np.abs(mesh_arrays.image_pixels(image)[::-1, :, :3] - squares).max() < 1e-6
    (mesh,) = (o.data for o in bpy.data.objects if o.type == "MESH")
    uv = [mesh_arrays.read(layer.uv, "vector", 2) for layer in mesh.uv_layers]
    assert max(np.ptp(places[:, 1]) for places in uv) > 1.8 / METRES - 0.1, "metres of body over metres of cloth"


def test_the_second_blender_of_render_check_shows_the_cloth(clothed, tmp_path):
    obj = clothed[0]
    plan = render_check.Plan(obj.name, tmp_path / "check", (0,))
    plan.folder.mkdir()
    render_check.prepare(plan)
    code = (f"from {MODULE}.result import render_check", f"render_check.run_plan({str(plan.folder / 'plan.json')!r})")
    done = elsewhere(tmp_path, *code)
    cloak, own = (seen_pixels(path, 416) for path in render_check.image_paths(plan))
    assert done.returncode == 0, done.stderr
    shown = np.abs(cloak - own).max(-1) > 0.1
    assert shown.mean() > 0.02 and cloak[shown].std(0).min() > 0.1, "more than the grey mean of the faces"


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


def test_the_eye_asks_for_the_cloth_in_the_pose_of_the_training(stub, clothed):
    obj, _, _ = clothed
    bpy.context.scene.cloak.judging.eye_from = "CAMERA"
    add_camera((0, -3, 0.9))
    bpy.ops.cloak.eye()
    try:
        watch(lambda: session.eye.seen is not None)
        assert asked()["cloth"] == str(runs.run_of(obj)) and asked()["pose"] == 1
        bodies = read_scene(Path(bpy.app.tempdir, "cloak eye", "scene"))
        assert bodies.pose_count == 2 and bodies.names[0] == "laid out"
        (runs.run_of(obj) / "cloth.png").unlink()
        obj.location.z = 0.25
        bpy.context.view_layer.update()
        watch(lambda: "cloth" not in asked())
    finally:
        eye.close_eye()


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
    made_run(tmp_path, obj, [0], np.zeros((1, 3), np.float32)).rename(run)
    ids = read_face_list(done.face_list).ids
    write_colors(run / "colors.npy", np.full((len(ids), 3), 0.5, np.float32))
    save_picture(run / "cloth.png", random_squares())
    (run / "config.json").write_text(json.dumps({"settings": {"tile_cm": 100 * METRES}}))
    runs.import_colors(bpy.context, obj, run)
    assert leftovers()[2] == ["cloak.cloth", "UVMap", "cloak.cloth"]
    uv = mesh_arrays.read(shirt.data.uv_layers["cloak.cloth"].uv, "vector", 2)
    assert np.allclose([uv.min(0), uv.max(0)], [[-0.5, -0.5], [0.5, 0.5]], atol=1e-5)
    garments.undress(obj)
    assert leftovers() == ([], [], ["UVMap"])
