# SPDX-License-Identifier: GPL-3.0-or-later
"""Does the cloak survive a path tracer? Cycles renders the body from the training cameras, and the detector judges.

The rendering is done by a second Blender on a copy of the file, so that the first one stays usable. Camera and light
are those of training: distance 2.2 m, elevation 6 degrees, vertical field of view 60 degrees, 416 x 416 pixels; ambient
0.5 and one light of 0.3 from in front and above.
"""

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import bpy
from mathutils import Vector

from ..blender import colors
from ..blender.mesh_arrays import evaluated_mesh, to_world, vertex_points
from ..blender.pictures import read_picture, save_picture
from ..body.garments import undress, worn_by
from ..files.errors import InputError
from ..files.reading import read_json
from ..files.specs import without_folders
from ..files.writing import write_json
from ..poses.poses import held
from .evaluations import THRESHOLD, UNREADABLE, Sight, by_detector

DISTANCE, ELEVATION, FIELD_OF_VIEW, SIZE = 2.2, 6.0, 60.0, 416
LIGHT_POSITION = (0.0, -100.0, 85.0)
AMBIENT, DIFFUSE = 0.5, 0.3
SAMPLES = 32
IMAGES = (".jpg", ".jpeg", ".png", ".webp")
NAME, BLEND, PLAN, VERDICT = "render check", "check.blend", "plan.json", "verdict.json"

_RENDER = """
import bpy, importlib, os, sys, traceback
try:
    bpy.ops.preferences.addon_enable(module={package!r})
    importlib.import_module({package!r} + ".result.render_check").run_plan({plan!r})
except Exception:
    traceback.print_exc()
    sys.stderr.flush()
    os._exit(1)
os._exit(0)
"""
"""What the second Blender runs. It leaves at once: the bpy package may wait for ever in its own destructors."""


@dataclass(frozen=True)
class Plan:
    """What to render: an object from several azimuths (degrees), over photographs of a folder ("" for plain grey)."""

    object: str
    folder: Path
    angles: tuple[int, ...]
    backgrounds: str = ""
    samples: int = SAMPLES  # of a pixel


def image_paths(plan: Plan) -> list[Path]:
    """The images a plan makes: with the cloak at every angle, then without."""
    return [plan.folder / f"{kind} {angle:+d}.png" for kind in ("cloak", "own") for angle in plan.angles]


def prepare(plan: Plan) -> list[str]:
    """Save a copy of the file and the plan; returns the command that renders them."""
    blend = plan.folder / BLEND
    with held(bpy.context, bpy.data.objects[plan.object]):
        bpy.ops.wm.save_as_mainfile(filepath=str(blend), copy=True, compress=False, check_existing=False)
    write_json(plan.folder / PLAN, asdict(plan) | {"folder": str(plan.folder)})
    code = _RENDER.format(package=__package__.rpartition(".")[0], plan=str(plan.folder / PLAN))
    if bpy.app.binary_path:
        return [bpy.app.binary_path, "-b", "--python-exit-code", "1", "--python-expr", code]
    return [sys.executable, "-c", code]


def run_plan(file: str) -> None:
    """Render the plan in a file; runs in the second Blender."""
    path = Path(file)
    plan = Plan(**read_json(path) | {"folder": path.parent})
    bpy.ops.wm.open_mainfile(filepath=str(plan.folder / BLEND))
    (plan.folder / BLEND).unlink()  # as large as the user's file, and of no use to anybody
    obj = bpy.data.objects[plan.object]
    files = sorted(Path(plan.backgrounds).iterdir()) if plan.backgrounds else ()
    photographs = [path for path in files if path.suffix.lower() in IMAGES]
    for worn in (obj, *worn_by(obj)):
        colors.set_look(worn, colors.LOOKDEV)  # light falls on it here
    for number, (angle, path) in enumerate(zip(plan.angles * 2, image_paths(plan), strict=True)):
        if number == len(plan.angles):
            undress(obj)
        render_view(obj, path, angle, samples=plan.samples)
        # In front of a photograph, or of mid-grey; in display colours, as training does.
        body, behind = read_picture(path), colors.GREY
        if photographs:
            photograph = photographs[number % len(plan.angles) % len(photographs)]
            behind = read_picture(photograph, cover=body.shape[1::-1])[..., :3]
        alpha = body[..., 3:]
        save_picture(path, body[..., :3] * alpha + behind * (1 - alpha))


def verdict(plan: Plan, specs: Sequence[str], answers: list[str]) -> tuple[Sight, ...]:
    """What each detector said about the images of `image_paths`; kept beside them for `last_check`."""
    images = [path.name for path in image_paths(plan)]
    by_spec = {}
    try:
        for number, spec in enumerate(specs):
            records = [json.loads(text) for text in answers[number * len(images) :][: len(images)]]
            scores, points = zip(*((r["max_person"], r["operating_point"]) for r in records), strict=True)
            by_spec[spec] = {"scores": list(map(float, scores)), "threshold": float(points[0])}
    except (ValueError, KeyError, TypeError):
        raise InputError("Render check: the detector's answer is not understood; see check.log") from None
    write_json(plan.folder / VERDICT, {"detectors": by_spec, "images": images})
    return _read(plan.folder / VERDICT)


