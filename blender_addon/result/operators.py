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
from bpy.props import EnumProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

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
from ..poses.export import Export, export, poses_reason
from ..poses.poses import PoseChoice
from ..properties import output_folder
from ..trainer.jobs import run_cloak
from ..trainer.program import SAMPLES
from ..training import runs
from ..training.runs import first_pose, run_of
from ..translations import said
from ..ui import props
from ..ui.bases import WITH_UNDO, BodyOperator, CloakOperator
from .evaluations import result_reason

LIBRARY = ASSETS / "library"  # of the built extension
INWARDS = (0.0, 0.35, 0.7)  # shares of the way from a face's middle to its corners, where its mean colour is taken


def wear_reason(context: bpy.types.Context) -> str:
    """Why the body cannot be given, or be rid of, the colours."""
    return result_reason(context) or mode_reason(active_body(context), "Leave {mode} to see the colours on the model")


class CLOAK_OT_result_load(BodyOperator, label="Load Colours", needs=wear_reason):
    """Bring the colours of the run folder onto the model"""

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        count = runs.import_colors(context, obj, run_of(obj))
        return f"{count:,} faces of '{obj.name}' wear the trained colours"


@functools.cache  # Blender keeps no copy of a menu's words: they must live on
def ready_cloaks() -> list[tuple[str, str, str]]:
    """The cloaks that come with the extension: name, title, and what they are."""
    paths = sorted(ASSETS.glob("*/zoo.json"))
    return [(path.parent.name, path.parent.name, str(read_json(path).get("about", ""))) for path in paths]


class CLOAK_OT_ready_cloak(CloakOperator, label="Ready Cloak"):
    """Wear a cloak that comes with Cloak, on the sample body, which is added where the active body is another. The \
run is copied to the output folder"""

    bl_options = WITH_UNDO

    cloak: EnumProperty(name="Ready Cloak", description="Which one to wear", items=lambda _, context: ready_cloaks())

    def run(self, context: bpy.types.Context) -> str:
        source = ASSETS / self.cloak
        _, expected = runs.trained_faces(source)
        if body_reason(context) or topology(active_body(context)) != expected:
            bodies = read_scene(ASSETS / "sample")
            add_people(context, bodies, False, "Sample Body").cloak.made_from = f"{SAMPLES['BARE']}|{bodies.topology}"
        obj, place = active_body(context), first_free(output_folder(context.scene.cloak), self.cloak)
        with written(place):
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copytree(source, place)
        return runs.wear_run(context, obj, place)


class CLOAK_OT_result_toggle(BodyOperator, label="Toggle Cloak", needs=wear_reason):
    """Switch between the cloak and the body's own materials"""

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        if is_dressed(obj):
            undress(obj)
            colors.show_attribute(obj)
            return f"'{obj.name}' shows its own materials"
        runs.import_colors(context, obj, run_of(obj))
        return f"'{obj.name}' wears the cloak"


class CLOAK_OT_explain(CloakOperator, label="Explain"):
    """What a figure of the panel means"""

    tip: props.text("Tip", "What the figure means")

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return said(properties.tip)

    def run(self, context: bpy.types.Context) -> str:
        return self.tip


class CLOAK_OT_use_standard_view(CloakOperator, label="Use Standard"):
    """Show the trained colours as the detector saw them: Standard colours and, in a Solid viewport, flat light"""

    bl_options = WITH_UNDO

    def run(self, context: bpy.types.Context) -> str:
        colors.use_standard_view(context.scene)
        if lit := colors.light_reason(context.space_data):
            context.space_data.shading.light = "FLAT"
        return "View transform: Standard" + (", flat light" if lit else "")


class CLOAK_OT_open_report(CloakOperator, label="Open Report", trains=True):
    """Open the run's report in the web browser, after making it if need be"""

    @staticmethod
    @of_the_body
    def needs(context: bpy.types.Context, obj: bpy.types.Object) -> str:
        run = run_of(obj)
        if run is None:
            return "Choose a run in the list first"
        known = (run / "report.html").is_file() or (run / "config.json").is_file()
        return "" if known else f"{run}: not a run folder (no config.json in it), so there is nothing to report"

    def run(self, context: bpy.types.Context) -> str:
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


class CLOAK_OT_cloth_picture(CloakOperator, ImportHelper, label="Picture as Cloth"):
    """Wear a picture as cloth that repeats, on the active logo: to compare it with what was trained"""

    bl_options = WITH_UNDO
    filter_glob: StringProperty(default="*.png;*.jpg;*.jpeg;*.webp", options={"HIDDEN"})
    width: props.number("Width", "After how many metres it repeats", 0.25, min=0.01, max=10.0)

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        return logo_reason(context) or poses_reason(context, PoseChoice())

    def run(self, context: bpy.types.Context) -> str:
        obj, logo, path = active_body(context), active_logo(active_body(context)), Path(self.filepath)
        if obj.mode == "EDIT":
            bpy.ops.object.mode_set(mode="OBJECT")
        run = runs.new_run(output_folder(context.scene.cloak), obj.name, path.stem)
        pixels = read_picture(path)[..., :3]
        pixels = np.repeat(pixels, 3, -1) if pixels.shape[-1] < 3 else pixels
        done = export(context, obj, logo, PoseChoice(), runs.input_folder(run))
        write_run(run, done, pixels, self.width, obj.cloak.made_from)
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


class CLOAK_OT_lay_cloth(BodyOperator, label="Lay Cloth at True Size"):
    """Make the UV map of the ready cloths, on which they are as large as they are printed: front, back \
and sides are projected, as the trainer lays a cloth"""

    @staticmethod
    @of_the_body
    def needs(context: bpy.types.Context, obj: bpy.types.Object) -> str:
        if ready_cloth(obj) is None:
            return "Give the body a cloth first: drag one from the Asset Browser, library Cloak, onto it"
        return mode_reason(obj, "Leave {mode} to lay the cloth")

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
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
