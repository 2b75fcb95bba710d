"""What the extension puts into Blender, and that it leaves nothing behind."""

import threading
import types

import bpy
import cloak
import numpy as np
import pytest
from cloak.blender import marks
from cloak.session import session
from cloak.trainer import jobs, program
from cloak.ui import bases
from conftest import MODULE, Layout, drawn


def test_every_operator_and_property_has_a_description():
    for cls in (*cloak.CLASSES, *cloak.properties.CLASSES):
        rna = cls.bl_rna
        if issubclass(cls, bpy.types.Operator):
            rna = getattr(bpy.ops.cloak, cls.bl_idname.removeprefix("cloak.")).get_rna_type()
            assert len(rna.description) > 10 and rna.name and "Base" not in rna.description, cls
        for key in getattr(cls, "__annotations__", {}):
            assert rna.properties[key].description or rna.properties[key].is_hidden, (cls, key)


def test_what_changes_the_file_at_once_can_be_undone():
    undone = {c.__name__.removeprefix("CLOAK_OT_") for c in cloak.CLASSES if "UNDO" in getattr(c, "bl_options", ())}
    assert {"logo_assign", "logo_stamp", "stamp_drag", "subdivide", "bake", "result_load", "detector_add"} <= undone
    assert not {"train_start", "evaluate", "render_check", "logo_export", "export_glb", "explain"} & undone


def test_what_blend_files_store_keeps_its_name():
    """Files saved by earlier versions keep their logos, runs, heat maps and settings."""
    object_names, judging_names, detector_names, scene_names = (
        " ".join(cls.__annotations__) for cls in cloak.properties.CLASSES
    )
    assert detector_names == "file weights spec options threshold judges checked answer works gradients"
    assert object_names == "logo logo_index run run_place worn left_out made_from"
    assert judging_names == (
        "bodies frame_start frame_end frame_step backgrounds angle images ring eye_from eye_background "
        "people film_format "
        "film_seconds"
    )
    assert scene_names == (
        "triangulate tint stamp_kind stamp_text stamp_image stamp_size stamp_center stamp_offset "
        "brush_radius brush_mirror heat_share "
        "pose_source frame_start frame_end frame_step detectors detector detector_index backgrounds preset config "
        "angle_first angle_last angle_step steps device output look live live_seconds judging"
    )
    assert list(marks.KINDS) == [
        "colors", "outfit", "heatmap", "own_material", "original_face", "carried_face", "heat", "uv", "cloth",
        "ready_cloth",
    ]  # fmt: skip


def leftovers() -> dict:
    """Everything an add-on could leave behind."""
    names = [name for name in dir(bpy.app.handlers) if name.endswith(("_post", "_pre"))]
    handlers = {name: list(getattr(bpy.app.handlers, name)) for name in names}
    return {
        "types": sorted(name for name in dir(bpy.types) if "cloak" in name.lower()),
        "operators": [name for name in dir(bpy.ops.cloak)],
        "object": [p.identifier for p in bpy.types.Object.bl_rna.properties if "cloak" in p.identifier],
        "scene": [p.identifier for p in bpy.types.Scene.bl_rna.properties if "cloak" in p.identifier],
        "handlers": handlers,
        "timer": bpy.app.timers.is_registered(jobs.tick),
        "threads": [thread.name for thread in threading.enumerate()],
        "jobs": list(session.jobs),
        "asset libraries": [library.name for library in bpy.context.preferences.filepaths.asset_libraries],
    }


def test_ten_cycles_of_register_and_unregister_leave_nothing():
    def disable() -> None:
        bpy.ops.preferences.addon_disable(module=MODULE)

    def enable() -> None:
        bpy.ops.preferences.addon_enable(module=MODULE)

    enabled = leftovers()
    assert enabled["types"] and enabled["object"] == ["cloak"] and enabled["asset libraries"].count("Cloak") == 1
    disable()
    empty = leftovers()
    assert "Cloak" not in empty["asset libraries"]
    assert not empty["types"] and not empty["operators"] and not empty["object"] and not empty["scene"]
    for _ in range(10):
        enable()
        assert leftovers()["types"] == enabled["types"]
        disable()
        assert leftovers() == empty
    enable()
    assert {k: v for k, v in leftovers().items() if k != "handlers"} == {
        k: v for k, v in enabled.items() if k != "handlers"
    }


