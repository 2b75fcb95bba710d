# SPDX-License-Identifier: GPL-3.0-or-later
"""The detector's eye: what a detector makes of the body from where the user, or the scene's camera, looks.

The trainer renders the view as it renders for training, in own clothing and (once there are colours) cloaked. A timer
asks again when the view, the body or the colours have changed, as soon as the last answer is there; boxes are drawn
over the viewport only where they belong to what it shows.
"""

import logging
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..blender.blend_paths import absolute
from ..blender.mesh_arrays import evaluated_mesh, to_world, topology, vertex_points
from ..body.garments import worn_by
from ..body.objects import object_of
from ..files.errors import InputError
from ..files.identity import sha256_arrays
from ..poses.poses import PoseChoice
from ..session import session
from ..trainer.command_lines import cloak_command, options
from ..trainer.onlooker import Onlooker, Seen
from ..trainer.preferences import trainer
from ..training.cloths import is_cloth
from ..training.detectors import judges
from ..training.runs import run_of, trained_faces
from ..ui.drawing import WHITE, fill, frame, short, size_of_words, width_of, write
from ..ui.window import Hooks, areas, between_strokes, main_region, redraw
from .reasons import export_worn, worn_reason
from .viewpoints import Viewpoint, camera_frame, of_camera, of_view

LOG = logging.getLogger(__name__)
LONGEST = 640  # pixels along the longer side of the pictures that the detector gets
TICK_SECONDS = 0.2


