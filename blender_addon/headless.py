# SPDX-License-Identifier: GPL-3.0-or-later
"""Train without a window: `blender -b body.blend --command cloak --logo chest --out RUN --save cloaked.blend`.

From a checkout `train.py` does the same, with a Python that has the bpy package too. Exit codes: 0 done, 2 bad input
(one line that names it), 3 stopped, 1 a defect.
"""

import argparse
import os
import signal
import sys
import time
import traceback
from pathlib import Path

import bpy

from . import properties
from .blender import marks
from .blender.faces import import_face_list, logo_names
from .body.objects import add_from_scene, require_body, subdivide
from .exchange.scenes import read_scene
from .files.errors import InputError, Stopped
from .files.writing import written
from .poses.export import export, read_export
from .poses.poses import PoseChoice, held
from .result import render_check
from .trainer import program as trainer
from .trainer.jobs import Job, TrainingJob
from .training import runs

PRINT_SECONDS = 2.0
PREVIEW_SIZE, PREVIEW_SAMPLES, PREVIEW_AZIMUTH = 512, 16, 15.0
DEFAULTS = {"detector": "builtin", "angles": "-10:10:5"}  # of options that the trainer gets; else its own


class Parser(argparse.ArgumentParser):
    """Raises `InputError` for bad options."""

    def error(self, message: str) -> None:
        raise InputError(f"{message} (--help says what it takes)")


def parse(arguments: list[str]) -> argparse.Namespace:
    """Options; bad ones raise `InputError`."""
    parser = Parser(prog="cloak", description="Train a logo on the body of a .blend file.", allow_abbrev=False)
    add = parser.add_argument
    add("--logo", required=True, help="logo on the body (several joined by +), or a face list (.npy)")
    add("--out", required=True, type=Path, help="run folder to write; its input goes to RUN.input")
    add("--save", type=Path, help=".blend file to save with the trained colours")
    add("--preview", type=Path, help="PNG to render (default: RUN/blender.png)")
    add("--blend", type=Path, help=".blend file to open first (for the bpy package; Blender takes it before -P)")
    add("--scene", type=Path, help="build the body from this scene package instead of taking it from the file")
    add("--sample", action="store_true", help="take Cloak's sample body")
    add("--object", help="name of the body (default: the active or only mesh)")
    add("--subdivide", type=int, default=0, metavar="LEVELS", help="subdivide first (Simple), this many times")
    add("--keep-quads", action="store_true", help="with --subdivide: do not triangulate")
    add("--frames", default="", metavar="A:B:STEP", help="frames to train on (default: the current pose)")
    add("--actions", type=int, default=0, metavar="STEP", help="train on every STEP-th frame of all actions")
    add("--leave-out", default="", metavar="NAMES", help="visible meshes on the body not to show the camera, A,B")
    for name in trainer.PASSED_ON:
        add(f"--{name}", default=DEFAULTS.get(name, ""), help="as in cloak train")
    add("--trainer", "--python", default="", help="program cloak, or a Python that has cloak_core (default: found)")
    add("--resume", action="store_true", help="go on with the run in --out")
    add("--init", type=Path, metavar="RUN", help="begin with the colours of another run on the same logo")
    joined: list[str] = []
    for word in arguments:  # `--angles -10:10:5`: argparse would take the value for an option
        if joined and joined[-1] in ("--angles", "--frames"):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return parser.parse_args(joined)


def require_sense(options: argparse.Namespace, run: Path) -> None:
    """Raise `InputError` for options that cannot work, before anything is written and an hour is trained."""
    if options.subdivide < 0:
        raise InputError(f"--subdivide {options.subdivide}: 0 levels or more")
    if options.resume and not run.is_dir():
        raise InputError(f"--out {options.out}: no run to resume there (begin it without --resume)")
    if not options.resume and run.exists():
        raise InputError(f"--out {options.out}: exists already (continue it with --resume, or name another folder)")
    if options.blend is not None and not options.blend.is_file():
        raise InputError(f"--blend {options.blend}: no such file")
    for name, path in (("--save", options.save), ("--preview", options.preview), ("--out", run)):
        if path is None:
            continue
        folder = path.absolute().parent
        if name == "--out":
            with written(f"--out {options.out}"):
                folder.mkdir(parents=True, exist_ok=True)
        elif path.is_dir():
            raise InputError(f"{name} {path}: is a folder; name a file in it")
        if not (folder.is_dir() and os.access(folder, os.W_OK)):
            raise InputError(f"{name} {path}: the folder {folder} does not exist or cannot be written")


def find_body(options: argparse.Namespace, program: str, folder: Path) -> bpy.types.Object:
    """The body the options name, checked and subdivided."""
    objects = bpy.context.view_layer.objects
    meshes = [o for o in objects if o.type == "MESH"]
    obj = objects.active
    if options.sample or options.scene:
        scene = options.scene or folder / "sample"
        if not options.scene:
            job = Job(
                "Sample body", [trainer.cloak_command(program, *trainer.sample_words(scene))], folder, "sample"
            ).wait()
            if job.state != "done":
                raise InputError(job.message)
        obj = add_from_scene(bpy.context, read_scene(scene))
    elif options.object:
        obj = objects.get(options.object)
        if obj is None:
            have = ", ".join(o.name for o in meshes) or "none"
            raise InputError(f"--object {options.object}: no such object in the scene (meshes: {have})")
    elif obj not in meshes and meshes:
        candidates = [o for o in meshes if options.logo in logo_names(o.data)] or meshes
        if len(candidates) > 1:
            raise InputError(f"--object: name the body, one of {', '.join(o.name for o in candidates)}")
        obj = candidates[0]
    require_body(obj)
    if obj.mode == "EDIT":
        obj.update_from_editmode()
        objects.active = obj
        bpy.ops.object.mode_set(mode="OBJECT")
    for _ in range(options.subdivide):
        subdivide(obj, triangulate=not options.keep_quads)
    return obj


