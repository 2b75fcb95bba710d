"""The options of every command that is given a detector."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from cloak_core.detectors.protocol import Detector


@dataclass(kw_only=True)
class DetectorOptions:
    """How detectors are loaded and run."""

    person_class: str | None = None
    """Name or index of the class to look for, where it is not called person; SPEC@person=CLASS for one of several
    detectors."""
    precision: Literal["float32", "bfloat16", "auto"] = "float32"
    """bfloat16 runs detectors under autocast (faster on GPUs, rough gradients); auto uses it where the device gains."""
    compile: bool = False
    """Run detectors through torch.compile; needs a C++ compiler, and the first images of each size take long."""
    layout: str | None = None
    """Output layout of an ONNX model: yolov5, yolov8, yolox, nanodet ... (default: told from the file)."""
    download: bool = False
    """Fetch official weights of torchvision and transformers models that are not on this machine."""

    def load(self, specs: Iterable[str], device: str) -> list[Detector]:
        """The detectors, in order."""
        from cloak_core.detectors.loading import load_detector

        return [load_detector(spec, device=device, **self.arguments()) for spec in specs]

    def arguments(self) -> dict:
        """As `load_detector` takes them."""
        given = vars(self) | {"compiled": self.compile}
        return {name: value for name, value in given.items() if name != "compile"}
