"""Step 5: colours on the model, exact to 1/255 in a render, on exactly the right faces, and off again."""

import bpy
import numpy as np
import pytest
from cloak.blender import colors, faces
from cloak.blender.pictures import read_picture
from cloak.body import objects as body
from cloak.exchange.face_lists import write_colors
from cloak.files.errors import InputError
from cloak.result.evaluations import result_reason
from cloak.training import runs
from made import body_of_a_run, made_run, set_mode


def test_conversion_is_the_standard_and_its_own_inverse():
    levels = np.arange(256, dtype=np.float32) / 255
    assert np.abs(colors.linear_to_srgb(colors.srgb_to_linear(levels)) - levels).max() < 1e-6
    from mathutils import Color

    reference = [Color((v, v, v)).from_srgb_to_scene_linear().r for v in levels.tolist()]
    assert np.abs(colors.srgb_to_linear(levels) - reference).max() < 1e-5


@pytest.mark.parametrize("engine", ["BLENDER_WORKBENCH", "CYCLES"])
def test_a_render_shows_the_trained_colours_within_one_level(tmp_path, engine):
    """A flat patch of random colours, seen squarely under a bright world: in Solid view, and in Cycles."""
    rng = np.random.default_rng(1)
    side = 16
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=side, y_subdivisions=side, size=2)
    obj = bpy.context.object
    wanted = rng.random((side * side, 3)).astype(np.float32)
    run = made_run(tmp_path, obj, np.arange(side * side), wanted)
    runs.import_colors(bpy.context, obj, run)
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 2.0, (0, 0, 3)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = engine
    scene.render.resolution_x = scene.render.resolution_y = 8 * side
    scene.render.filepath = str(tmp_path / "patch.png")
    scene.render.dither_intensity = 0  # it adds noise of half a level
    colors.use_standard_view(scene)
    scene.world = bpy.data.worlds.new("white")
    scene.world.color = (1, 1, 1)
    if engine == "CYCLES":
        scene.cycles.samples, scene.cycles.device, scene.cycles.use_denoising = 4, "CPU", False
    else:
        scene.display.shading.light, scene.display.shading.color_type = "FLAT", "VERTEX"
        scene.display.render_aa = "OFF"
    bpy.ops.render.render(write_still=True)
    seen = read_picture(tmp_path / "patch.png")[4::8, 4::8, :3].reshape(-1, 3)
    centers = np.array([p.center[:2] for p in obj.data.polygons])
    order = np.lexsort((centers[:, 0], np.round(centers[:, 1], 3)))
    assert np.abs(seen - wanted[order]).max() <= 1.001 / 255


def test_colours_reach_exactly_the_logos_faces(tmp_path):
    obj, _ = body_of_a_run(tmp_path)
    own = colors.own_face_colors(obj)
    bpy.ops.cloak.result_load()
    shown = colors.written_colors(obj)
    attribute = obj.data.color_attributes["cloak.colors"]
    assert (attribute.domain, attribute.data_type) == ("CORNER", "FLOAT_COLOR")
    assert obj.data.color_attributes.active_color == attribute
    assert np.allclose(shown[[3, 4, 50]], [1, 0, 0], atol=1e-6)
    rest = np.setdiff1d(np.arange(len(shown)), [3, 4, 50])
    assert np.allclose(shown[rest], own[rest], atol=1e-5)
    slots = [obj.material_slots[p.material_index].material.name for p in obj.data.polygons]
    assert [i for i, name in enumerate(slots) if name == "Cloak as Detectors Saw"] == [3, 4, 50]


def test_toggle_returns_the_original_materials(tmp_path):
    obj, _ = body_of_a_run(tmp_path)
    two = bpy.data.materials.new("Shirt")
    obj.data.materials.append(two)
    before = np.arange(len(obj.data.polygons), dtype=np.int32) % 2
    obj.data.polygons.foreach_set("material_index", before)
    bpy.ops.cloak.result_toggle()
    assert colors.is_dressed(obj)
    bpy.ops.cloak.result_load()  # twice is as good as once
    bpy.ops.cloak.result_toggle()
    assert not colors.is_dressed(obj)
    after = np.empty_like(before)
    obj.data.polygons.foreach_get("material_index", after)
    assert np.array_equal(after, before)
    bpy.ops.cloak.result_toggle()
    assert colors.is_dressed(obj)


def test_a_changed_object_is_refused_with_the_reason_and_left_alone(tmp_path):
    obj, run = body_of_a_run(tmp_path)
    body.subdivide(obj)
    with pytest.raises(
        RuntimeError, match=r"changed since export: its faces are .*undo the change, or export and train"
    ):
        bpy.ops.cloak.result_load()
    assert "cloak.colors" not in obj.data.color_attributes and not colors.is_dressed(obj)
    np.save(run / "colors.npy", np.float32([[2, 0, 0]]))
    with pytest.raises(InputError, match=r"colors\.npy"):
        runs.import_colors(bpy.context, obj, run)
    (run / "colors.npy").unlink()
    with pytest.raises(InputError, match="no colours yet"):
        runs.import_colors(bpy.context, obj, run)
    assert "no colours yet" in result_reason(bpy.context)


def test_live_colours_update_only_when_there_is_something_new(tmp_path):
    import os

    obj, run = body_of_a_run(tmp_path)
    live = runs.LiveColors(obj, run)
    obj.name = "Renamed"
    assert live.update(bpy.context) and not live.update(bpy.context)
    write_colors(run / "colors.npy", np.tile(np.float32([0, 1, 0]), (3, 1)))
    os.utime(run / "colors.npy", ns=(1, 1))
    set_mode("EDIT")
    assert not live.update(bpy.context)
    set_mode("OBJECT")
    assert live.update(bpy.context)
    assert np.allclose(colors.written_colors(obj)[[3, 4, 50]], [0, 1, 0], atol=1e-6)
    faces.new_logo(obj, "more", np.arange(len(obj.data.polygons)) < 2)  # a logo more is no change of the mesh
    os.utime(run / "colors.npy", ns=(2, 2))
    assert live.update(bpy.context)
    body.subdivide(obj)
    os.utime(run / "colors.npy", ns=(3, 3))
    with pytest.raises(InputError, match="changed since export"):
        live.update(bpy.context)
    bpy.data.objects.remove(obj)
    assert not live.update(bpy.context)
