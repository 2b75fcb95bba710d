# SPDX-License-Identifier: GPL-3.0-or-later
"""What is made from a run to take along: sheets to print, turntables, films, images; where the run keeps its logs."""

from pathlib import Path

import bpy
import numpy as np

from ..blender import colors
from ..blender.blend_paths import first_free
from ..blender.marks import COLORS, layer_name
from ..body.garments import worn_by
from ..body.objects import active_body, of_the_body, refusal, scene_axes
from ..files.errors import InputError
from ..files.writing import write_text, written
from ..poses.export import standing_reason
from ..poses.poses import PoseChoice
from ..trainer.jobs import run_cloak
from ..training.detectors import judges
from ..training.runs import input_folder, run_of, side_folder
from ..ui import props
from ..ui.bases import operator
from ..ui.window import progress_cursor
from . import bake as baking
from .evaluations import export_worn, judged_reason
from .viewpoints import of_camera

SHEETS, TURNTABLE, FILM = "print sheets", "turntable", "film"
MADE = (SHEETS, TURNTABLE, FILM)
BESIDE = (".json", ".csv", ".jsonl", ".out", ".log")  # suffixes of logs and records beside the outputs
GIF_FPS = 12.5  # frames a second of a GIF: twice as many make it twice as large
MOST_KEYS = 120  # keyframes that a camera's way is told in


def made(run: Path) -> list[Path]:
    """What was made from a run, the latest first."""
    files = [path for name in MADE for path in side_folder(run).glob(f"{name}*") if path.suffix not in BESIDE]
    files = [path for path in files if not path.name.endswith("scene")]
    return sorted(files, key=lambda path: path.stat().st_mtime, reverse=True)


