"""The detector that comes with Cloak: a small person detector of the YOLOv2 family, trained by cloak_core/pretrain."""

from pathlib import Path

from cloak_core.detectors.darknet.detector import DarknetDetector, load_darknet

CFG = Path(__file__).with_name("builtin.cfg")
WEIGHTS = Path(__file__).with_name("builtin.weights")
CLASS_NAMES = ("person",)


def load_builtin(
    *,
    spec: str = "builtin",
    input_size: tuple[int, int] | None = None,
    letterbox: bool = False,
    person_class: str = "person",
    fold: bool = True,
) -> DarknetDetector:
    """The embedded detector, frozen."""
    return load_darknet(
        CFG,
        WEIGHTS,
        name="builtin",
        spec=spec,
        input_size=input_size,
        letterbox=letterbox,
        person_class=person_class,
        fold=fold,
        class_names=CLASS_NAMES,
    )
