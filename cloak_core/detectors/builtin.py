"""The detector that comes with Cloak: a small person detector of the YOLOv2 family, trained by tools/pretrain."""

from pathlib import Path

from cloak_core.detectors.darknet.detector import DarknetDetector, read_darknet
from cloak_core.detectors.specs import Request

CFG = Path(__file__).with_name("builtin.cfg")
WEIGHTS = Path(__file__).with_name("builtin.weights")
CLASS_NAMES = ("person",)


def load_builtin(request: Request) -> DarknetDetector:
    """Load the embedded detector, or the same network with other weights, `builtin:WEIGHTS` (`cloak harden`)."""
    weights = Path(request.what).expanduser() if request.what else WEIGHTS
    detector = read_darknet(CFG, weights, request, class_names=CLASS_NAMES)
    detector.operating_point, detector.operating_point_assumed = 0.5, False  # it was trained and judged for that
    return detector