def write_camera(context: bpy.types.Context, path: Path, pivot: np.ndarray) -> None:
    """The way of the scene's camera around `pivot` (metres, the trainer's axes), over the scene's frames, as keyframes
    for `cloak film`: time, azimuth, elevation, distance. The frame returns at the end."""
    scene = context.scene
    frame, subframe = scene.frame_current, scene.frame_subframe
    step = max(1, -(-(scene.frame_end - scene.frame_start) // MOST_KEYS))
    frames = sorted({*range(scene.frame_start, scene.frame_end + 1, step), scene.frame_end})
    places = []
    try:
        for number in frames:
            scene.frame_set(number)
            place = scene.camera.evaluated_get(context.evaluated_depsgraph_get()).matrix_world.translation
            places.append(scene_axes(np.array(place, float)) * scene.unit_settings.scale_length)
    finally:
        scene.frame_set(frame, subframe=subframe)
    seconds = (np.array(frames) - frames[0]) * scene.render.fps_base / scene.render.fps
    away = np.array(places) - pivot
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-3)
    azimuth = np.degrees(np.unwrap(np.arctan2(away[:, 0], away[:, 2])))
    elevation = np.degrees(np.arcsin(np.clip(away[:, 1] / distance, -1, 1)))
    rows = (",".join(f"{x:.4f}" for x in row) for row in zip(seconds, azimuth, elevation, distance, strict=True))
    write_text(path, "\n".join(["time,azimuth,elevation,distance", *rows, ""]))


@operator("Print Sheets", judged_reason, standing_reason, trains=True)
def print_sheets(context: bpy.types.Context) -> str:
    """Lay the logo out flat at true size: sheets to print and cut (PDF), a texture, and the body with it (GLB, OBJ)"""
    obj = active_body(context)
    run = run_of(obj)
    place, scene = first_free(side_folder(run), SHEETS), input_folder(run) / "scene"
    if not scene.is_dir():  # a run of the command line
        scene = side_folder(run) / "print scene"
        export_worn(context, obj, run, PoseChoice(), scene)
    words, ended = ("print", run, "--scene", scene, "--out", place), lambda job: f"Wrote {place.name}"
    return f"Laying the logo out in {place}" + run_cloak("Print Sheets", words, side_folder(run), "print", ended)


@operator("Turntable", judged_reason, standing_reason, trains=True)
def turntable(context: bpy.types.Context) -> str:
    """Film the body as it stands from all around, in own clothing and in the cloak, with what the detector sees"""
    seconds = context.scene.cloak.judging.film_seconds
    return make_film(context, "Turntable", TURNTABLE, ["--camera=orbit", f"--seconds={seconds:g}"], PoseChoice())


@operator(
    "Film with Camera",
    judged_reason,
    standing_reason,
    lambda context: refusal(of_camera, context.scene, active_body(context)),
    trains=True,
)
def film(context: bpy.types.Context) -> str:
    """Film the body along the way of the scene's camera, over the scene's frames, in own clothing and in the cloak, \
with what the detector sees. The camera looks at the middle of the body, which with Poses > Current Pose stands still"""
    obj, scene = active_body(context), context.scene
    choice, options = PoseChoice(), [f"--field-of-view={of_camera(scene, obj).field_of_view:.4f}"]
    if scene.cloak.pose_source != "CURRENT":
        choice = PoseChoice("RANGE", scene.frame_start, scene.frame_end, 1)
        options.append(f"--poses-per-second={scene.render.fps / scene.render.fps_base:g}")
    return make_film(context, "Film with Camera", FILM, options, choice)


def make_film(context: bpy.types.Context, label: str, name: str, options: list[str], choice: PoseChoice) -> str:
    """Export the poses and film them; by the scene's camera where the options name none."""
    obj, settings = active_body(context), context.scene.cloak
    run = run_of(obj)
    suffix = {"png": ""}.get(settings.judging.film_format, f".{settings.judging.film_format}")
    folder = side_folder(run)
    place, scene = first_free(folder, name, suffix), folder / f"{name} scene"
    if obj.mode == "EDIT":
        bpy.ops.object.mode_set(mode="OBJECT")
    bodies = export_worn(context, obj, run, choice, scene)
    if not any(word.startswith("--camera=") for word in options):
        middles = (bodies.vertices.min(1).astype(float) + bodies.vertices.max(1)) / 2  # of the poses
        write_camera(context, folder / f"{name}.csv", middles.mean(0))
        options.append(f"--camera={folder / name}.csv")
    fps = context.scene.render.fps / context.scene.render.fps_base
    options += [f"--fps={min(fps, GIF_FPS) if suffix == '.gif' else fps:g}", f"--device={settings.device}"]
    # Those of the scene, as for an evaluation: the user has named them here, in a run folder anybody may have.
    specs = judges(settings) if settings.detectors else ()
    options += [f"--detector={spec}" for spec in specs]
    words = ["film", run, "--scene", scene, *options, settings.judging.backgrounds_option, "--out", place]
    return f"Filming into {place}" + run_cloak(label, words, folder, name, lambda job: f"Wrote {place.name}", True)


SIZE = props.whole("Size", "Texels along each side", 2048, min=16, max=8192)


@of_the_body
def bake_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why there are no colours to bake."""
    return "" if layer_name(obj.data, COLORS) else "Train, or load colours, first"


@operator("Bake to Image", bake_reason, size=SIZE)
def bake(context: bpy.types.Context, obj: bpy.types.Object, size: int) -> str:
    """Bake the trained colours to an image and make a material of it that is an asset. Where the body has no UV map, \
or one with too little room, Cloak makes one of its own"""
    done = baking.bake(obj, size)
    material = baking.baked_material(done.image, done.uv_map)
    faces = f"{done.off:,} of {len(obj.data.polygons):,} faces are off by more than 4/255"
    message = f"Image and material '{material.name}' on UV map '{done.uv_map}'; {faces}"
    return message if done.off_before is None else f"{message} ({done.off_before:,} on the body's own map)"


@operator("Export GLB", bake_reason, writes=".glb", size=SIZE)
def export_glb(context: bpy.types.Context, filepath: str, size: int) -> str:
    """Bake the trained colours and write the body with what it wears as a GLB, for programs that know images alone"""
    obj, chosen = active_body(context), list(context.selected_objects)
    with progress_cursor():
        copies = [baking.baked_copy(one, size) for one in (obj, *worn_by(obj))]
    try:
        for one in context.view_layer.objects:
            one.select_set(one in copies)
        with written(filepath):
            bpy.ops.export_scene.gltf(filepath=filepath, export_format="GLB", use_selection=True)
    except RuntimeError as error:
        raise InputError(f"{filepath}: cannot be exported ({str(error).strip()})") from None
    finally:
        shown = [material for copy in copies for material in copy.data.materials if colors.is_cloak(material)]
        bpy.data.batch_remove([*copies, *(copy.data for copy in copies)])
        bpy.data.batch_remove([material for material in set(shown) if not material.users])
        for one in chosen:
            one.select_set(True)
        context.view_layer.objects.active = obj
    return f"Wrote {filepath}"


@operator("Open", path=props.text("Path", "What to open"))
def show_made(context: bpy.types.Context, path: str) -> str:
    """Open it with the program that the system has for it"""
    if not Path(path).exists():
        raise InputError(f"{path} is gone")
    if not bpy.app.background:
        bpy.ops.wm.path_open(filepath=path)
    return f"Opened {path}"
