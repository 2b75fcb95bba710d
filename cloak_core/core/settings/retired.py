"""Options of earlier versions: the values that old records may still name, and what replaces each."""

from __future__ import annotations

from dataclasses import dataclass

from cloak_core.core.settings.values import option
from cloak_core.files.errors import InputError


@dataclass(frozen=True)
class Retired:
    """An option that was removed because it did not help, or nobody gave it another value."""

    off: tuple[object, ...] | None = (0,)
    """Values that changed nothing; None: all, because another option switched it on."""
    instead: str = ""
    """What to use instead; "": nothing."""


RETIRED: dict[str, Retired] = {
    "angle_jitter": Retired(instead="--angles LOW..HIGH"),
    "activation_noise": Retired(instead="--shake"),
    "ascent": Retired(None),
    "background_mix": Retired(),
    "detector_weights": Retired((None,), instead="--ensemble adaptive"),
    "held_out": Retired(instead="--snapshot-every N and cloak evaluate --over-time, which show when to stop"),
    "held_out_every": Retired(None),
    "field_of_view": Retired((60, 60.0)),
    "hard_views": Retired(instead="--angles LOW..HIGH, which shows all sides evenly"),
    "jpeg": Retired((None,)),
    "layout": Retired(None, instead="onnx:FILE:LAYOUT as the detector"),
    "lr_epochs": Retired((10, 10.0)),
    "margin": Retired((1, 1.0)),
    "occluders": Retired(instead="--cutout"),
    "outfits": Retired(("random",)),
    "patience": Retired(instead="--steps"),
    "people_context": Retired(("1.1:2", "1.1:2.0")),
    "people_light": Retired((0.3,)),
    "people_loose": Retired((0.02,)),
    "people_mirror": Retired((0.5,)),
    "people_shift": Retired((0.1,)),
    "people_soft": Retired((0.8,)),
    "person_class": Retired(None, instead="SPEC@person=CLASS as the detector"),
    "photometric_on": Retired(("logo",)),
    "query_change": Retired((0.1,)),
    "query_lr": Retired((0.02,)),
    "random_depth": Retired(instead="--shake"),
    "reduce": Retired(("max",)),
    "rpn_weight": Retired(),
    "sharpness": Retired(),
    "tensorboard": Retired((False,), instead="--log tensorboard"),
    "threshold": Retired((0.6,)),
    "tint": Retired(),
    "within_most": Retired((None,)),
    "wrinkle_draws": Retired(None),
    "wrinkles": Retired(instead="--scene sample-clothed:train, or a simulated garment"),
    "zoom": Retired((1, "1", "1.0", "1:1"), instead="--distance, --crop and --pad"),
}
"""By the name that records and files have. docs/reports/training.md says what each was measured to do."""


def without_retired(record: dict[str, object]) -> dict[str, object]:
    """Leave out retired settings that were off. InputError: one was on."""
    for name in RETIRED.keys() & record.keys():
        retired = RETIRED[name]
        if retired.off is not None and record[name] not in retired.off:
            replaced = f"; use {retired.instead}" if retired.instead else ""
            raise InputError(f"{option(name)} {record[name]}: this version has no such option{replaced}")
    return {name: value for name, value in record.items() if name not in RETIRED}
