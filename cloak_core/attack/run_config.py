"""The record of what a run was started with."""

import platform
from collections.abc import Mapping, Sequence

import numpy as np
import torch

from cloak_core import __version__
from cloak_core.attack.held_out import TrainingData
from cloak_core.attack.settings import TrainSettings, settings_record
from cloak_core.detectors.protocol import Detector
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.versions import FORMAT_VERSION
from cloak_core.files.identity import sha256_arrays
from cloak_core.scene.backdrops.backgrounds import Backgrounds
from cloak_core.scene.logos.logo import Logo


def run_config(
    settings: TrainSettings,
    bodies: Bodies,
    logo: Logo,
    detectors: Sequence[Detector],
    states: Sequence[str],
    backgrounds: Backgrounds,
    inputs: Mapping[str, str],
    processes: int = 1,
    palette: np.ndarray | None = None,
    held_out: TrainingData | None = None,
    start: np.ndarray | None = None,
) -> dict:
    """config.json: what decides the result (settings, scene, logo, detectors and so on), and where it ran."""
    return {
        "format": "cloak run",
        "version": FORMAT_VERSION,
        "cloak": __version__,
        "topology": bodies.topology,
        "settings": settings_record(settings),
        "scene": {
            "name": bodies.name,
            "poses": list(bodies.names),
            "outfits": bodies.outfit_count,
            "faces": bodies.face_count,
            "sha256": sha256_arrays(bodies.vertices, bodies.triangles, bodies.face_colors, *bodies.textures.values()),
            "pose_sha256": [sha256_arrays(vertices) for vertices in bodies.vertices],
        },
        "logo": {"faces": len(logo.face_ids), "sha256": sha256_arrays(logo.face_ids)},
        "detectors": [
            {
                "spec": detector.spec,
                "name": detector.name,
                "sha256": state,
                "precision": detector.precision,
                "compiled": detector.compiled,
            }
            for detector, state in zip(detectors, states, strict=True)
        ],
        "backgrounds": {"count": len(backgrounds), "identities": backgrounds.identities()},
        "palette": None if palette is None else {"colors": len(palette), "sha256": sha256_arrays(palette)},
        "start": None if start is None else {"sha256": sha256_arrays(start)},
        "held_out": held_out
        and {"poses": list(held_out.bodies.names), "backgrounds": held_out.backgrounds.identities()},
        "inputs": dict(inputs),
        "environment": {
            "python": platform.python_version(),
            "torch": torch.__version__,
            "numpy": np.__version__,
            "platform": platform.platform(),
            "processes": processes,
            "threads": torch.get_num_threads(),
            "device": torch.cuda.get_device_name(settings.device) if settings.device.startswith("cuda") else "cpu",
        },
    }
