"""Evaluate an entry of the zoo again, on the bodies, backgrounds, angles, draws and detectors of its record."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from pathlib import Path

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluate import headline
from cloak_core.core.evaluation.measure import OnProgress
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.logo import make_logo
from cloak_core.detectors.loading import load_detector
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.specs import require_named, without_folders
from cloak_core.patterns.faces import FacePattern
from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.studies.evaluate import OnBodies, evaluate
from cloak_core.studies.trained_run import EMBEDDED, kept_back
from cloak_core.zoo.entry import Entry

_FILE = re.compile(r"[\w.-]+\.(?:onnx|cfg|weights|pt|py)\b")
"""A file in a detector's spec, which records keep without its folder."""


@dataclass(frozen=True)
class Files:
    """Places on this machine of files that do not ship."""

    folder: Path | None = None
    """Detectors and scenes, by their names, at any depth."""
    backgrounds: Path | None = None
    """A folder of photographs; those that training saw are left out by their content."""
    detectors: tuple[str, ...] = ()
    """Specs that stand for the recorded ones of the same file names; only these may run code."""

    def find(self, name: str, whose: str) -> Path:
        """Find a file by its name; InputError where it is not there."""
        places = sorted(self.folder.rglob(name)) if self.folder else []
        if not places:
            where = f"is not in {self.folder}" if self.folder else "does not ship: say where it lies (--files)"
            raise InputError(f"{name}, which {whose} was judged with, {where}")
        return places[0]


def evaluate_again(
    entry: Entry, files: Files, most_images: int | None, device: str, on_progress: OnProgress | None
) -> dict:
    """Evaluate an entry as recorded and compare.

    Returns by detector `recorded` and `again`, each with success, success_own, ci95, ci95_own, n; and whether it
    `holds`: at both thresholds the new rate lies in the recorded 95 % interval, or the recorded rate in the new one.
    The images are those of the record, unless `most_images` takes a part of them. Colours are the entry's, which were
    rounded to 1/255 after the record was written. InputError: a file or folder that it needs is not there.
    """
    name, recorded = entry.record["name"], entry.record["evaluation"]
    whose = f"zoo:{name}"
    bodies, backgrounds = _bodies(entry, files, whose), _backgrounds(entry, files, whose)
    if len(backgrounds) != recorded["inputs"]["backgrounds"]:
        raise InputError(
            f"{files.backgrounds}: {len(backgrounds)} backgrounds that {whose} was not trained on, "
            f"its record has {recorded['inputs']['backgrounds']}"
        )
    detectors = {spec: _detector(spec, files, whose, device) for spec in recorded["detectors"]}
    pattern = FacePattern(make_logo(bodies, entry.ids), bodies, entry.colors)
    settings = _settings(recorded["settings"], most_images)
    shown = OnBodies(bodies, backgrounds, recorded["settings"]["angles"]).show(
        pattern, detectors, settings, entry.config
    )
    measured = evaluate(shown, detectors, settings, on_progress=on_progress)
    pairs = {spec: (recorded["detectors"][spec]["logo"], measured["detectors"][spec]["logo"]) for spec in detectors}
    return {
        spec: {"recorded": headline(old), "again": headline(new), "holds": _holds(old, new)}
        for spec, (old, new) in pairs.items()
    }


def _bodies(entry: Entry, files: Files, whose: str) -> Bodies:
    inputs = entry.record["evaluation"]["inputs"]
    shipped = entry.config["inputs"].get("scene", "").partition(":")[0] in EMBEDDED
    scene = kept_back("scene", entry.config) if shipped else str(files.find(f"{inputs['scene']}.npz", whose))
    bodies = load_scene(scene)
    if bodies.topology != entry.config["topology"]:
        raise InputError(f"{scene}: topology {bodies.topology}, {whose} is for {entry.config['topology']}")
    if absent := set(inputs["bodies"]) - set(bodies.names):
        raise InputError(f"{scene}: no body {min(absent)}, which {whose} was judged on")
    return bodies.select_poses([bodies.names.index(body) for body in inputs["bodies"]])


def _backgrounds(entry: Entry, files: Files, whose: str) -> Backgrounds:
    if entry.config["inputs"].get("backgrounds", "").startswith("procedural"):
        return load_backgrounds(kept_back("backgrounds", entry.config))
    if files.backgrounds is None:
        raise InputError(
            f"the photographs that {whose} was judged before do not ship: say where they lie (--backgrounds)"
        )
    every, trained = load_backgrounds(files.backgrounds), set(entry.config["backgrounds"]["identities"])
    return every.subset([i for i, identity in enumerate(every.identities()) if identity not in trained])


def _detector(spec: str, files: Files, whose: str, device: str) -> Detector:
    """Load a recorded detector, or the one that the caller names in its place."""
    named = next((ours for ours in files.detectors if without_folders(ours) == spec), None)
    if named is None:
        require_named([spec], whose)
        named = _FILE.sub(lambda name: str(files.find(name[0], whose)), spec)
    return load_detector(named, device=device)


def _settings(recorded: dict, most_images: int | None) -> EvaluateSettings:
    known = {field.name for field in fields(EvaluateSettings)}
    kept = {key: tuple(value) if isinstance(value, list) else value for key, value in recorded.items() if key in known}
    # What is compared is the logo; controls and bare backgrounds would only take time.
    kept |= {"controls": ("clothing",), "bare": 1, "most_images": most_images or recorded["most_images"]}
    return EvaluateSettings(**kept)


def _holds(old: dict, new: dict) -> bool:
    """Check that each of the two rates lies in its recorded interval, or the recorded rate in the new one."""
    for rate, interval in (("success", "ci95"), ("success_own", "ci95_own")):
        if old.get(rate) is None or new.get(rate) is None or not old.get(interval):
            continue
        # Records have six decimals.
        within = lambda value, bounds: bounds[0] - 1e-6 <= value <= bounds[1] + 1e-6
        if not (within(new[rate], old[interval]) or within(old[rate], new[interval])):
            return False
    return True
