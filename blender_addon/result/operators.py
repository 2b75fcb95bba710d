# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 5: what the body wears (its run's colours, ready cloaks, any picture as cloth, cloths of the asset
library), colour management, report.

The library comes with the extension: materials of ready cloths, on a UV map of their own.
"""

import functools
import shutil
from pathlib import Path

import bpy
import numpy as np
from bpy.props import EnumProperty

from ..blender import colors
from ..blender.blend_paths import first_free
from ..blender.faces import active_logo
from ..blender.marks import READY_CLOTH, lay_uv
from ..blender.mesh_arrays import mean_of_corners, mode_reason, topology
from ..blender.pictures import METRES, cloth_of, pixels_at, read_picture, save_picture
from ..body.garments import is_dressed, undress
from ..body.objects import ASSETS, active_body, add_people, body_reason, logo_reason, of_the_body
from ..exchange.bodies import Bodies
from ..exchange.cloth import CLOTH_FILE, corner_uv
from ..exchange.face_lists import read_face_list, write_colors
from ..exchange.scenes import read_scene
from ..files.reading import read_json
from ..files.writing import new_folder, write_json, written
from ..poses.export import Export, export, standing_reason
from ..poses.poses import PoseChoice
from ..properties import output_folder
from ..trainer.jobs import run_cloak
from ..trainer.program import SAMPLES
from ..training import runs
from ..training.runs import first_pose, run_of
from ..ui import props
from ..ui.bases import operator
from .evaluations import result_reason

LIBRARY = ASSETS / "library"  # of the built extension
INWARDS = (0.0, 0.35, 0.7)  # shares of the way from a face's middle to its corners, where its mean colour is taken


def wear_reason(context: bpy.types.Context) -> str:
    """Why the body cannot be given, or be rid of, the colours."""
    return result_reason(context) or mode_reason(active_body(context), "Leave {mode} to see the colours on the model")


@operator("Load Colours", wear_reason)
def result_load(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Bring the colours of the run folder onto the model"""
    count = runs.import_colors(context, obj, run_of(obj))
    return f"{count:,} faces of '{obj.name}' wear the trained colours"


@functools.cache  # Blender keeps no copy of a menu's words: they must live on
def ready_cloaks() -> list[tuple[str, str, str]]:
    """The cloaks that come with the extension: name, title, and what they are."""
    paths = sorted(ASSETS.glob("*/zoo.json"))
    return [(path.parent.name, path.parent.name, str(read_json(path).get("about", ""))) for path in paths]


@operator(
    "Ready Cloak",
    undo=True,
    cloak=EnumProperty(name="Ready Cloak", description="Which one to wear", items=lambda _, context: ready_cloaks()),
)
def ready_cloak(context: bpy.types.Context, cloak: str) -> str:
    """Wear a cloak that comes with Cloak, on the sample body, which is added where the active body is another. The \
run is copied to the output folder"""
    source = ASSETS / cloak
    _, expected = runs.trained_faces(source)
    if body_reason(context) or topology(active_body(context)) != expected:
        bodies = read_scene(ASSETS / "sample")
        add_people(context, bodies, False, "Sample Body").cloak.made_from = f"{SAMPLES['BARE']}|{bodies.topology}"
    obj, place = active_body(context), first_free(output_folder(context.scene.cloak), cloak)
    with written(place):
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(source, place)
    return runs.wear_run(context, obj, place)


