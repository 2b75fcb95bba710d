"""Read a run that training left: its record and curves, what was kept back from it, what it was trained against."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cloak_core.core.detector.protocol import Detector, detector_record
from cloak_core.core.events import read_events
from cloak_core.core.run_config import read_config
from cloak_core.detectors.families import FAMILIES
from cloak_core.detectors.naming import BY_SUFFIX, behind_defences, missing_file
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.likeness import (
    parts_are_told,
    pose_shape,
    pose_spread,
    same_spreads,
    similar_looks,
    similar_poses,
)
from cloak_core.files.reading import is_number
from cloak_core.files.specs import require_named, split_selection
from cloak_core.sources.backdrops.backgrounds import Backgrounds, Picture

EMBEDDED = ("sample", "sample-clothed", "sample-tight", "procedural")
KEPT_BACK = {"scene": ":unseen", "backgrounds": ":test"}
"""What was kept back from training on embedded material."""


def read_run(folder: Path) -> dict:
    """Read a run's config.json; InputError when this is no finished run."""
    if not folder.is_dir():
        if folder.suffix.lower() in BY_SUFFIX:
            raise InputError(f"{folder}: a detector, not a run folder: name the run, and --detector {folder}")
        raise InputError(f"{folder}: {'a file, not a run folder' if folder.exists() else 'no such folder'}")
    if not (folder / "config.json").exists():
        raise InputError(f"{folder}: not a run folder (no config.json in it)")
    if not (folder / "colors.npy").exists():
        raise InputError(f"{folder}: has no trained colours yet (no colors.npy in it)")
    config = read_config(folder)
    inputs, detectors = config.get("inputs", {}), config.get("detectors")
    if not isinstance(inputs, dict) or not all(isinstance(value, str) for value in inputs.values()):
        raise InputError(f"{folder / 'config.json'}: inputs is not a record of names")
    if not isinstance(detectors, list) or not all(
        isinstance(d, dict) and isinstance(d.get("spec"), str) for d in detectors
    ):
        raise InputError(f"{folder / 'config.json'}: detectors is not a list of records, each with its spec")
    return config


def trained_specs(folder: Path, config: dict) -> list[str]:
    """List the detectors that a run was trained against.

    InputError: one runs code, asks the network, or its file is not here; the caller has to name it.
    """
    specs = [record["spec"] for record in config["detectors"]]
    require_named(specs, folder)
    for spec in specs:
        if behind_defences(spec).family not in FAMILIES:
            raise InputError(f"{folder}: trained against {spec}, an object of a program: give it again (detectors=...)")
        if (file := missing_file(spec)) is not None:
            raise InputError(
                f"{folder}: trained against {spec}, and {file} is not here: name your copy of it, --detector SPEC"
            )
    return specs


def kept_back(kind: str, config: dict) -> str:
    """Name the embedded material that training did not see; InputError for anything else, which the user must name."""
    inputs = config.get("inputs", {})
    made_from = inputs.get("made_from", "") if kind == "scene" else ""
    spec, _ = split_selection(made_from or inputs.get(kind, ""))
    head, mark, rest = spec.partition(":train")
    if mark and head in EMBEDDED:
        return head + KEPT_BACK[kind] + rest
    if kind == "scene" and not spec and "people" in inputs:
        raise InputError(
            "trained on people in photographs: name others, --people FILE, or bodies, --scene sample:unseen"
        )
    raise InputError(f"--{kind}: say what to evaluate on (training saw {spec or 'something unrecorded'})")


CURVES = {"loss": "loss", "disappearance": "disappearance", "tv": "total variation"}
"""Which losses of events.jsonl a history has, and what they are called."""


@dataclass(frozen=True)
class History:
    """Curves of (step, value), and how the training ended."""

    losses: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    success: list[tuple[float, float]] = field(default_factory=list)
    step: int = 0
    seconds: float = 0.0
    outcome: str = ""


def read_history(run: Path) -> History:
    """Read losses and success over the steps; empty where the run has no events."""
    path = run / "events.jsonl"
    events = read_events(path) if path.exists() else []
    steps = [e for e in events if e.get("type") == "step" and is_number(e.get("step"))]
    losses = {label: points for key, label in CURVES.items() if (points := _points(steps, key))}
    ends = [e for e in events if e.get("type") == "end"]
    return History(
        losses=losses,
        success=_points(steps, "success"),
        step=int(max((e["step"] for e in steps), default=0)),
        seconds=float(max((e["time"] for e in events if is_number(e.get("time"))), default=0.0)),
        outcome=str(ends[-1].get("outcome", "")) if ends else "",
    )


def _points(steps: list[dict], key: str) -> list[tuple[float, float]]:
    return [(float(e["step"]), float(e[key])) for e in steps if is_number(e.get(key))]


def seen_in_training(config: dict | None, bodies: Bodies, backgrounds: Backgrounds) -> tuple[dict, list[str]]:
    """Compare an evaluation's bodies and backgrounds with those of the training.

    config: a run's config.json. Returns the summary's `unseen` ({"bodies": bool or None, "backgrounds": bool or None})
    and one warning per overlap. Trained poses count as seen also where they are moved as a whole, and images however
    they are stored. None: not certain, because backgrounds look like trained ones or `config` does not tell.
    """
    if not config:
        return {"bodies": None, "backgrounds": None}, []
    unseen_bodies, warnings = _unseen_bodies(_part(config, "scene"), bodies, config.get("topology"))
    shown = dict(zip(backgrounds.names, backgrounds.pictures, strict=True))
    trained = _part(config, "backgrounds")
    unseen_backgrounds, more = _unseen_pictures("backgrounds", trained, "identities", "names", shown)
    return {"bodies": unseen_bodies, "backgrounds": unseen_backgrounds}, warnings + more


