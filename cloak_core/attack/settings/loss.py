"""Settings of `attack.losses`, `attack.ensemble` and `attack.objective`: what is minimised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cloak_core.attack.settings.values import Bounds, NotNegative, Weights
from cloak_core.files.errors import InputError

Loss = Literal["score", "objectness", "log", "margin"]
Reduce = Literal["max", "topk", "logsumexp"]
Hide = Literal["person", "everything"]


@dataclass(frozen=True, kw_only=True)
class LossSettings:
    """What training minimises."""

    hide: Hide = "person"
    """From what to hide: the class person alone, or every class on the body, so that nothing is reported in the
    person's place."""
    loss: Loss = "score"
    """Of each image's boxes: the person score, the objectness (of boxes whose likeliest class is person), the log of
    the score, -log(1 - score), which keeps its gradient where the score saturates, or the margin above each detector's
    own operating point, which keeps it down to there."""
    margin: NotNegative = 1.0
    """For loss margin: how far below the operating point, in logits, half the gradient is left. Further down, other
    detectors are hidden from more often."""
    reduce: Reduce = "max"
    """From an image's boxes to one number: the largest, the mean of the ten best (topk), or a soft maximum."""
    rpn_weight: NotNegative = 0.0
    """Two-stage detectors: weight of the objectness that their first stage gives the proposals behind person boxes;
    what lowers it kills the proposal itself."""
    ensemble: Literal["mean", "max", "weighted", "adaptive"] = "mean"
    """Of several detectors' losses for an image: the mean, the largest (the detector that sees most), weighted, or
    weighted by how surely each still found a person lately, beside its own operating point (adaptive; where a step asks
    only some, those are then asked more often)."""
    detector_weights: Weights | None = None
    """For a weighted ensemble: one weight for each detector, A,B,C; only their ratios count."""
    detectors_per_step: Annotated[int | None, Bounds(1, 4096)] = None
    """Ask at most so many of the detectors in each step, drawn anew; None asks all."""
    tv_weight: NotNegative = 2.5
    """Weight of total variation (sum over inner edges of metres x colour difference, divided by the logo's faces)."""
    nps_weight: NotNegative = 0.0
    """Weight of non-printability: the mean distance of the colours to the nearest one of the palette."""
    palette: str | None = None
    """Palette file of what can be printed: a colour a line, three numbers in [0, 1] or #rrggbb; or a GIMP .gpl."""

    def check(self) -> None:
        """InputError: values that do not go together."""
        if self.nps_weight and self.palette is None:
            raise InputError("--nps-weight: needs a --palette to measure against")
        if (self.ensemble == "weighted") != (self.detector_weights is not None):
            raise InputError("--ensemble weighted and --detector-weights: one needs the other")