def last_check(parent: Path) -> tuple[Sight, ...]:
    """Read what came out of the latest render check in a folder; empty if there is none."""
    files = sorted(parent.glob(f"{NAME}*/{VERDICT}"), key=lambda path: path.stat().st_mtime)
    try:
        return _read(files[-1])
    except UNREADABLE:
        return ()


def _read(file: Path) -> tuple[Sight, ...]:
    record = read_json(file)
    images = [file.parent / Path(str(name)).name for name in record["images"]]
    kinds = ["cloak"] * (len(images) // 2) + ["clothing"] * (len(images) // 2)  # of each angle both
    return tuple(
        Sight(spec, kind, image, float(score), float(answer.get("threshold", THRESHOLD)))
        for spec, answer in record["detectors"].items()
        for kind, image, score in zip(kinds, images, answer["scores"], strict=True)
    )


def found_in(sights: Sequence[Sight]) -> tuple[int, int]:
    """Count the renders in which a person is reported: with the cloak, and without it (the control)."""
    return tuple(sum(sight.found for sight in sights if sight.kind == kind) for kind in ("cloak", "clothing"))


def holds(sights: Sequence[Sight]) -> bool:
    """Tell whether a detector misses the body in every render with the cloak, and finds it without."""
    detected, control = found_in(sights)
    return control > 0 and not detected


def describe(sights: Sequence[Sight]) -> str:
    """What one detector made of the renders, in one line, the outcome first."""
    scores, (detected, control) = [s.score for s in sights if s.kind == "cloak"], found_in(sights)
    outcome = f"The cloak holds in {len(scores) - detected} of {len(scores)} renders"
    if not control:
        outcome = "This says nothing: the detector does not find the body without the cloak either"
    elif detected in (0, len(scores)):
        outcome = "The cloak failed" if detected else "The cloak holds"
    return (
        f"{outcome}. Cycles: person detected in {detected} of {len(scores)} renders with the cloak "
        f"(highest score {max(scores):.2f}, reported from {sights[0].threshold:g}), in {control} without"
    )


def describe_all(sights: Sequence[Sight]) -> str:
    """One line for several detectors: of the one that finds most, and in how many the cloak holds."""
    rows = by_detector(sights)
    worst = max(rows.values(), key=lambda one: (found_in(one)[0], -found_in(one)[1]))
    if len(rows) == 1:
        return describe(worst)
    holding, name = sum(map(holds, rows.values())), without_folders(worst[0].spec)
    return f"Holds against {holding} of {len(rows)} detectors. Worst, {name}: {describe(worst)}"


def render_view(obj: bpy.types.Object, path: Path, azimuth: float, size: int = SIZE, samples: int = SAMPLES) -> None:
    """Render the body with transparent surroundings from one training camera into a PNG, in display colours."""
    scene = bpy.data.scenes.new("cloak render")
    camera = bpy.data.cameras.new("cloak render")
    sun = bpy.data.lights.new("cloak render", "SUN")
    world = bpy.data.worlds.new("cloak render")
    holders = [bpy.data.objects.new("cloak camera", camera), bpy.data.objects.new("cloak sun", sun)]
    try:
        for thing in (obj, *worn_by(obj), *holders):
            scene.collection.objects.link(thing)
        set_up(scene, size, samples)
        # A uniform surround of radiance 0.5, and a sun whose irradiance makes a white diffuse face reflect 0.3.
        background = next(n for n in colors.nodes_of(world)[0] if n.type == "BACKGROUND")
        background.inputs["Color"].default_value = (1, 1, 1, 1)
        background.inputs["Strength"].default_value = AMBIENT
        scene.world = world
        sun.energy = DIFFUSE * math.pi
        holders[1].rotation_euler = Vector(LIGHT_POSITION).to_track_quat("Z", "Y").to_euler()
        scene.frame_set(bpy.context.scene.frame_current)
        metre = 1 / bpy.context.scene.unit_settings.scale_length
        with evaluated_mesh(obj, scene.view_layers[0].depsgraph) as (mesh, matrix):
            body = to_world(vertex_points(mesh), matrix)
        elevation, turn, distance = math.radians(ELEVATION), math.radians(azimuth), DISTANCE * metre
        level = math.cos(elevation)
        away = Vector((level * math.sin(turn), -level * math.cos(turn), math.sin(elevation)))
        holders[0].location = Vector((body.min(0) + body.max(0)) / 2) + away * distance
        holders[0].rotation_euler = away.to_track_quat("Z", "Y").to_euler()
        camera.sensor_fit = "VERTICAL"
        camera.angle = math.radians(FIELD_OF_VIEW)
        camera.clip_start, camera.clip_end = distance / 100, distance * 100
        scene.camera = holders[0]
        scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True, scene=scene.name)
    finally:
        bpy.data.batch_remove([*holders, scene, camera, sun, world])
    if not path.exists():
        raise InputError(f"{path}: the render was not written")


def set_up(scene: bpy.types.Scene, size: int, samples: int) -> None:
    """Cycles on the processor, not denoised: square RGBA PNGs in display colours, transparent around the body."""
    render = scene.render
    render.engine = "CYCLES"
    render.resolution_x = render.resolution_y = size
    render.resolution_percentage = 100
    render.film_transparent = True
    render.image_settings.file_format = "PNG"
    render.image_settings.color_mode = "RGBA"
    scene.cycles.device = "CPU"
    scene.cycles.samples = samples
    scene.cycles.use_denoising = False
    scene.cycles.seed = 0
    colors.use_standard_view(scene)