def test_every_button_that_cannot_be_pressed_is_greyed_with_its_reason(ready, monkeypatch):
    """The reason is the panel's own, and is asked for before anything runs."""
    always = {"detector_add", "detector_add_named", "show_made", "add_sample_body", "copy_install_line"}
    always |= {"allow", "ready_cloak", "try_it", "set_angles", "explain", "test_trainer", "use_standard_view"}
    offered = {name for name in dir(bpy.ops.cloak) if getattr(bpy.ops.cloak, name).poll()}
    no_run = {"result_", "render_", "open_", "run_", "train_resume", "train_extend", "train_cancel", "logo_from_heat"}
    no_run |= {"export_glb", "evaluate", "print_sheets", "turntable", "film", "heatmap_toggle"}
    assert not {name for name in offered if name.startswith(tuple(no_run))} | ({"wear"} & offered)
    assert (
        always | {"train_start", "heatmap", "eye", "logo_assign", "logo_export", "logo_stamp", "subdivide"} <= offered
    )
    monkeypatch.setenv("CLOAK_STUB", "slow")
    bpy.context.scene.cloak.steps = 300
    bpy.ops.cloak.train_start()
    bpy.ops.cloak.heatmap()
    assert session.job_of("Heatmap").describe() == "Waits for Training"
    bpy.data.objects.remove(ready)
    left = {name for name in dir(bpy.ops.cloak) if getattr(bpy.ops.cloak, name).poll()}
    assert left == always | {"train_cancel"}
    with pytest.raises(RuntimeError, match=r"poll\(\).*No active object: click the character's mesh"):
        bpy.ops.cloak.logo_export(filepath="/nonexistent/x.npy")


@pytest.mark.parametrize("there", ["nothing", "body", "dressed"])
def test_every_panel_is_drawn_whatever_there_is(there, request):
    if there != "nothing":
        request.getfixturevalue("ready" if there == "body" else "dressed")
    for cls in (c for c in cloak.CLASSES if issubclass(c, bpy.types.Panel)):
        assert cls.poll(bpy.context) in (True, False) and drawn(cls) is not None


@pytest.mark.parametrize("width", [200, 280, 600])
def test_a_message_is_wrapped_where_the_sidebar_ends(width, monkeypatch):
    """By the width of its letters, which differ, and a path is broken."""
    told, room = [], width - bases.BESIDE_WORDS * bpy.context.preferences.system.ui_scale
    measured = lambda words: sum({"W": 10, "M": 10, "i": 3, "l": 3}.get(letter, 6) for letter in words)
    fonts = types.SimpleNamespace(size=lambda *_: None, dimensions=lambda _, words: (measured(words), 9))
    monkeypatch.setattr(bases, "blf", fonts)  # without a window Blender has none
    context = types.SimpleNamespace(region=types.SimpleNamespace(width=width), preferences=bpy.context.preferences)
    words = f"WWW MMM {'illi ' * 30} {program.install_line()}"
    bases.wrapped(Layout(told), context, words)
    lines = [line for line in told if line]
    assert "".join(lines).replace(" ", "") == words.replace(" ", "")
    widths = list(map(measured, lines))
    assert max(widths) <= room and np.mean(widths[:-1]) > 0.5 * room


def test_buttons_of_one_operator_have_tooltips_of_their_own():
    for name, values in (
        ("add_sample_body", {"people": ["BARE", "CLOTHED"]}),
        ("stamp_drag", {"kind": ["SETTINGS", "LETTER", "SMILEY"]}),
        ("logo_stamp", {"add": [False, True]}),
    ):
        cls = next(c for c in cloak.CLASSES if c.__name__ == f"CLOAK_OT_{name}")
        rna = getattr(bpy.ops.cloak, name).get_rna_type()
        ((key, choices),) = values.items()
        told = [cls.description(bpy.context, types.SimpleNamespace(bl_rna=rna, **{key: choice})) for choice in choices]
        assert len(set(told)) == len(choices), told
