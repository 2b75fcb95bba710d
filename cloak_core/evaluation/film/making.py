"""A film from beginning to end: the path, the footage, the numbers, the file."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from cloak_core.detectors.protocol import Detector, state_hash
from cloak_core.evaluation.evaluate import check_inputs
from cloak_core.evaluation.film.camera_path import camera_path
from cloak_core.evaluation.film.counting import frame_rows, summarize
from cloak_core.evaluation.film.drawing import Drawing
from cloak_core.evaluation.film.settings import FilmSettings
from cloak_core.evaluation.film.shooting import make_stage, shoot_film
from cloak_core.evaluation.inference import OnProgress
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.writing import write_json
from cloak_core.scene.backdrops.backgrounds import Backgrounds
from cloak_core.scene.logos.logo import Logo
from cloak_core.scene.videos import check_film, save_film


def make_film(
    colors: Float32[np.ndarray, "L 3"],
    logo: Logo,
    bodies: Bodies,
    backgrounds: Backgrounds,
    detectors: dict[str, Detector],
    out: Path,
    settings: FilmSettings | None = None,
    on_progress: OnProgress | None = None,
) -> dict:
    """Film the bodies' poses in their order, cloaked and in own clothing; write `out` and its numbers beside it.

    out: NAME.mp4, NAME.gif, or a folder of PNGs; NAME.json (or film.json in the folder) takes the figures of every
    frame. Returns contract C7's figures (see `counting.summarize`) with `out` and `numbers`, where those are.
    InputError: as for `evaluate`, and what `camera_path` and `save_film` refuse.
    """
    settings = settings or FilmSettings()
    kind = check_film(out)
    check_inputs(colors, logo, bodies, backgrounds, detectors, settings.angles)
    path = camera_path(settings, bodies.pose_count)
    device = next(iter(detectors.values())).device
    stage = make_stage(colors, logo, bodies, backgrounds, path, settings, device)
    hashes = {spec: state_hash(detector) for spec, detector in detectors.items()}
    footage = shoot_film(stage, path, detectors, settings, on_progress)
    for spec, detector in detectors.items():
        detector.verify(hashes[spec])
    told = summarize(footage, path, settings) | {"out": str(out)}
    save_film(out, Drawing(stage, footage, settings).frames(), settings.fps)
    numbers = out / "film.json" if kind == "folder" else out.with_suffix(".json")
    inputs = {"scene": bodies.name, "topology": bodies.topology, "detector_hashes": hashes}
    plain = asdict(settings) | {"angles": list(settings.angles)}
    rows = frame_rows(footage, bodies, settings)
    write_json(numbers, told | {"settings": plain, "inputs": inputs, "by_frame": rows})
    return told | {"numbers": str(numbers)}