def pose_choice(options: argparse.Namespace) -> PoseChoice:
    """Which poses the options ask for."""
    if options.actions and options.frames:
        raise InputError("--frames and --actions: give one of them")
    if options.actions:
        return PoseChoice("ACTIONS", step=options.actions)
    if not options.frames:
        return PoseChoice()
    try:
        first, last, step = (*(int(part) for part in options.frames.split(":")), 1)[:3]
    except ValueError:
        raise InputError(f"--frames {options.frames}: A:B:STEP in whole frames is needed") from None
    return PoseChoice("RANGE", first, last, step)


def main(arguments: list[str]) -> None:
    """Parse the options, export, train, and save the result."""
    options = parse(arguments)
    run = options.out.absolute()
    require_sense(options, run)
    if options.blend is not None:
        try:
            bpy.ops.wm.open_mainfile(filepath=str(options.blend.absolute()))
        except RuntimeError as error:
            why = str(error).strip()
            raise InputError(f"--blend {options.blend}: not a file that Blender can open ({why})") from None
    marks.mark_former()  # of a file that was open before the add-on was
    program = trainer.find_program(options.trainer)
    obj = find_body(options, program, Path(bpy.app.tempdir))
    logo = options.logo
    if logo.endswith(".npy"):
        logo = import_face_list(obj, Path(logo))
    for name in filter(None, options.leave_out.split(",")):
        if name not in bpy.data.objects:
            raise InputError(f"--leave-out {name}: no such object in the file")
        bpy.data.objects[name].cloak.left_out = True
    train(options, obj, logo, program, run)
    obj.cloak.run = str(run)
    count = runs.import_colors(bpy.context, obj, run)
    say(f"{count} faces of '{obj.name}' wear the trained colours")
    if options.save:
        bpy.ops.wm.save_as_mainfile(filepath=str(options.save.absolute()), check_existing=False)
        say(f"saved {options.save}")
    preview = (options.preview or run / "blender.png").absolute()
    with held(bpy.context, obj):
        render_check.render_view(obj, preview, PREVIEW_AZIMUTH, PREVIEW_SIZE, PREVIEW_SAMPLES)
    say(f"rendered {preview}")


def train(options: argparse.Namespace, obj: bpy.types.Object, logo: str, program: str, run: Path) -> None:
    """Export and train, with progress on standard output."""
    values = {name: getattr(options, name) for name in trainer.PASSED_ON}
    detector = trainer.absolute_detector(values.pop("detector"))
    for name in ("backgrounds", "config"):  # the trainer works in a folder of its own
        if Path(values[name]).exists() and values[name]:
            values[name] = Path(values[name]).absolute()
    folder, words = runs.input_folder(run), trainer.options([detector], **values)
    trainer.allow(words)
    words += ["--made-from=sample:train"] if options.sample else []
    words += [f"--init={options.init.absolute()}"] if options.init else []
    if options.resume and folder.is_dir():
        done, begun = read_export(folder), runs.remembered_options(run)
        runs.require_same_topology(obj, done.topology)
        if kept := trainer.differing_options(begun, words):
            say(f"--resume keeps what the run was started with: {kept}")
        words = begun
    else:
        if folder.exists() and not run.exists():
            runs.remove(run)  # what a start left that failed before the training began
        done = export(bpy.context, obj, logo, pose_choice(options), folder)
        runs.remember_options(run, words)
    say(f"exported {done.poses} poses, {done.faces} faces, logo '{done.logo}' of '{done.object}' to {folder}")
    command = trainer.train_command(program, words, done.scene, done.face_list, run)
    job = TrainingJob(command + (["--resume"] if options.resume else []), run, folder).start()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: job.cancel())
    last_line, last = "", 0.0
    while job.poll():
        line = ", ".join(filter(None, (job.describe(), job.progress.figures())))
        if line != last_line and time.monotonic() - last >= PRINT_SECONDS:
            say(line)
            last_line, last = line, time.monotonic()
        time.sleep(0.05)
    if job.state == "stopped":
        raise Stopped(job.message)
    if job.state == "failed":
        raise InputError(job.message) if job.code == 2 else RuntimeError(f"{job.message}; see {job.log}")
    if not (run / "colors.npy").is_file():
        raise RuntimeError(f"the trainer ended and left no colours in {run}; see {job.log}")
    say(job.message)


def say(text: str) -> None:
    """Write one line on standard output, at once."""
    if sys.stdout is not None:  # it was closed before Python began
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()


def run(arguments: list[str]) -> int:
    """`main` with its outcome as an exit code."""
    try:
        if not hasattr(bpy.types.Object, "cloak"):  # what a .blend file keeps of ours is read only then
            properties.register()
        main(arguments)
    except (InputError, Stopped) as error:
        sys.stderr.write(f"cloak: {error}\n")
        return 2 if isinstance(error, InputError) else 3
    except BrokenPipeError:
        return 1  # nobody reads what it says
    except Exception:
        traceback.print_exc()
        return 1
    return 0