@operator("Toggle Cloak", wear_reason)
def result_toggle(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Switch between the cloak and the body's own materials"""
    if is_dressed(obj):
        undress(obj)
        colors.show_attribute(obj)
        return f"'{obj.name}' shows its own materials"
    runs.import_colors(context, obj, run_of(obj))
    return f"'{obj.name}' wears the cloak"


@operator("Explain", told_by="tip", tip=props.text("Tip", "What the figure means"))
def explain(context: bpy.types.Context, tip: str) -> str:
    """What a figure of the panel means"""
    return tip


@operator("Use Standard", undo=True)
def use_standard_view(context: bpy.types.Context) -> str:
    """Show the trained colours as the detector saw them: Standard colours and, in a Solid viewport, flat light"""
    colors.use_standard_view(context.scene)
    if lit := colors.light_reason(context.space_data):
        context.space_data.shading.light = "FLAT"
    return "View transform: Standard" + (", flat light" if lit else "")


@of_the_body
def report_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why there is nothing to report."""
    run = run_of(obj)
    if run is None:
        return "Choose a run in the list first"
    known = (run / "report.html").is_file() or (run / "config.json").is_file()
    return "" if known else f"{run}: not a run folder (no config.json in it), so there is nothing to report"


@operator("Open Report", report_reason, trains=True)
def open_report(context: bpy.types.Context) -> str:
    """Open the run's report in the web browser, after making it if need be"""
    run = run_of(active_body(context))
    report = run / "report.html"
    if report.exists():
        return _open(report)
    ended = lambda job: _open(report) if report.exists() else None
    return "Making the report" + run_cloak("Report", ("report", run), runs.side_folder(run), "report", ended)


def _open(report: Path) -> str:
    if not bpy.app.background:
        bpy.ops.wm.url_open(url=report.as_uri())
    return f"Opened {report}"


# --- cloths that were not trained here: a picture is worn as what a training would have left --------------------------


@operator(
    "Picture as Cloth",
    logo_reason,
    standing_reason,
    undo=True,
    reads=".png;*.jpg;*.jpeg;*.webp",
    width=props.number("Width", "After how many metres it repeats", 0.25, min=0.01, max=10.0),
)
def cloth_picture(context: bpy.types.Context, filepath: str, width: float) -> str:
    """Wear a picture as cloth that repeats, on the active logo: to compare it with what was trained"""
    obj, logo, path = active_body(context), active_logo(active_body(context)), Path(filepath)
    if obj.mode == "EDIT":
        bpy.ops.object.mode_set(mode="OBJECT")
    run = runs.new_run(output_folder(context.scene.cloak), obj.name, path.stem)
    pixels = read_picture(path)[..., :3]
    pixels = np.repeat(pixels, 3, -1) if pixels.shape[-1] < 3 else pixels
    done = export(context, obj, logo, PoseChoice(), runs.input_folder(run))
    write_run(run, done, pixels, width, obj.cloak.made_from)
    return runs.wear_run(context, obj, run)


def write_run(run: Path, done: Export, pixels: np.ndarray, metres: float, made_from: str) -> None:
    """A run folder of a cloth of these pixels ([h, w, 3] sRGB, bottom row first) on what was exported."""
    bodies, ids = read_scene(done.scene), read_face_list(done.face_list).ids
    source, _, topology = made_from.partition("|")
    config = {"format": "cloak run", "topology": bodies.topology, "detectors": []}
    config["settings"] = {"pattern": "tile", "tile_cm": round(100 * metres, 4)}
    config["inputs"] = {"made_from": source} if topology == bodies.topology else {}
    with new_folder(run) as folder:
        save_picture(folder / CLOTH_FILE, pixels)
        write_json(folder / "config.json", config)
        for name in ("logo.npy", "logo.json"):
            shutil.copyfile(done.face_list.with_name(name), folder / name)
        write_colors(folder / "colors.npy", _means(bodies, metres, pixels)[ids])


def _means(bodies: Bodies, metres: float, pixels: np.ndarray) -> np.ndarray:
    """[F, 3]: about the mean of the picture on each face, from its middle and points towards its corners."""
    uv = corner_uv(bodies, metres, metres * pixels.shape[0] / pixels.shape[1])
    counts = np.full(bodies.triangle_count, 3) if bodies.loop_total is None else bodies.loop_total
    middle = np.repeat(mean_of_corners(counts, uv), counts, axis=0)
    total = np.zeros((len(counts), 3), np.float32)
    for part in INWARDS:
        total += mean_of_corners(counts, pixels_at(pixels, middle + part * (uv - middle)))
    if bodies.loop_total is None:  # modifiers make other polygons: of the triangles that count as a face
        order = np.argsort(bodies.triangle_face, kind="stable")
        triangles = np.bincount(bodies.triangle_face, minlength=bodies.face_count)
        total = mean_of_corners(np.maximum(triangles, 1), total[order])
    return np.clip(total / len(INWARDS), 0, 1)


# --- the asset library ------------------------------------------------------------------------------------------------


def ready_cloth(obj: bpy.types.Object) -> bpy.types.Material | None:
    """A material of the library that an object shows, the active one first."""
    shown = (obj.active_material, *obj.data.materials)
    return next((material for material in shown if material and METRES in material and cloth_of(material)), None)


@of_the_body
def ready_cloth_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why there is no cloth to lay."""
    if ready_cloth(obj) is None:
        return "Give the body a cloth first: drag one from the Asset Browser, library Cloak, onto it"
    return mode_reason(obj, "Leave {mode} to lay the cloth")


@operator("Lay Cloth at True Size", ready_cloth_reason)
def lay_cloth(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Make the UV map of the ready cloths, on which they are as large as they are printed: front, back \
and sides are projected, as the trainer lays a cloth"""
    material = ready_cloth(obj)
    image, metres = cloth_of(material), material[METRES]
    bodies = first_pose(obj, None)
    name = lay_uv(obj, READY_CLOTH, corner_uv(bodies, metres, metres * image.size[1] / image.size[0]))
    for node in material.node_tree.nodes:
        if node.bl_idname == "ShaderNodeUVMap":
            node.uv_map = name  # numbered where the user has one of its name
    return f"'{material.name}' repeats every {metres:g} m on '{obj.name}'"


def _ours() -> list[bpy.types.UserAssetLibrary]:
    return [library for library in bpy.context.preferences.filepaths.asset_libraries if Path(library.path) == LIBRARY]


def register() -> None:
    """The preferences list the library as long as the extension is enabled."""
    if LIBRARY.is_dir() and not _ours():
        bpy.context.preferences.filepaths.asset_libraries.new(name="Cloak", directory=str(LIBRARY))


def unregister() -> None:
    for library in _ours():
        bpy.context.preferences.filepaths.asset_libraries.remove(library)
