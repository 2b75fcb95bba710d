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
    """Class to look for, by name or index, where it is not called person; SPEC@person=CLASS for one of several."""
    precision: Literal["float32", "bfloat16", "auto"] = "float32"
    """bfloat16 runs detectors under autocast (quicker on GPUs, rough gradients), auto where the device gains by it."""
    compile: bool = False
    """Run detectors through torch.compile (needs a C++ compiler; the first images of each size take long)."""
    layout: str | None = None
    """Of an ONNX model's outputs: yolov5, yolov8, yolox, nanodet ... (default: told from the file)."""
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
