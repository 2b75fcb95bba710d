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
    from cloak_core.core.settings import TrainSettings, make_settings
    from cloak_core.core.training import RunResult
    from cloak_core.detectors.loading import as_detector, load_detector
    from cloak_core.detectors.maite import SuccessMetric
    from cloak_core.exchange.bodies import Bodies
    from cloak_core.files.errors import InputError
    from cloak_core.library.evaluation import evaluate
    from cloak_core.library.filming import film
    from cloak_core.library.training import train
    from cloak_core.library.wearing import wear
    from cloak_core.products.printing import print_logo
    from cloak_core.products.run_report import make_report
    from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
    from cloak_core.sources.bodies.opening import load_scene
    from cloak_core.sources.photographs.people import People, load_people

__version__ = "2.0.0"
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
    "SuccessMetric",
    "TrainSettings",
    "as_detector",
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
    "Backgrounds": "sources.backdrops.backgrounds:Backgrounds",
    "Bodies": "exchange.bodies:Bodies",
    "Detections": "core.detector.protocol:Detections",
    "Detector": "core.detector.protocol:Detector",
    "EvaluateSettings": "core.evaluation.settings:EvaluateSettings",
    "FilmSettings": "core.evaluation.settings:FilmSettings",
    "InputError": "files.errors:InputError",
    "Logo": "core.logo:Logo",
    "People": "sources.photographs.people:People",
    "RunResult": "core.training:RunResult",
    "SuccessMetric": "detectors.maite:SuccessMetric",
    "TrainSettings": "core.settings:TrainSettings",
    "as_detector": "detectors.loading:as_detector",
    "evaluate": "library.evaluation:evaluate",
    "film": "library.filming:film",
    "load_backgrounds": "sources.backdrops.backgrounds:load_backgrounds",
    "load_detector": "detectors.loading:load_detector",
    "load_logo": "core.logo:load_logo",
    "load_people": "sources.photographs.people:load_people",
    "load_scene": "sources.bodies.opening:load_scene",
    "make_logo": "core.logo:make_logo",
    "make_report": "products.run_report:make_report",
    "make_settings": "core.settings:make_settings",
    "print_logo": "products.printing:print_logo",
    "train": "library.training:train",
    "wear": "library.wearing:wear",
}
"""Public name -> MODULE:NAME."""


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, attribute = _PLACES[name].partition(":")
    attribute_value = globals()[name] = getattr(import_module(f"{__name__}.{module}"), attribute)
    return attribute_value


def __dir__() -> list[str]:
    return sorted([*globals(), *_PLACES])