class Eye:
    """Watches one body through detectors."""

    def __init__(self, obj: bpy.types.Object, settings: bpy.types.PropertyGroup, folder: Path) -> None:
        self.message = ""  # why the detector cannot look now; "" if it can
        self.seen: Seen | None = None
        self.viewpoint: Viewpoint | None = None  # viewpoint of the last answer
        self.region = 0  # the viewport that is looked from, by its address; 0 for any
        self._uid, self._folder = obj.session_uid, folder
        self._program = trainer()
        self._look_with(judges(settings), settings.device)
        self._asked: tuple | None = None
        self._asked_from: Viewpoint | None = None
        self._shape: tuple = ()
        self._fitting: tuple[tuple, Path | None] = (), None
        self._exported: tuple = ()

    def _look_with(self, specs: tuple[str, ...], device: str) -> None:
        """Start the process of these detectors."""
        self.specs = specs
        command = cloak_command(self._program, "look", "-", *options(specs, device=device))
        self._onlooker = Onlooker(command, self._folder)

    @property
    def object(self) -> bpy.types.Object | None:
        return object_of(self._uid)

    @property
    def waiting(self) -> bool:
        return self._onlooker.waiting

    def tick(self, context: bpy.types.Context) -> None:
        """Take what has been answered and ask what is new. Raises `InputError` when there is nothing to look at."""
        specs = self.specs
        with suppress(InputError):  # while a name is being typed the last detectors go on
            specs = judges(context.scene.cloak)
        if specs != self.specs:
            self._onlooker.stop()
            self.seen, self._asked = None, None
            self._look_with(specs, context.scene.cloak.device)
        if failure := self._onlooker.failure():
            raise InputError(failure)
        if self.object is None:
            raise InputError("The body that was looked at is gone")
        before = (self.seen, self.message)
        try:
            seen = self._onlooker.answer()
            if seen is not None:
                self.seen, self.viewpoint = seen, self._asked_from
            if not self.waiting:
                self._ask(context, self.object)
                self.message = ""
        except InputError as error:
            self.message = str(error)
        if before != (self.seen, self.message):
            redraw()

    def _ask(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        viewpoint = self._looks_from(context, obj).sized(LONGEST)
        settings, run = context.scene.cloak, self._run(obj)
        if reason := worn_reason(obj):
            raise InputError(reason)
        self._export(context, obj, run)
        background = {"background": settings.judging.eye_background}
        if settings.backgrounds:
            background["backgrounds"] = absolute(settings.backgrounds)
        worn, stamp = {}, 0
        if run is not None and (run / "colors.npy").is_file():
            worn = {"logo": str(run / "logo.npy"), "colors": str(run / "colors.npy")}
            worn |= {"cloth": str(run)} if is_cloth(run) else {}
            stamp = (run / "colors.npy").stat().st_mtime_ns
        asked = (viewpoint, self._exported, stamp, tuple(worn.items()), tuple(background.items()))
        if asked != self._asked:
            self._onlooker.ask({"scene": str(self._folder / "scene"), **asdict(viewpoint), **worn, **background})
            self._asked, self._asked_from = asked, viewpoint

    def _run(self, obj: bpy.types.Object) -> Path | None:
        """The run that the body wears, where that was trained on these faces; asked anew where either has changed."""
        run = run_of(obj)
        key = (session.mesh_changes, obj.cloak.run, run is not None and (run / "logo.npy").is_file())
        if self._fitting[0] != key:
            self._fitting = key, None
            with suppress(InputError):
                if key[-1] and trained_faces(run)[1] == topology(obj):
                    self._fitting = key, run
        return self._fitting[1]

    def _looks_from(self, context: bpy.types.Context, obj: bpy.types.Object) -> Viewpoint:
        if context.scene.cloak.judging.eye_from == "CAMERA":
            return of_camera(context.scene, obj)
        found = [(main_region(area), area.spaces.active.region_3d) for _, area in areas("VIEW_3D")]
        if not found:
            raise InputError("There is no 3D viewport to look from: choose From > Camera")
        region, view = next((pair for pair in found if pair[0].as_pointer() == self.region), found[0])
        return of_view(context.scene, region, view, obj)

    def _export(self, context: bpy.types.Context, obj: bpy.types.Object, run: Path | None) -> None:
        """Export the current body if it changed."""
        if obj.mode == "EDIT":
            raise InputError("Leave Edit Mode (Tab): the detector looks at the body as it then is")
        worn = tuple(o.name for o in worn_by(obj))
        about = (str(run), is_cloth(run), worn, tuple(value for row in obj.matrix_world for value in row))
        if (session.mesh_changes, *about) == self._shape:
            return
        digest = shape_digest(context, [obj, *worn_by(obj)])
        if (digest, *about) != self._exported:
            export_worn(context, obj, run, PoseChoice(), self._folder / "scene")
            self._exported = (digest, *about)
        self._shape = (session.mesh_changes, *about)  # exporting may itself have counted as a change

    def close(self) -> None:
        """End the process."""
        self._onlooker.stop()


def shape_digest(context: bpy.types.Context, objects: list[bpy.types.Object]) -> str:
    """A hash of where the objects' evaluated vertices are."""
    graph, known = context.evaluated_depsgraph_get(), []
    for obj in objects:
        with evaluated_mesh(obj, graph) as (mesh, matrix):
            known += [to_world(vertex_points(mesh), matrix), np.array(len(mesh.polygons))]
    return sha256_arrays(*known)


def open_eye(eye: Eye) -> None:
    """Watch with this eye."""
    session.eye, session.eye_closed_because = eye, ""
    if not bpy.app.background:
        bpy.app.timers.register(tick)


@persistent
def close_eye(*_: object) -> None:
    """Close the open eye."""
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    if session.eye is not None:
        session.eye.close()
    session.eye = None


@between_strokes(TICK_SECONDS)
def tick() -> float | None:
    """The timer's function."""
    if session.eye is None:
        return None
    try:
        session.eye.tick(bpy.context)
    except Exception as error:
        if not isinstance(error, InputError):
            LOG.exception("Detector's eye")
        session.eye.close()
        session.eye, session.eye_closed_because = None, str(error) or type(error).__name__
        redraw()
        return None
    return TICK_SECONDS


KINDS = {"clothing": ("Own clothing", (0.84, 0.37, 0.0)), "cloak": ("Cloak", (0.0, 0.55, 0.85))}
"""What is looked at: its name, and the sRGB colour of its boxes."""
LEFT, BELOW_TOP, LINE = 70, 110, 18  # position of the lines, in pixels
Rectangle = tuple[float, float, float, float]  # left, bottom, right, top in pixels


def place_of_picture(context: bpy.types.Context, watching: Eye) -> Rectangle | None:
    """Return the last picture's rectangle in this viewport; None if the viewport shows something else."""
    region, view, seen_from = context.region, context.region_data, watching.viewpoint
    if seen_from is None or view is None:
        return None
    with suppress(InputError):
        if of_view(context.scene, region, view, watching.object).is_like(seen_from):
            whole = (0.0, 0.0, float(region.width), float(region.height))
            return camera_frame(context) if view.view_perspective == "CAMERA" else whole
    return None


def box_in(place: Rectangle, box: tuple[float, ...], seen: Seen) -> Rectangle:
    """A box of the picture (its rows count from the top) in a viewport."""
    left, bottom, right, top = place
    across, up = (right - left) / seen.width, (top - bottom) / seen.height
    x1, y1, x2, y2 = box[:4]
    return left + x1 * across, top - y2 * up, left + x2 * across, top - y1 * up


def draw() -> None:
    """Viewport callback."""
    watching, context = session.eye, bpy.context
    if watching is None or watching.object is None or not context.space_data.overlay.show_overlays:
        return
    scale = size_of_words(context)
    place = place_of_picture(context, watching)
    if place is not None and watching.seen is not None:
        _draw_boxes(watching.seen, place, scale)
    x, y = LEFT * scale, context.region.height - BELOW_TOP * scale
    for words, color in lines(watching, place is not None):
        write(words, x, y, color)
        y -= LINE * scale


def lines(watching: Eye, fits: bool) -> list[tuple[str, tuple[float, float, float]]]:
    """Return the lines at the upper left and their colours. fits: the viewport shows the last picture."""
    if watching.message:
        return [("Detector's eye", WHITE), (watching.message, KINDS["clothing"][1])]
    told = [("Detector's eye" + ("" if fits and not watching.waiting else " (looking...)"), WHITE)]
    for spec, glances in watching.seen.glances.items() if watching.seen is not None and fits else ():
        point = next(iter(glances.values())).operating_point
        told.append((f"{short(spec)} reports from {point:g}", WHITE))
        for kind, glance in glances.items():
            name, color = KINDS[kind]
            told.append((f"    {name}: {glance.describe()}", color))
    return told


def _draw_boxes(seen: Seen, place: Rectangle, scale: float) -> None:
    """Draw the reported boxes, those of the cloak with thicker lines."""
    for glances in seen.glances.values():
        for kind, glance in glances.items():
            color, thickness = KINDS[kind][1], (3 if kind == "cloak" else 2) * scale
            for box in (box for box in glance.boxes if box[4] > glance.operating_point):
                x1, y1, x2, y2 = box_in(place, box, seen)
                frame(x1, y1, x2, y2, color, thickness)
                words = f"{KINDS[kind][0]} {box[4]:.2f}"
                top = y2 if kind == "cloak" else y1 - 18 * scale  # so that two boxes' words do not meet
                fill(x1, top, width_of(words) + 8 * scale, 18 * scale, color, 0.85)
                write(words, x1 + 4 * scale, top + 5 * scale)


HOOKS = Hooks(("load_pre", close_eye), drawing=((draw, "POST_PIXEL"),), closing=close_eye)
