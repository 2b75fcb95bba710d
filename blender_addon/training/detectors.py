# SPDX-License-Identifier: GPL-3.0-or-later
"""The detectors of a scene: files of any family the trainer reads. Some are trained against, others only judge.

What stands in this list is what every button uses. An empty list is the built-in detector.
"""

import json
from pathlib import Path

import bpy
from bpy.props import CollectionProperty, StringProperty

from ..blender.blend_paths import absolute, blend_folder, portable
from ..files.errors import InputError
from ..trainer.jobs import Job, launch, waits
from ..trainer.program import allow, cloak_command, trainer, user_folder
from ..trainer.progress import finite
from ..ui import props
from ..ui.bases import operator, push_undo

BUILTIN = "builtin"
FAMILIES = {
    ".onnx": "onnx:{file}",
    ".pt": "ultralytics:{file}",
    ".xml": "openvino:{file}",
    ".tflite": "tflite:{file}",
    ".cfg": "darknet:{file}:{weights}",
    ".py": "python:{file}:load",
}
"""How the trainer names a detector by the suffix of its file."""
BLACK_BOXES = (".xml", ".tflite")  # suffixes of files whose runtimes give no gradients
CHECK = "Detector check"


def _changed(self: "CloakDetector", context: bpy.types.Context) -> None:
    """Discard the check of another file or size."""
    self.checked, self.gradients = "", True


def _file_chosen(self: "CloakDetector", context: bpy.types.Context) -> None:
    _changed(self, context)
    if self.file.lower().endswith(".py"):
        allow([FAMILIES[".py"].format(file=absolute(self.file))])


def _spec_typed(self: "CloakDetector", context: bpy.types.Context) -> None:
    _changed(self, context)
    allow([self.spec.strip()])


class CloakDetector(bpy.types.PropertyGroup):
    """One detector of the list."""

    file: props.path(
        "File", "The detector's file: .onnx, .pt, .xml, .tflite, .cfg (with its .weights) or .py", update=_file_chosen
    )
    weights: props.path("Weights", "Of a .cfg: its .weights file", update=_changed)
    spec: props.text(
        "Name",
        "A detector without a file of its own, as the command line names it: builtin, torchvision:NAME",
        update=_spec_typed,
    )
    options: props.text(
        "Options",
        "What the trainer cannot tell from the file: input size (640 or 320x544), person=CLASS, bgr",
        update=_changed,
    )
    threshold: props.number(
        "Reports From",
        "Score from which on this detector reports a person; 0 for its own",
        min=0,
        max=0.999,
        precision=2,
        step=1,
    )
    judges: props.switch(
        "Only Judges", "Training does not see it: it only judges, in Render Check, evaluation and Detector's Eye"
    )
    checked: props.text("Checked", "The detector that the answer is about")
    answer: props.text("Answer", "What the trainer found out about it")
    works: props.switch("Works", "Whether it passed the check")
    gradients: props.switch("Gradients", "Whether it gives gradients to train with", True)

    @property
    def black_box(self) -> bool:
        """Whether it gives no gradients, so that training cannot use it."""
        return not self.gradients or self.file.lower().endswith(BLACK_BOXES)

    @property
    def only_judges(self) -> bool:
        """Whether training leaves it out: by the user's choice, or because it is a black box."""
        return self.judges or self.black_box

    @property
    def title(self) -> str:
        """Name of the file, or of the detector without a file."""
        return Path(self.file.replace("\\", "/")).name if self.file else self.spec or BUILTIN

    @property
    def bare(self) -> str:
        """As the command line names it, without its threshold; `InputError` where a file is missing."""
        words = self.spec.strip() or BUILTIN
        if self.file:
            file = existing(self.file, "Detector > File")
            words = family_of(Path(file))
            weights = existing(self.weights, "Detector > Weights") if "{weights}" in words else ""
            words = words.format(file=file, weights=weights)
        if words.startswith("-"):  # it stands alone in some commands
            raise InputError(f"Detector > Name: {words} is an option, not a detector")
        return f"{words}@{self.options.strip()}" if self.options.strip() else words

    @property
    def full(self) -> str:
        """Detector as the command line names it, with its threshold."""
        joined = "," if self.options.strip() else "@"
        return self.bare + (f"{joined}conf={self.threshold:.3g}" if self.threshold else "")


def family_of(path: Path) -> str:
    """How the trainer names a detector of this file; `InputError` for a file of none."""
    if path.suffix.lower() not in FAMILIES:
        raise InputError(f"{path}: a detector's file ends in {', '.join(FAMILIES)}")
    return FAMILIES[path.suffix.lower()]


def existing(path: str, label: str) -> str:
    """The absolute path of a file that is there; `InputError` names the field otherwise."""
    if not path:
        raise InputError(f"{label} is empty: choose a file")
    place = absolute(path)
    if not Path(place).is_file():
        raise InputError(f"{label}: {place} does not exist")
    return place


def trained_against(settings: bpy.types.PropertyGroup) -> tuple[str, ...]:
    """The detectors to hide from. Raises `InputError` where all others only judge."""
    specs = tuple(detector.full for detector in settings.detectors if not detector.only_judges)
    if settings.detectors and not specs:
        raise InputError("All detectors only judge: let one be trained against, or add one")
    return specs or judges(settings)


