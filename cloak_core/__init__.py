"""Cloak: adversarial face colours for human meshes, trained against person detectors.

The names below are the library's interface; docs/howto/library.md tells how they go together. Each is imported when
it is first asked for, so that importing this package imports neither torch nor numpy.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cloak_core.core.detector.protocol import Detections, Detector
    from cloak_core.core.evaluation.settings import EvaluateSettings, FilmSettings
    from cloak_core.core.logo import Logo, load_logo, make_logo
    from cloak_core.core.loop import RunResult
    from cloak_core.core.settings import TrainSettings, make_settings
    from cloak_core.detectors.loading import load_detector
    from cloak_core.exchange.bodies import Bodies
    from cloak_core.files.errors import InputError
    from cloak_core.library import evaluate, film, train, wear
    from cloak_core.products.printing import print_logo
    from cloak_core.products.run_report import make_report
    from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
    from cloak_core.sources.bodies.opening import load_scene
    from cloak_core.sources.photographs.people import People, load_people

__version__ = "1.0.0"
__all__ = [
    "Backgrounds",
    "Bodies",
    "Detections",
    "Detector",
    "EvaluateSettings",
    "FilmSettings",
    "InputError",
    "Logo",
    "People",
    "RunResult",
    "TrainSettings",
    "evaluate",
    "film",
    "load_backgrounds",
    "load_detector",
    "load_logo",
    "load_people",
    "load_scene",
    "make_logo",
    "make_report",
    "make_settings",
    "print_logo",
    "train",
    "wear",
]

_PLACES = {
    "Backgrounds": "scene.backdrops.backgrounds:Backgrounds",
    "Bodies": "exchange.bodies:Bodies",
    "Detections": "detectors.protocol:Detections",
    "Detector": "detectors.protocol:Detector",
    "EvaluateSettings": "evaluation.settings:EvaluateSettings",
    "FilmSettings": "evaluation.settings:FilmSettings",
    "InputError": "files.errors:InputError",
    "Logo": "scene.logos.logo:Logo",
    "People": "scene.photographs.people:People",
    "RunResult": "attack.loop:RunResult",
    "TrainSettings": "attack.settings:TrainSettings",
    "evaluate": "library:evaluate",
    "film": "library:film",
    "load_backgrounds": "scene.backdrops.backgrounds:load_backgrounds",
    "load_detector": "detectors.loading:load_detector",
    "load_logo": "scene.logos.logo:load_logo",
    "load_people": "scene.photographs.people:load_people",
    "load_scene": "scene.opening:load_scene",
    "make_logo": "scene.logos.logo:make_logo",
    "make_report": "evaluation.report.run_report:make_report",
    "make_settings": "attack.settings:make_settings",
    "print_logo": "output.printing:print_logo",
    "train": "library:train",
    "wear": "library:wear",
}
"""Public name -> MODULE:NAME."""


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, attribute = _PLACES[name].partition(":")
    found = globals()[name] = getattr(import_module(f"{__name__}.{module}"), attribute)
    return found


def __dir__() -> list[str]:
    return sorted([*globals(), *_PLACES])
