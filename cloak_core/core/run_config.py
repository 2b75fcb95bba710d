"""The record of what a run was started with, and whether a training is the one that was recorded."""

import platform
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch

from cloak_core import __version__
from cloak_core.core.detector.protocol import Detector, detector_record
from cloak_core.core.held_out import TrainingData
from cloak_core.core.logo import Logo
from cloak_core.core.settings import TrainSettings, settings_from_record, settings_record
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.profiles import Profile
from cloak_core.exchange.versions import FORMAT_VERSION
from cloak_core.files.errors import InputError
from cloak_core.files.identity import TRAINING, code_hash, sha256_arrays, sha256_record
from cloak_core.files.likeness import pose_shape
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.photographs.fitting import Fit

FREE_SETTINGS = (
    "checkpoint_every",
    "preview_every",
    "snapshot_every",
    "max_seconds",
    "palette",
    "init",
    "profile",
    "near",
)
"""What a resumed run may change: nothing of it reaches the colours (of files, it is the content that counts)."""
DECISIVE = {
    "topology": (),
    "settings": (),
    "scene": ("sha256", "identity"),
    "logo": (),
    "detectors": ("sha256", "precision", "compiled", "source", "operating_point"),
    "backgrounds": ("identities",),
    "people": ("sha256",),
    "palette": (),
    "profile": (),
    "start": (),
    "near": (),
    "query_prior": ("sha256", "precision", "compiled", "source"),
}
"""The parts of a configuration that decide the result, and what of a part does (all where nothing is named)."""
AROUND = ("torch", "numpy", "device", "threads", "processes")
"""What of the environment may move the last bits of a result."""


def run_config(
    settings: TrainSettings,
    bodies: Bodies,
    logo: Logo,
    detectors: Sequence[Detector],
    backgrounds: Backgrounds,
    inputs: Mapping[str, str],
    processes: int = 1,
    palette: np.ndarray | None = None,
    held_out: TrainingData | None = None,
    start: np.ndarray | None = None,
    profile: Profile | None = None,
    query_prior: Sequence[Detector] = (),
    people: Sequence[Fit] = (),
    near: np.ndarray | None = None,
) -> dict:
    """Make config.json: what decides the result (settings, scene, logo, detectors and so on), and where it ran."""
    return {
        "format": "cloak run",
        "version": FORMAT_VERSION,
        "cloak": __version__,
        "code": code_hash(*TRAINING),
        "topology": bodies.topology,
        "settings": settings_record(settings),
        "scene": _scene(bodies),
        "logo": {"faces": len(logo.face_ids), "sha256": sha256_arrays(logo.face_ids)},
        "detectors": [_detector(detector) for detector in detectors],
        "backgrounds": _backgrounds(backgrounds),
        "people": _people(people),
        "palette": None if palette is None else {"colors": len(palette), "sha256": sha256_arrays(palette)},
        "profile": None if profile is None else {"sha256": sha256_arrays(profile.table)},
        "start": None if start is None else {"sha256": sha256_arrays(start)},
        "near": None if near is None else {"sha256": sha256_arrays(near)},
        "query_prior": [_detector(detector) for detector in query_prior] or None,
        "held_out": held_out
        and {"poses": list(held_out.bodies.names), "backgrounds": held_out.backgrounds.identities()},
        "inputs": dict(inputs),
        "environment": environment() | {"processes": processes, "device": device_kind(settings.compute.device)},
    }


def _scene(bodies: Bodies) -> dict:
    return {
        "name": bodies.name,
        "poses": list(bodies.names),
        "outfits": bodies.outfit_count,
        "faces": bodies.face_count,
        "identity": bodies.identity,
        # As versions before "identity" recorded and compare it.
        "sha256": sha256_arrays(bodies.vertices, bodies.triangles, bodies.face_colors, *bodies.textures.values()),
        "pose_sha256": list(bodies.pose_hashes),
        "pose_shapes": [pose_shape(vertices) for vertices in bodies.vertices],
    }


def _detector(detector: Detector) -> dict:
    # Not part of the detector's own record: it is the same network, wherever its scores are cut.
    named = {"spec": detector.spec, "name": detector.name, "operating_point": detector.operating_point}
    return named | detector_record(detector)


