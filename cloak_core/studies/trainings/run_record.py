"""The record of what a run was started with: config.json."""

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from cloak_core import __version__
from cloak_core.core.detector.protocol import Detector, detector_record
from cloak_core.core.logo import Logo
from cloak_core.core.run_config import FILES
from cloak_core.core.settings import TrainSettings, settings_record
from cloak_core.core.source import NOBODY, Cast
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.checks import FORMAT_VERSION
from cloak_core.files.identity import TRAINING, code_hash, sha256_arrays
from cloak_core.files.likeness import pose_shape, pose_spread
from cloak_core.sources.backdrops.backgrounds import Backgrounds


@dataclass(frozen=True, eq=False)
class Training:
    """Everything that a training is made of."""

    settings: TrainSettings
    bodies: Bodies
    logo: Logo
    detectors: Sequence[Detector]
    backgrounds: Backgrounds
    people: Cast = NOBODY
    """Who is shown beside the bodies."""
    query_prior: Sequence[Detector] = ()
    """Detectors whose gradients lead a search by questions."""
    techniques: Sequence[str] = ()
    """Of other packages, NAME or NAME:TEXT (`core.technique`)."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """Names under which the user gave all this, for the record."""


def run_config(training: Training, processes: int = 1, files: Mapping[str, object] | None = None) -> dict:
    """Make config.json: what decides the result (settings, scene, logo, detectors and so on), and where it ran.

    files: content of the files that settings name (`run_config.FILES`).
    """
    settings, logo = training.settings, training.logo
    return {
        "format": "cloak run",
        "version": FORMAT_VERSION,
        "cloak": __version__,
        "code": code_hash(*TRAINING),
        "topology": training.bodies.topology,
        "settings": settings_record(settings),
        "scene": _scene(training.bodies),
        "cover": logo.name,
        "logo": {"faces": len(logo.face_ids), "sha256": sha256_arrays(logo.face_ids)},
        "detectors": [_detector(detector) for detector in training.detectors],
        "backgrounds": _backgrounds(training.backgrounds),
        "people": training.people.record(),
        **(dict.fromkeys(FILES.values()) | dict(files or {})),
        "query_prior": [_detector(detector) for detector in training.query_prior] or None,
        "inputs": dict(training.inputs),
        "environment": environment() | {"processes": processes, "device": device_kind(settings.compute.device)},
    }


def scene_counts(bodies: Bodies) -> dict:
    """Describe a scene for people: its name and its size."""
    return {
        "name": bodies.name,
        "poses": list(bodies.names),
        "outfits": bodies.outfit_count,
        "faces": bodies.face_count,
    }


def _scene(bodies: Bodies) -> dict:
    return scene_counts(bodies) | {
        "identity": bodies.identity,
        # As versions before "identity" recorded and compare it.
        "sha256": sha256_arrays(bodies.vertices, bodies.triangles, bodies.face_colors, *bodies.textures.values()),
        "pose_sha256": list(bodies.pose_hashes),
        "pose_shapes": [pose_shape(vertices) for vertices in bodies.vertices],
        "pose_spreads": [pose_spread(vertices) for vertices in bodies.vertices],
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
