# SPDX-License-Identifier: GPL-3.0-or-later
"""Run folders: where a training's input and output lie, and how its colours come back onto the model.

A run RUN has its input beside it, in RUN.input: the export (scene, face list, record), the command and the log. So a
run can be resumed after Blender was closed, and its colours are checked against the mesh they were made for. A run that
the command line made has none.
"""

import os
import re
import shutil
import time
from contextlib import suppress
from pathlib import Path

import bpy
import numpy as np

from ..blender import colors
from ..blender.blend_paths import absolute, blend_folder, first_free, portable
from ..blender.marks import COLORS, OWN_MATERIAL, layer_name
from ..blender.mesh_arrays import mesh_triangles, polygon_loops, require_object_mode, topology, vertex_points
from ..blender.pictures import Cloth, load_cloth
from ..body.garments import pieces_of
from ..body.objects import object_of, refusal, require_body, scene_axes
from ..exchange.bodies import Bodies
from ..exchange.cloth import CLOTH_FILE, cloth_metres, corner_uv
from ..exchange.face_lists import read_colors, read_face_list
from ..exchange.scenes import read_scene
from ..files.errors import InputError
from ..files.reading import read_json
from ..files.writing import write_json
from ..poses.export import RECORD, Export, read_export
from ..session import session
from ..trainer.jobs import Job
from ..trainer.program import OPTIONS
from ..ui.bases import push_undo


def run_of(obj: bpy.types.Object) -> Path | None:
    """The run folder of an object; where that is not there (an appended object), the place it once had."""
    if not obj.cloak.run:
        return None
    run = Path(absolute(obj.cloak.run))
    kept = Path(obj.cloak.run_place) if obj.cloak.run_place else run
    return run if run.is_dir() or not kept.is_dir() else kept


def body_of(run: Path, expected: str) -> bpy.types.Object | None:
    """The body of this file that a run belongs to: one that was given it, else one with its name, else with its faces.

    expected: the topology of the faces that are trained. None where no body has those.
    """
    done = export_of(run)
    active = bpy.context.view_layer.objects.active
    meshes = [obj for obj in bpy.context.view_layer.objects if obj.type == "MESH" and len(obj.data.polygons)]
    meshes.sort(key=lambda obj: (run_of(obj) != run, done is None or obj.name != done.object, obj != active, obj.name))
    return next((obj for obj in meshes if topology(obj) == expected), None)


COMMAND = "command.json"
PROJECT = "{project}"  # in remembered options: the folder of the .blend file, when the run lies there or below


def input_folder(run: Path) -> Path:
    """Return the folder of a run's input."""
    return run.with_name(run.name + ".input")


def export_of(run: Path) -> Export | None:
    """What the add-on exported for a run; None of a run of the command line."""
    folder = input_folder(run)
    return read_export(folder) if (folder / RECORD).is_file() else None


def exported_scene(run: Path) -> Path | None:
    """The scene package that the add-on exported for a run; None of a run of the command line."""
    scene = input_folder(run) / "scene"
    return scene if scene.is_dir() else None


def new_run(output: Path, obj: str, logo: str) -> Path:
    """A run folder in `output` that does not exist yet, named after object and logo."""
    name = re.sub(r'[\\/:*?"<>|\x00-\x1f]+', "_", f"{obj} {logo}").strip(" .") or "run"
    return first_free(output, name, beside=".input")


def side_folder(run: Path) -> Path:
    """Where what is made from a run keeps its logs: with the run's input, or in the run where that has none."""
    return input_folder(run) if input_folder(run).is_dir() else run


def remember_options(run: Path, options: list[str]) -> None:
    """Store a run's options for Resume; paths inside the project are stored relative to it."""
    folder, project = input_folder(run), blend_folder()
    record: dict[str, object] = {"options": options}
    if project is not None and folder.is_relative_to(project):
        record["project"] = Path(os.path.relpath(project, folder)).as_posix()
        record["options"] = [word.replace(f"{project}{os.sep}", f"{PROJECT}/") for word in options]
    write_json(folder / COMMAND, record)


def remembered_options(run: Path) -> list[str]:
    """The options a run was started with. Raises `InputError` for others."""
    file = input_folder(run) / COMMAND
    record = read_json(file)
    options, project = record.get("options"), record.get("project", "")
    if not isinstance(options, list) or not all(isinstance(word, str) for word in (*options, project)):
        raise InputError(f"{file}: not the options of a run")
    if options[-2:] == ["--made-from", "sample:train"]:  # of an earlier version
        options = [*options[:-2], "--made-from=sample:train"]
    for word in options:  # a file may be anybody's: only what the add-on itself would have written is repeated
        if not word.startswith(tuple(f"--{name}=" for name in OPTIONS)):
            raise InputError(f"{file}: {word.partition('=')[0]} is no option of a run that Blender started")
    return [word.replace(PROJECT, os.path.normpath(file.parent / project)) if project else word for word in options]