def _backgrounds(backgrounds: Backgrounds) -> dict:
    return {
        "count": len(backgrounds),
        "names": list(backgrounds.names),
        "identities": backgrounds.identities(),
        "files": [picture.file for picture in backgrounds.pictures],
        "looks": [picture.look for picture in backgrounds.pictures],
    }


def _people(fits: Sequence[Fit]) -> dict | None:
    """Record who was trained on, photographs by name, so that evaluation can tell them from unseen ones."""
    if not fits:
        return None
    licences = {fit.person.photograph: fit.person.licence for fit in fits}
    return {
        "count": len(fits),
        "photographs": list(licences),
        "licences": list(licences.values()),
        "sha256": sha256_record({"fits": [fit.identity for fit in fits]}),
    }


def environment() -> dict:
    """Record versions, the machine's kind, and the threads of torch."""
    return {
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": np.__version__,
        "platform": platform.platform(),
        "threads": torch.get_num_threads(),
    }


def device_kind(device: str | torch.device) -> str:
    """Name a device as far as results depend on it: "cpu", or the model of a GPU."""
    return torch.cuda.get_device_name(device) if torch.device(device).type == "cuda" else torch.device(device).type


# --- is it the same training? ----------------------------------------------------------------------------------------


def check_same(recorded: dict, config: dict, path: Path, parts: Iterable[str] = tuple(DECISIVE)) -> None:
    """Check that `config` is what the run at `path` recorded, in all that decides the result.

    InputError names the first difference.

    What versions before this one did not record is not compared.
    """
    for part in parts:
        keys, old, new = DECISIVE[part], recorded.get(part), config[part]
        if part == "settings" and isinstance(old, dict):
            # What a run of an earlier version had not heard of, it did as the default has it.
            try:
                old = settings_record(settings_from_record(old))
            except InputError as error:
                raise InputError(f"{path / 'config.json'}: {error}") from None
            old, new = ({k: v for k, v in s.items() if k not in FREE_SETTINGS} for s in (old, new))
        if part == "backgrounds" and isinstance(old, dict) and "files" not in old:
            # Earlier versions knew an image by its file alone.
            new = {"identities": [file or own for file, own in zip(new["files"], new["identities"], strict=True)]}
        name, before, now = _difference(part, _only(keys, old), _only(keys, new))
        if name:
            raise InputError(f"{path}: was started with {name} = {before}, not {now}; resume with the same settings")


def changes_around(recorded: dict, config: dict) -> list[str]:
    """List differences from the recorded run that move the last bits of the result at most."""
    found = []
    if recorded.get("code") != config["code"]:
        found.append(f"other code (of Cloak {recorded.get('cloak', 'unknown')})")
    pairs = [(recorded.get("environment"), {name: config["environment"][name] for name in AROUND})]
    old = recorded.get("detectors")
    pairs += [(o.get("packages"), n["packages"]) for o, n in zip(old or [], config["detectors"], strict=True)]
    for before, now in pairs:
        before = before if isinstance(before, dict) else {}
        found += [f"{k} {before[k]} instead of {now[k]}" for k in now if k in before and before[k] != now[k]]
    return list(dict.fromkeys(found))


def _only(keys: Sequence[str], value: object) -> object:
    if isinstance(value, list):
        return [_only(keys, item) for item in value]
    return {k: v for k, v in value.items() if k in keys} if keys and isinstance(value, dict) else value


def _difference(name: str, old: object, new: object) -> tuple[str, object, object]:
    """Name and both values of the first difference; "" as the name where there is none."""
    pairs = []
    if isinstance(old, dict) and isinstance(new, dict):
        pairs = [(f"{name}.{key}", old[key], new.get(key)) for key in sorted(old)]
    elif isinstance(old, list) and isinstance(new, list):
        if len(old) != len(new):
            return f"the number of {name}", len(old), len(new)
        pairs = [(f"{name}[{i}]", *both) for i, both in enumerate(zip(old, new, strict=True))]
    elif old != new:
        return name, old, new
    return next((found for pair in pairs if (found := _difference(*pair))[0]), ("", None, None))
