# SPDX-License-Identifier: GPL-3.0-or-later
"""The detector's eye: what a detector makes of the body from where the user, or the scene's camera, looks.

The trainer renders the view as it renders for training, in own clothing and (once there are colours) cloaked. It is
asked again when the view, the body or the colours have changed, as soon as the last answer is there; boxes are drawn
over the viewport only where they belong to what it shows. `cloak look` is a job in a lane of its own, so that a
training can be watched: asked on its standard input, it answers in files, and ends when Blender does.
"""

import json
import subprocess
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import bpy
import numpy as np

from ..blender.blend_paths import absolute
from ..blender.mesh_arrays import evaluated_mesh, to_world, topology, vertex_points
from ..body.garments import worn_by
from ..body.objects import object_of
from ..files.errors import InputError
from ..files.identity import sha256_arrays
from ..files.reading import read_json
from ..poses.poses import PoseChoice
from ..session import session
from ..trainer.jobs import Job
from ..trainer.program import cloak_command, options, start_process, trainer
from ..training.detectors import judges
from ..training.runs import is_cloth, run_of, trained_faces
from ..ui.drawing import WHITE, fill, frame, short, size_of_words, width_of, write
from ..ui.window import Hooks, areas, main_region, redraw
from .evaluations import KINDS, Sight, by_detector, export_worn, worn_reason
from .viewpoints import Viewpoint, camera_frame, of_camera, of_view

LABEL = "Detector's Eye"
LONGEST = 640  # pixels along the longer side of the pictures that the detector gets


@dataclass(frozen=True)
class Seen:
    """An answer: its rows, the size of the pictures, and where they were looked at from."""

    sights: tuple[Sight, ...]
    width: int
    height: int
    viewpoint: Viewpoint | None = None


def read_answer(path: Path, viewpoint: Viewpoint | None = None) -> Seen:
    """The trainer's answer to a look. Raises `InputError` for a question that had none."""
    record = read_json(path)
    if "error" in record:
        raise InputError(str(record["error"]))
    try:
        sights = []
        for spec, answer in record["detectors"].items():
            for kind in (kind for kind in KINDS if kind in answer):
                boxes = tuple(tuple(map(float, box)) for box in answer[kind]["boxes"])
                score, point = float(answer[kind]["max_person"]), float(answer["operating_point"])
                sights.append(Sight(spec, kind, Path(record["pictures"].get(kind, "")), score, point, boxes))
        return Seen(tuple(sights), int(record["width"]), int(record["height"]), viewpoint)
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{path}: not the answer to a look") from None