def remove(run: Path) -> None:
    """Delete a run and its input. Raises `InputError` where either is something else, and deletes nothing then."""
    folders = [folder for folder in (run, input_folder(run)) if folder.exists() or folder.is_symlink()]
    for folder in folders:
        known = (folder / "config.json").is_file() or (folder / RECORD).is_file()
        if folder.is_symlink() or not known:
            raise InputError(f"{folder}: not a run that Cloak made, and is left alone")
    for folder in folders:
        try:
            shutil.rmtree(folder)
        except OSError as error:
            raise InputError(f"{error.filename or folder}: cannot be deleted ({error.strerror})") from None


def trained_faces(run: Path) -> tuple[np.ndarray, str]:
    """Ids [L] of the faces a run trains, and the topology of the body they belong to."""
    done = export_of(run)
    if not done and not run.is_dir():
        raise InputError(f"{run}: no such run folder")
    face_list = read_face_list(done.face_list if done else run / "logo.npy")
    expected = done.topology if done else face_list.topology
    if expected is None:
        raise InputError(f"{run / 'logo.json'}: names no topology, so the colours cannot be matched to a mesh")
    return face_list.ids, expected


def require_same_topology(obj: bpy.types.Object, expected: str) -> None:
    """Raise `InputError` unless the object has the exported faces."""
    now = topology(obj)
    if now != expected:
        raise InputError(
            f"'{obj.name}' changed since export: its faces are {now[:12]}..., the colours are for {expected[:12]}...; "
            "undo the change, or export and train again"
        )


def import_colors(context: bpy.types.Context, obj: bpy.types.Object, run: Path) -> int:
    """Bring a run's colours onto the object as colour attribute and material, all or nothing; returns how many."""
    require_body(obj)
    require_object_mode(obj, "Leave {mode} to see the colours on the model")
    count = len(trained_faces(run)[0])
    if not (run / "colors.npy").exists():
        raise InputError(f"{run}: no colours yet; wait for the first step")
    values = read_colors(run / "colors.npy", count=count)
    LiveColors(obj, run).write(context, obj, values, dress=True)
    return count


def wear_run(context: bpy.types.Context, obj: bpy.types.Object, run: Path) -> str:
    """Give an object a run and its colours; returns what to say."""
    obj.cloak.run = portable(str(run), blend_folder())
    return f"'{obj.name}' wears {run.name}: {import_colors(context, obj, run):,} faces"


