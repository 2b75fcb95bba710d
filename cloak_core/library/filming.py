"""Film a run's colours in motion in one call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cloak_core.core.evaluation.measure import OnProgress
from cloak_core.core.evaluation.settings import FilmSettings
from cloak_core.core.surroundings import plain_torch
from cloak_core.detectors.loading import Given
from cloak_core.exchange.bodies import Bodies
from cloak_core.library.values import Named, by_name, open_backgrounds, open_bodies
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.studies.film import make_film
from cloak_core.studies.opening import find_run, open_run
from cloak_core.studies.trained_run import kept_back, trained_specs

if TYPE_CHECKING:
    from cloak_core.core.training import RunResult


@plain_torch()
def film(
    run: RunResult | Named,
    out: Named,
    scene: Bodies | Named | None = None,
    backgrounds: Backgrounds | Named | None = None,
    detectors: Mapping[str, Given] | Given | Sequence[Given] | None = None,
    *,
    colors: Named | None = None,
    logo: Named | None = None,
    settings: FilmSettings | None = None,
    device: str = "cpu",
    on_progress: OnProgress | None = None,
) -> dict:
    """Film a run's colours in motion beside the body's own clothing: NAME.mp4, NAME.gif, or a folder of PNGs.

    The scene's poses in their order are the motion; all else is as in `evaluate`. Returns what `cloak film --json`
    prints: frames hidden, the longest visible run, first sight, tracks; per detector for colours and clothing.
    InputError: as in `evaluate`; another kind of film, no PyAV for a .mp4.
    """
    folder, config = find_run(run)
    bodies = open_bodies(scene or kept_back("scene", config))
    pattern, _, _ = open_run(folder, config, colors, bodies, logo)
    behind = open_backgrounds(backgrounds or kept_back("backgrounds", config))
    judges = by_name(trained_specs(folder, config) if detectors is None else detectors, device)
    return make_film(pattern, bodies, behind, judges, Path(out), settings, on_progress)
