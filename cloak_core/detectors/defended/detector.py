"""A detector behind a defence, as one detector."""

import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.detector.protocol import Detections, Detector, state_hash
from cloak_core.detectors.defended.table import DEFENCES, read_head


class DefendedDetector(Detector):
    """Shows the inner detector what the defence leaves of the images; boxes are in the pixels of the images given.

    Where it reports, which class it looks for, the size it takes: all are the inner detector's.
    """

    def __init__(self, inner: Detector, name: str, value: float, spec: str) -> None:
        super().__init__(f"{name} {inner.name}", spec)
        self.defence, self.inner = DEFENCES[name].build(value), inner
        # A part of the state and of its hash, as whatever else decides the answers.
        self.register_buffer(f"{name.replace('-', '_')}_value", torch.tensor(value, dtype=torch.float64))
        self.differentiable, self.compiled = inner.differentiable, inner.compiled
        why = (self.defence.partial_gradient, inner.partial_gradient)
        self.partial_gradient = "; ".join(part for part in why if part)
        self.operating_point = inner.operating_point
        self.operating_point_assumed = inner.operating_point_assumed
        self.source = {"defence": name, "value": value}
        self.source |= {key: inner.source[key] for key in ("input_size", "layout") if key in inner.source}
        self.packages, self.class_names = inner.packages, inner.class_names
        if hasattr(inner, "person"):
            self.person = inner.person

    def look_again(self) -> dict[str, object]:
        """See `Detector.look_again`."""
        return {"inner": self.inner.whole_source()}

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        return self.defence.detect(self.inner, images)

    def verify(self, before: str) -> None:
        """See `Detector.verify`; the inner detector verifies itself, too."""
        self.inner.verify(state_hash(self.inner))
        super().verify(before)


def defend(inner: Detector, head: str) -> DefendedDetector:
    """Put the defence that `head` names ("jpeg=75") before a detector; its tensors are shared.

    InputError: an unknown defence, a number out of bounds.
    """
    spec = f"{head}:{inner.spec}"
    name, value = read_head(head, spec)
    return DefendedDetector(inner, name, value, spec).to(inner.device).freeze()
