"""What is the user's stays the user's, whatever it is called; and nothing that goes wrong in one job ends the watch."""

import bpy
import numpy as np
import pytest
from cloak.blender import colors, faces, marks
from cloak.logo.operators import show_heat
from cloak.trainer import jobs
from cloak.trainer.jobs import Job
from cloak.training import runs
from conftest import folder_of, red_faces, run_job, wait_for
from made import make_egg, set_mode

OURS = (
    "Cloak",
    "Outfit",
    "Cloak Heatmap",
    "Cloak UV",
    "cloak_heat",
    "cloak_own_material",
    "cloak.colors",
    "cloak.heat",
)


def users_colors(obj: bpy.types.Object, name: str) -> np.ndarray:
    """A colour attribute that the user painted."""
    attribute = obj.data.color_attributes.new(name, "FLOAT_COLOR", "CORNER")
    values = np.random.default_rng(7).random(4 * len(obj.data.loops)).astype(np.float32)
    attribute.data.foreach_set("color", values)
    return values


def read_colors(obj: bpy.types.Object, name: str) -> np.ndarray:
    values = np.empty(4 * len(obj.data.loops), np.float32)
    obj.data.color_attributes[name].data.foreach_get("color", values)
    return values


@pytest.mark.parametrize("name", OURS)
def test_logos_and_vertex_groups_of_any_name_survive_the_live_colours(ready, name):
    mask, group = np.isin(np.arange(len(ready.data.polygons)), [10, 20, 30]), OURS[OURS.index(name) - 1]
    ready.vertex_groups.new(name=group)
    ready.cloak.logo = faces.new_logo(ready, name, mask)
    bpy.ops.cloak.train_start()
    assert run_job().state == "done" and folder_of(ready).name == f"Body {name}"
    assert red_faces(ready) == [10, 20, 30] and ready.vertex_groups.keys() == [group]
    bpy.ops.cloak.subdivide()
    assert faces.logo_names(ready.data) == ["Brust/Ärmel", name]
    assert faces.active_logo(ready) == name


def test_a_users_own_layers_of_our_names_stay_and_come_back(ready):
    painted = {name: users_colors(ready, name) for name in ("Cloak", "Outfit", "Cloak Heatmap", "cloak.colors")}
    ready.data.uv_layers.new(name="Cloak UV")
    ready.data.attributes.new("cloak_heat", "FLOAT", "FACE")
    own = ready.data.attributes.new("cloak_own_material", "INT", "FACE")
    own.data.foreach_set("value", np.arange(len(ready.data.polygons), dtype=np.int32))
    ready.data.color_attributes.active_color_name = "Outfit"
    bpy.ops.cloak.train_start()
    assert run_job().state == "done" and red_faces(ready) == [10, 20, 30, 333]
    show_heat(ready, np.linspace(0, 1, len(ready.data.polygons)))
    bpy.ops.cloak.bake(size=256)  # whose map has every face on the whole square
    bpy.ops.cloak.result_toggle()
    assert colors.shown_attribute(ready) == "Outfit", "what the user looked at before"
    for name, values in painted.items():
        assert np.array_equal(read_colors(ready, name), values), name
    assert "Cloak UV" in ready.data.uv_layers and ready.data.attributes["cloak_own_material"].data[9].value == 9
    assert all(item.value == 0 for item in ready.data.attributes["cloak_heat"].data)


def test_a_users_material_of_our_name_is_not_ours(dressed, tmp_path):
    bpy.ops.cloak.result_toggle()
    mine = bpy.data.materials.new("Cloak Lookdev.001")
    dressed.data.materials.append(mine)
    bpy.ops.cloak.result_toggle()
    bpy.context.scene.cloak.look = "LOOKDEV"
    assert mine in list(dressed.data.materials)
    assert [m and m.get("cloak.role") for m in dressed.data.materials] == [None, "LOOKDEV", None]


def test_what_version_1_0_made_is_found_again_and_only_that(dressed, tmp_path):
    """As it named its layers and materials, without a mark."""
    mesh = dressed.data
    for role in ("colors", "own_material"):
        mesh.attributes[marks.layer_name(mesh, role)].name = marks.FORMER[role]
        del mesh[f"cloak.{role}"]
    material = next(m for m in mesh.materials if m and m.get("cloak.role"))
    del material["cloak.role"]
    next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeVertexColor").layer_name = "Cloak"
    mesh.pop("cloak.shown_before", None)
    other = make_egg(8, name="Other")
    values = users_colors(other, "Cloak")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "old.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "old.blend"))
    obj, other = bpy.data.objects["Body"], bpy.data.objects["Other"]
    bpy.context.view_layer.objects.active = obj
    assert colors.is_dressed(obj) and red_faces(obj) == [10, 20, 333]
    bpy.ops.cloak.result_toggle()
    assert not colors.is_dressed(obj)
    bpy.ops.cloak.result_toggle()
    assert red_faces(obj) == [10, 20, 333] and len(obj.data.color_attributes) == 1
    assert not marks.our_names(other.data) and np.array_equal(read_colors(other, "Cloak"), values)


def test_a_copy_with_modifiers_applied_keeps_its_cloak(dressed):
    dressed.modifiers.new("Mirror", "MIRROR")
    bpy.ops.cloak.apply_copy()
    copy = bpy.context.object
    assert copy is not dressed and marks.layer_name(copy.data, "colors") and colors.is_dressed(copy)


@pytest.mark.parametrize("mode", ["EDIT", "VERTEX_PAINT", "WEIGHT_PAINT", "TEXTURE_PAINT", "SCULPT"])
def test_live_colours_leave_every_paint_mode_alone(dressed, mode):
    users_colors(dressed, "Mine")
    live = runs.LiveColors(dressed, folder_of(dressed))
    set_mode(mode)
    dressed.data.color_attributes.active_color_name = "Mine"
    assert not live.update(bpy.context)
    assert dressed.data.color_attributes.active_color_name == "Mine"
    assert "Leave" in live.finish(Job("Training", [], folder_of(dressed), "x"))
    assert dressed.data.color_attributes.active_color_name == "Mine"
    set_mode("OBJECT")
    assert live.update(bpy.context)


# --- the watch goes on ------------------------------------------------------------------------------------------------


def broken(job: Job) -> None:
    raise KeyError("a defect")


def test_a_defect_in_one_job_is_shown_and_the_rest_goes_on(tmp_path, stub):
    first = jobs.launch(Job("One", [[str(stub), "-c", "import time; time.sleep(0.4)"]], tmp_path, "one", broken))
    first.on_tick = broken
    second = jobs.launch(Job("Two", [[str(stub), "-c", "pass"]], tmp_path, "two"))
    third = jobs.launch(Job("Three", [[str(stub), "-c", "pass"]], tmp_path, "three"))
    third.poll = lambda: broken(third)
    wait_for(lambda: first.notice)
    assert "KeyError" in first.notice and first.running
    run_job()
    assert (first.state, second.state, third.state) == ("failed", "done", "failed")
    assert "a defect of the add-on (KeyError" in first.message and str(first.log) in first.message
    assert "Traceback" in first.log.read_text()