class Eye(Job):
    """Watches one body through detectors; it has one question at a time under way."""

    lane = LABEL  # no other job waits for it

    def __init__(self, obj: bpy.types.Object, settings: bpy.types.PropertyGroup, folder: Path, region: int = 0) -> None:
        super().__init__(LABEL, [], folder, "look")
        self.on_tick = self._watch
        self.region = region  # the viewport that is looked from, by its address; 0 for any
        self._uid = obj.session_uid
        self._folder = folder
        self._answer = folder / "look.json"
        self._program = trainer()
        self._about: tuple = ()
        self._exported: tuple = ()
        self._run: Path | None = None
        self._ask_these(judges(settings), settings.device)

    def _ask_these(self, specs: tuple[str, ...], device: str) -> None:
        """Make the command of these detectors; nothing has been asked of them."""
        self._commands = [cloak_command(self._program, "look", "-", *options(specs, device=device))]
        self.specs = specs
        self.seen: Seen | None = None
        self.waiting = False
        self._asked: tuple = ()
        self._asked_from: Viewpoint | None = None

    def _start(self, command: list[str]) -> subprocess.Popen:
        return start_process(command, subprocess.DEVNULL, self.log, stdin=subprocess.PIPE)

    def _terminate(self) -> None:
        """Let the process go: it ends when its standard input does; asked twice, in case it is still starting."""
        with suppress(OSError):
            self._process.stdin.close()
        super()._terminate()

    @property
    def object(self) -> bpy.types.Object | None:
        return object_of(self._uid)

    def _watch(self, _: Job) -> None:
        """Take what has been answered and ask what is new. Raises `InputError` when there is nothing to look at."""
        if not self.running or self._cancelled:
            return
        context, specs = bpy.context, self.specs
        with suppress(InputError):  # while a name is being typed the last detectors go on
            specs = judges(context.scene.cloak)
        if specs != self.specs:
            self._terminate()
            self._ask_these(specs, context.scene.cloak.device)
            self._process = self._start(*self._commands)
        if self.object is None:
            self.cancel()
            self._finish("failed", "The body that was looked at is gone")
            return
        before, self.notice = (self.seen, self.notice), ""
        try:
            if self.waiting and self._answer.exists():
                self.waiting = False
                self.seen = read_answer(self._answer, self._asked_from)
            if not self.waiting:
                self._ask(context, self.object)
        except InputError as error:
            self.notice = str(error)
        if before != (self.seen, self.notice):
            redraw()

    def _ask(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        """Ask what the detectors see from here, if anything has changed since the last question."""
        viewpoint = self._viewpoint(context, obj).sized(LONGEST)
        settings = context.scene.cloak
        if reason := worn_reason(obj):
            raise InputError(reason)
        self._prepare(context, obj)
        run = self._run
        request = {"scene": str(self._folder / "scene"), "out": str(self._folder), **asdict(viewpoint)}
        request["background"] = settings.judging.eye_background
        if settings.backgrounds:
            request["backgrounds"] = absolute(settings.backgrounds)
        stamp = 0
        if run is not None and (run / "colors.npy").is_file():
            request |= {"logo": str(run / "logo.npy"), "colors": str(run / "colors.npy")}
            request |= {"cloth": str(run)} if is_cloth(run) else {}
            stamp = (run / "colors.npy").stat().st_mtime_ns
        if (request, self._exported, stamp) == self._asked:
            return
        self._answer.unlink(missing_ok=True)
        with suppress(OSError):  # it has ended: the next tick tells
            self._process.stdin.write(f"{json.dumps(request)}\n".encode())
            self._process.stdin.flush()
        self._asked, self._asked_from, self.waiting = (request, self._exported, stamp), viewpoint, True

    def _viewpoint(self, context: bpy.types.Context, obj: bpy.types.Object) -> Viewpoint:
        if context.scene.cloak.judging.eye_from == "CAMERA":
            return of_camera(context.scene, obj)
        views = [(main_region(area), area.spaces.active.region_3d) for _, area in areas("VIEW_3D")]
        if not views:
            raise InputError("There is no 3D viewport to look from: choose From > Camera")
        region, view = next((pair for pair in views if pair[0].as_pointer() == self.region), views[0])
        return of_view(context.scene, region, view, obj)

    def _prepare(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        """Find the run that the body wears, and export the body, where either has changed."""
        if obj.mode == "EDIT":
            raise InputError("Leave Edit Mode (Tab): the detector looks at the body as it then is")
        worn, run = worn_by(obj), run_of(obj)
        there = run is not None and (run / "logo.npy").is_file()
        about = (str(run), there, is_cloth(run), tuple(o.name for o in worn), tuple(map(tuple, obj.matrix_world)))
        if (session.mesh_changes, *about) == self._about:
            return
        self._run = None
        with suppress(InputError):
            if there and trained_faces(run)[1] == topology(obj):
                self._run = run
        graph, points = context.evaluated_depsgraph_get(), []
        for one in (obj, *worn):
            with evaluated_mesh(one, graph) as (mesh, to_scene):
                points += [to_world(vertex_points(mesh), to_scene), np.array(len(mesh.polygons))]
        shape = (sha256_arrays(*points), str(self._run), *about)
        if shape != self._exported:
            export_worn(context, obj, self._run, PoseChoice(), self._folder / "scene")
            self._exported = shape
        self._about = (session.mesh_changes, *about)  # exporting may itself have counted as a change


# --- over the viewport -----------------------------------------------------------------------------------------------

LEFT, BELOW_TOP, LINE = 70, 110, 18  # position of the lines, in pixels
Rectangle = tuple[float, float, float, float]  # left, bottom, right, top in pixels


def draw() -> None:
    """Viewport callback."""
    watching, context = session.eye, bpy.context
    if watching is None or watching.object is None or not context.space_data.overlay.show_overlays:
        return
    scale = size_of_words(context)
    place = place_of_picture(context, watching)
    if place is not None:
        _draw_boxes(watching.seen, place, scale)
    x, y = LEFT * scale, context.region.height - BELOW_TOP * scale
    for words, color in lines(watching, place is not None):
        write(words, x, y, color)
        y -= LINE * scale


def place_of_picture(context: bpy.types.Context, watching: Eye) -> Rectangle | None:
    """Return the last picture's rectangle in this viewport; None if the viewport shows something else."""
    region, view = context.region, context.region_data
    if watching.seen is None or view is None:
        return None
    with suppress(InputError):
        if of_view(context.scene, region, view, watching.object).is_like(watching.seen.viewpoint):
            whole = (0.0, 0.0, float(region.width), float(region.height))
            return camera_frame(context) if view.view_perspective == "CAMERA" else whole
    return None


def box_in(place: Rectangle, box: tuple[float, ...], seen: Seen) -> Rectangle:
    """A box of the picture (its rows count from the top) in a viewport."""
    left, bottom, right, top = place
    across, up = (right - left) / seen.width, (top - bottom) / seen.height
    x1, y1, x2, y2 = box[:4]
    return left + x1 * across, top - y2 * up, left + x2 * across, top - y1 * up


def lines(watching: Eye, fits: bool) -> list[tuple[str, tuple[float, float, float]]]:
    """Return the lines at the upper left and their colours. fits: the viewport shows the last picture."""
    if watching.notice:
        return [("Detector's eye", WHITE), (watching.notice, KINDS["clothing"][1])]
    rows = [("Detector's eye" + ("" if fits and not watching.waiting else " (looking...)"), WHITE)]
    for spec, sights in by_detector(watching.seen.sights).items() if watching.seen is not None and fits else ():
        rows.append((f"{short(spec)} reports from {sights[0].threshold:g}", WHITE))
        rows += [(f"    {KINDS[one.kind][0]}: {one.describe()}", KINDS[one.kind][1]) for one in sights]
    return rows


def _draw_boxes(seen: Seen, place: Rectangle, scale: float) -> None:
    """Draw the reported boxes, those of the cloak with thicker lines."""
    for sight in seen.sights:
        name, color = KINDS[sight.kind]
        thickness = (3 if sight.kind == "cloak" else 2) * scale
        for box in (box for box in sight.boxes if box[4] > sight.threshold):
            x1, y1, x2, y2 = box_in(place, box, seen)
            frame(x1, y1, x2, y2, color, thickness)
            words = f"{name} {box[4]:.2f}"
            top = y2 if sight.kind == "cloak" else y1 - 18 * scale  # so that two boxes' words do not meet
            fill(x1, top, width_of(words) + 8 * scale, 18 * scale, color, 0.85)
            write(words, x1 + 4 * scale, top + 5 * scale)


HOOKS = Hooks(drawing=((draw, "POST_PIXEL"),))