def judges(settings: bpy.types.PropertyGroup) -> tuple[str, ...]:
    """List all detectors, those to train against first. Raises `InputError` while a file of version 0.1 has no list."""
    if not settings.detectors and settings.detector:
        raise InputError("This file of version 0.1 names a detector of its own: add it, or the built-in one")
    ordered = sorted(settings.detectors, key=lambda detector: detector.only_judges)
    return tuple(dict.fromkeys(detector.full for detector in ordered)) or (BUILTIN,)


def active_detector(settings: bpy.types.PropertyGroup) -> CloakDetector | None:
    """The one that is chosen in the list."""
    index = settings.detector_index
    return settings.detectors[index] if 0 <= index < len(settings.detectors) else None


def add_file(settings: bpy.types.PropertyGroup, path: Path) -> CloakDetector:
    """A new entry for a file; of Darknet's two files the other is looked for beside it."""
    weights = ""
    if path.suffix.lower() == ".weights":
        path, weights = path.with_suffix(".cfg"), str(path)
        if not path.is_file():
            raise InputError(f"{weights}: its .cfg is not beside it; choose that")
    elif path.suffix.lower() == ".cfg":
        weights = next((str(file) for file in sorted(path.parent.glob(f"{path.stem}*.weights"))), "")
    family_of(path)
    folder, added = blend_folder(), settings.detectors.add()
    added.file, added.weights = portable(str(path), folder), portable(weights, folder)
    settings.detector_index = len(settings.detectors) - 1
    return added


@operator(
    "Add Detector",
    undo=True,
    reads=";*".join((*FAMILIES, ".weights")),
    files=CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"}),
    directory=StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"}),
)
def detector_add(context: bpy.types.Context, filepath: str, directory: str, files: object) -> str:
    """Add a detector by its file: ONNX, ultralytics, OpenVINO, TFLite, Darknet, or Python. It is checked at once"""
    paths = [Path(directory, entry.name) for entry in files if entry.name] or [Path(filepath)]
    for path in paths:
        if not path.is_file():
            raise InputError(f"{path} does not exist")
        check(add_file(context.scene.cloak, path))
    return f"Checking {', '.join(path.name for path in paths)}"


@operator("Add by Name", undo=True, spec=props.text("Name", "As the command line names it", BUILTIN))
def detector_add_named(context: bpy.types.Context, spec: str) -> str:
    """Add a detector that has no file: the built-in one, or another that the command line names"""
    settings = context.scene.cloak
    settings.detectors.add().spec = spec.strip() or BUILTIN
    settings.detector_index = len(settings.detectors) - 1
    check(settings.detectors[-1])
    return f"Checking {spec}"


def detector_reason(context: bpy.types.Context) -> str:
    """Why there is no chosen detector."""
    return "" if active_detector(context.scene.cloak) else "Choose a detector in the list first"


@operator("Remove Detector", detector_reason, undo=True)
def detector_remove(context: bpy.types.Context) -> str:
    """Take the chosen detector out of the list; an empty list is the built-in detector"""
    settings = context.scene.cloak
    title = active_detector(settings).title
    settings.detectors.remove(settings.detector_index)
    settings.detector_index = max(0, settings.detector_index - 1)
    return f"{title} is not used any more"


@operator("Check", detector_reason, trains=True)
def detector_check(context: bpy.types.Context) -> str:
    """Let the trainer load the chosen detector, compare it with its own runtime and say what it reports from"""
    detector = active_detector(context.scene.cloak)
    return f"Checking {detector.title}{check(detector)}"


def check(detector: CloakDetector) -> str:
    """Ask the trainer about a detector; its answer comes into the list. Returns ", after ..." where that waits."""
    spec, folder = detector.bare, user_folder("detectors")
    detector.checked, detector.answer, detector.works = spec, "", False
    # One render is enough to know whether, and from which score on, it works.
    events = folder / "check.jsonl"
    command = cloak_command(trainer(), "detectors", "verify", spec, "--renders", 1, "--events", events)
    job = Job(CHECK, [command], folder, "check", lambda job: _told(job, spec), events)
    job.lane = CHECK  # nothing that trains or judges waits for it
    return waits(launch(job))


def _told(job: Job, spec: str) -> str | None:
    """Write the answer to every entry that it is about."""
    try:
        record = dict(json.loads(job.outputs[-1]))
    except (ValueError, TypeError, IndexError):
        record = {}
    rows = [d for scene in bpy.data.scenes for d in scene.cloak.detectors if d.checked == spec]
    failed = [str(name) for name in record.get("failed", [])]
    point = finite(record.get("operating_point"))
    works = job.state == "done" and not failed
    job.is_bad_news = not works
    if job.state == "stopped" and not failed:  # nothing is known: it can be checked again
        for detector in rows:
            detector.checked = ""
        return None
    if failed:
        job.state = "done"
    answer = f"fails: {', '.join(failed)}" if failed else _describe(record, point) if works else job.message
    for detector in rows:
        detector.answer, detector.works = answer, works
        detector.gradients = not works or record.get("white_box") is not False
        if works and point and not detector.threshold:
            detector.threshold = point
    push_undo("Check Detector")
    return f"{rows[0].title} {answer}" if rows else None


def _describe(record: dict, point: float | None) -> str:
    """What the trainer found out about a detector that works."""
    assumed = " (assumed)" if record.get("operating_point_assumed") is True else ""
    parts = [] if point is None else [f"reports from {point:g}{assumed}"]
    if record.get("person_class") not in (None, 0):
        parts.append(f"person is class {record['person_class']}")
    if (parity := finite(record.get("parity_scores"))) is not None:
        parts.append(f"scores within {parity:.0e} of its own runtime")
    return "works" + (f": {', '.join(parts)}" if parts else "")
