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
    """What to hide: the class person alone, or every class on the body."""
    loss: Loss = "score"
    """What is minimised of each box: score, of the person; objectness, where person is the likeliest class; log, which
    is -log(1 - score) and keeps its gradient where the score saturates; or margin, how far the score lies above the
    detector's own operating point, in logits."""
    margin: NotNegative = 1.0
    """For --loss margin: logits below the operating point at which half of the gradient is left. A larger margin hides
    from more of the detectors that training never saw."""
    reduce: Reduce = "max"
    """How an image's boxes become one number: the largest, the mean of the ten largest (topk), or a soft maximum."""
    rpn_weight: NotNegative = 0.0
    """For two-stage detectors: weight of the first stage's objectness of the proposals behind person boxes."""
    ensemble: Literal["mean", "max", "weighted", "adaptive"] = "mean"
    """How the losses of several detectors are combined: mean; max, the detector that sees most; weighted, by
    --detector-weights; adaptive, by how surely each detector found a person lately."""
    detector_weights: Weights | None = None
    """For --ensemble weighted: one weight per detector, A,B,C. Only their ratios count."""
    detectors_per_step: Annotated[int | None, Bounds(1, 4096)] = None
    """Ask at most this many detectors in each step, drawn at random; None asks all."""
    tv_weight: NotNegative = 2.5
    """Weight of total variation: the sum over inner edges of length (metres) times colour difference, divided by the
    number of the logo's faces."""
    nps_weight: NotNegative = 0.0
    """Weight of non-printability: the mean distance of the colours to the nearest colour of --palette."""
    palette: str | None = None
    """File of printable colours: one a line, three numbers in [0, 1] or #rrggbb; or a GIMP .gpl."""

    def check(self) -> None:
        """InputError: values that do not go together."""
        if self.nps_weight and self.palette is None:
            raise InputError("--nps-weight: needs a --palette to measure against")
        if (self.ensemble == "weighted") != (self.detector_weights is not None):
            raise InputError("--ensemble weighted and --detector-weights: one needs the other")