def photographs_seen_in_training(config: dict | None, shown: Mapping[str, Picture]) -> tuple[dict, list[str]]:
    """Compare photographs, by their names, with those of the training: {"photographs": unseen or not}, and warnings.

    As `seen_in_training` compares backgrounds: by content, whatever the photographs are called. None also where the run
    recorded names alone, as earlier versions did.
    """
    if not config:
        return {"photographs": None}, []
    if config.get("people") is None:  # training saw nobody in photographs
        return {"photographs": True}, []
    unseen, warnings = _unseen_pictures("photographs", _part(config, "people"), "pixels", "photographs", shown)
    return {"photographs": unseen}, warnings


def _unseen_bodies(scene: dict, bodies: Bodies, topology: object) -> tuple[bool | None, list[str]]:
    trained = scene.get("pose_sha256")
    if not isinstance(trained, list):
        return None, ["the run does not record its training bodies: whether these are unseen is not known"]
    known = set(map(str, trained))
    seen = [i for i, digest in enumerate(bodies.pose_hashes) if digest in known]
    warnings = _overlap("bodies were in the training set", [bodies.names[i] for i in seen])
    for key, measure, find_pairs, words in (
        ("pose_shapes", pose_shape, similar_poses, "moved, scaled or changed by millimetres"),
        ("pose_spreads", pose_spread, same_spreads, "their vertices in another order"),
    ):
        shown = [measure(vertices) for vertices in bodies.vertices]
        pairs = find_pairs([_numbers(value, len(shown[0])) for value in _list(scene, key)], shown)
        alike = {j: i for i, j in pairs if j not in seen}
        names = [f"{bodies.names[j]} is {_name(scene, 'poses', i)}" for j, i in alike.items()]
        warnings += _overlap(f"bodies are trained ones, {words}", names)
        seen += alike
    if seen:
        return False, warnings
    # Without polygons the topology is what a file calls it, and says nothing of the vertices' order.
    is_known = bodies.loop_total is not None or len(_list(scene, "pose_spreads")) == len(trained)
    if is_known and bodies.topology == topology:
        return True, warnings
    return None, [*warnings, "bodies may have their vertices in another order: whether these are unseen is not known"]


def _unseen_pictures(
    what: str, trained: dict, identities: str, names: str, shown: Mapping[str, Picture]
) -> tuple[bool | None, list[str]]:
    """Compare pictures, by their names, with those that a record of training lists under these keys."""
    if not isinstance(trained.get(identities), list):
        return None, [f"the run does not record its training {what}: whether these are unseen is not known"]
    known = set(map(str, trained[identities])) - {""}
    # Earlier versions knew an image by its file.
    seen = {name for name, picture in shown.items() if known & {picture.pixels, picture.file}}
    warnings = _overlap(f"{what} were in the training set", [name for name in shown if name in seen])
    others = [name for name in shown if name not in seen]
    looks = [str(look) for look in _list(trained, "looks")], [shown[name].look for name in others]
    pairs = similar_looks(*looks)
    alike = [f"{others[j]} like {_name(trained, names, i)}" for j, i in {j: i for i, j in pairs}.items()]
    warnings += _overlap(f"{what} look like trained ones", alike, "may not be unseen")
    if not (seen or alike) and not parts_are_told(*looks):
        alike = [f"whether {what} are parts of trained ones is not known: no copies are recorded, or too many"]
        warnings += alike
    return False if seen else None if alike else True, warnings


def _overlap(what: str, names: Sequence[str], verdict: str = "is not unseen") -> list[str]:
    few = ", ".join(names[:3]) + (" ..." if len(names) > 3 else "")
    return [f"{len(names)} of the {what} ({few}): success {verdict}"] if names else []


def trained_against(config: dict | None, detectors: Mapping[str, Detector]) -> dict[str, bool | None]:
    """Tell for each detector, by its spec, whether the colours were trained against it. None: `config` does not tell.

    Content counts, not names: the same weights at another input size are no black box. A detector without weights is
    known by the source that runs it, at any input size and under any name of its file.
    """
    trained = (config or {}).get("detectors")
    if not isinstance(trained, list) or not all(isinstance(entry, dict) for entry in trained):
        return dict.fromkeys(detectors)
    answers: dict[str, bool | None] = {}
    for spec, detector in detectors.items():
        ours = detector_record(detector)
        sources = [entry.get("source", ours["source"]) for entry in trained if entry.get("sha256") == ours["sha256"]]
        if detector.state_dict() or _code(ours["source"]) in map(_code, sources):
            answers[spec] = bool(sources)
        else:
            # The same code with other values, or with values that nobody knows, may be the same detector.
            own = ours["source"].get("code")
            alike = [source for source in sources if own and isinstance(source, dict) and source.get("code") == own]
            answers[spec] = None if alike else False
    return answers


def _code(source: object) -> object:
    """Select of a detector's source what it computes, without how images are brought to its size."""
    if not isinstance(source, dict) or "file" not in source:
        return source
    return {key: source[key] for key in ("file", "function", "data") if key in source}


def _part(config: dict, key: str) -> dict:
    part = config.get(key)
    return part if isinstance(part, dict) else {}


def _list(part: dict, key: str) -> list:
    value = part.get(key)
    return value if isinstance(value, list) else []


def _name(part: dict, key: str, index: int) -> str:
    return str((_list(part, key)[index : index + 1] or [index])[0])


def _numbers(value: object, count: int) -> Sequence[float]:
    """Check a list of numbers; nans, which equal nothing, where it is something else."""
    fits = isinstance(value, list) and len(value) == count and all(isinstance(n, (int, float)) for n in value)
    return value if fits else [np.nan] * count
