"""The report's turntable: one evaluated body, seen from all around, in own clothing and cloaked."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cloak_core.detectors.protocol import Detector
from cloak_core.evaluation.film.camera_path import camera_path
from cloak_core.evaluation.film.drawing import Drawing
from cloak_core.evaluation.film.settings import FilmSettings
from cloak_core.evaluation.film.shooting import make_stage, shoot_film
from cloak_core.evaluation.stage import Stage
from cloak_core.scene.videos import save_gif

FRAMES, LEAST = 24, 8
SHARE = 8
"""At most one image for so many of the evaluation's own."""
SIDE = 256
"""Width and height of each of the two pictures, pixels, at most."""
FPS = 8.0


def write_turntable(
    path: Path, stage: Stage, trial: int, detectors: dict[str, Detector], threshold: float, controls: int
) -> bool:
    """Write a GIF of the body, outfit and background of a trial; whether there is one: a small evaluation would spend
    more on it than on itself, and has none. Its clothing and its cloak are watched by every detector."""
    frames = min(FRAMES, len(stage.trials) * controls // (2 * SHARE))
    if frames < LEAST:
        return False
    view = stage.viewpoint
    asked = FilmSettings(
        camera="orbit",
        elevation=float(view.elevation),
        distance=float(stage.trials.distance[trial]),
        field_of_view=float(view.field_of_view),
        size=min(SIDE, view.width),
        fps=FPS,
        seconds=frames / FPS,
        outfit=int(stage.trials.outfit[trial]),
        threshold=threshold,
    )
    bodies = stage.bodies.select_poses(np.array([stage.trials.pose[trial]]))
    backdrop = stage.backdrops.subset([int(stage.trials.background[trial])])
    way = camera_path(asked, 1)
    turning = make_stage(stage.colors, stage.logo, bodies, backdrop, way, asked, stage.bank.device)
    footage = shoot_film(turning, way, detectors, asked)
    save_gif(path, list(Drawing(turning, footage, asked).frames()), FPS)
    return True