class LiveColors:
    """Shows a run's colours on its body, also while they grow. What can be prepared is, so that writing is quick.

    The body is found again by what it is, should the file have been reverted, opened again, or changed.
    """

    def __init__(self, obj: bpy.types.Object, run: Path) -> None:
        self._ids, self._topology = trained_faces(run)
        done = export_of(run)
        self._run, self._name, self._garments = run, obj.name, done.garments if done else []
        self._given, self._refused, self._last, self._looked = False, "", time.monotonic(), -1
        self._use(obj)

    def _use(self, obj: bpy.types.Object) -> None:
        """Prepare to write onto this body. Raises `InputError` where it has other faces."""
        require_same_topology(obj, self._topology)
        if not self._garments and len(self._ids) and self._ids[-1] >= len(obj.data.polygons):
            raise InputError(f"{self._run}: face {self._ids[-1]} is beyond the mesh's {len(obj.data.polygons)}")
        self._uid, self._seen = obj.session_uid, 0
        self._own = {obj.session_uid: colors.own_face_colors(obj)}  # of body and garments, without the cloak

    def give(self, obj: bpy.types.Object) -> None:
        """Make the run the body's."""
        obj.cloak.run = portable(str(self._run), blend_folder())
        self._given = True

    def body(self) -> bpy.types.Object | None:
        """The body, found anew where it is not the one that was there at the start; None where there is none."""
        obj = object_of(self._uid)
        if obj is not None and obj.users_scene:
            return obj
        if self._looked == session.mesh_changes:
            return None
        self._looked = session.mesh_changes
        body_object = body_of(self._run, self._topology)
        if body_object is not None:
            self._use(body_object)
            self.give(body_object)
        return body_object

    def tick(self, job: Job) -> None:
        """Called by the timer of the job that trains."""
        if not job.running:
            return
        obj = self.body()
        if obj is None:
            job.notice = f"'{self._name}' was deleted: its training goes on in {self._run.name}. Ctrl Z brings it back"
            return
        if not self._given:
            self.give(obj)
        if run_of(obj) != self._run:
            job.notice = f"'{obj.name}' wears another run: choose {self._run.name} in the list to see its colours"
            return
        settings = bpy.context.scene.cloak
        if settings.live and time.monotonic() - self._last >= settings.live_seconds:
            self._refused, self._last = refusal(self.update, bpy.context), time.monotonic()
        job.notice = self._refused

    def finish(self, job: Job) -> str | None:
        """At the end of the job: import the last colours. Returns why they were not; None where they were, or none."""
        if not (self._run / "colors.npy").exists():
            if job.state == "done":
                raise InputError(f"The trainer ended and left no colours in {self._run.name}; see {job.log}")
            return None
        self._looked = -1
        obj = self.body()
        try:
            if obj is None:
                raise InputError("the object is gone; open its file and press Load Colours")
            if run_of(obj) != self._run:
                raise InputError(f"'{obj.name}' wears another run; choose {self._run.name} in the list")
            require_object_mode(obj, "Leave {mode} and press Load Colours")
            import_colors(bpy.context, obj, self._run)
            push_undo("Cloak Colours")
        except InputError as error:
            return f"{job.message}; no colours imported: {error}"
        return None

    def update(self, context: bpy.types.Context) -> bool:
        """Write new colours if there are any; False when there is nothing new or the object cannot take them now.

        What undo took off the object comes back. Raises `InputError` when the object changed since export.
        """
        obj, path = object_of(self._uid), self._run / "colors.npy"
        if obj is None or obj.mode != "OBJECT" or not path.exists():
            return False
        stamp = path.stat().st_mtime_ns
        # What undo takes; Show Original leaves material and attributes where they are.
        marked = all(layer_name(obj.data, role) for role in (OWN_MATERIAL, COLORS))
        naked = not (self._seen and marked and any(map(colors.is_cloak, obj.data.materials)))
        if stamp == self._seen and not naked:
            return False
        self.write(context, obj, read_colors(path, count=len(self._ids)), dress=naked)
        self._seen = stamp
        return True

    def write(self, context: bpy.types.Context, obj: bpy.types.Object, values: np.ndarray, dress: bool) -> None:
        """Colours [L, 3] onto the object and its garments; with `dress` their faces get the cloak's material."""
        require_same_topology(obj, self._topology)
        # All are there and the cloth is whole, or nothing is written.
        pieces = [obj, *pieces_of(obj, self._garments)]
        firsts = [0, *(garment.first for garment in self._garments)]
        scene = exported_scene(self._run)
        cloths = [read_cloth(*pair, self._run, scene) if dress else None for pair in zip(pieces, firsts, strict=True)]
        for one, first, cloth in zip(pieces, firsts, cloths, strict=True):
            on_it = (self._ids >= first) & (self._ids < first + len(one.data.polygons))
            if one.session_uid not in self._own:
                self._own[one.session_uid] = colors.own_face_colors(one)
            worn = self._own[one.session_uid].copy()
            worn[self._ids[on_it] - first] = values[on_it]
            colors.write_face_colors(one, COLORS, worn)
            if dress:
                colors.dress(one, self._ids[on_it] - first, cloth)
                colors.activate(one, COLORS)
        if dress:
            colors.show_attribute(obj, COLORS)
        for image in {colors.worn_cloth(one.data)[0] for one in pieces if not dress} - {None}:
            name, new = image.name, load_cloth(self._run / CLOTH_FILE)
            image.user_remap(new)
            bpy.data.images.remove(image)
            new.name = name
        obj.cloak.worn = str(self._run)


# --- the cloth of a run, laid onto a body as the trainer lays it: in the first pose that was exported ----------------


def is_cloth(run: Path | None) -> bool:
    """Whether what a run trains is a cloth that repeats."""
    return run is not None and (run / CLOTH_FILE).is_file()


def read_cloth(obj: bpy.types.Object, first: int, run: Path, scene: Path | None) -> Cloth | None:
    """The cloth that a run trained, on the object's corners; None where it trained colours of faces.

    scene: what was exported for the run, in which the object's faces are numbered from `first`. Raises `InputError`
    where the cloth is damaged.
    """
    if not is_cloth(run):
        return None
    width, bodies = cloth_metres(run), first_pose(obj, scene)
    if bodies.face_count == len(obj.data.polygons):  # these are the object's own faces alone
        first = 0
    before = int(bodies.loop_total[:first].sum())
    image = load_cloth(run / CLOTH_FILE)
    uv = corner_uv(bodies, width, width * image.size[1] / image.size[0])
    return image, uv[before : before + len(obj.data.loops)]


def first_pose(obj: bpy.types.Object, scene: Path | None) -> Bodies:
    """What was exported for a run; where nothing was, or with faces that modifiers made, the object's own mesh."""
    if scene is not None:
        with suppress(InputError):
            bodies = read_scene(scene)
            if bodies.loop_total is not None:
                return bodies
    mesh, turn = obj.data, np.array(obj.matrix_world)[:3, :3]
    counts, loops = polygon_loops(mesh)
    triangles, faces = mesh_triangles(mesh)
    # Where the object stands is left out: bodies from scene packages lie as in the package.
    points = scene_axes(vertex_points(mesh) @ turn.T) * bpy.context.scene.unit_settings.scale_length
    return Bodies(points[None], triangles, faces, loop_total=counts, loop_vertices=loops)
