"""What is asked of a detector. Each check answers with one finding; what a detector raises is a finding, too."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn.functional import interpolate

from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.core.detector.scoring import box_iou, max_person_score
from cloak_core.detectors.verification.comparing import (
    AGREES,
    BATCH,
    Apart,
    apart,
    gradient_error,
    gradient_of,
    sureness,
)

ROUNDING = 1e-6
"""Scores may be beyond [0, 1] by so much."""
Images = Float[Tensor, "B 3 H W"] | UInt8[Tensor, "B 3 H W"]
CLEAR = 0.1
"""Boxes with a higher score must be somewhere in the image."""
SAME_BOX = 0.5
"""Two boxes that overlap by more (IoU) show the same; a box and its double never do."""
ROUGH = 0.5
"""A gradient that is further off than `AGREES`, but not so far, may leave a part out on purpose: told, not judged."""
DESCENTS = 3
"""Steps down the gradient."""
WIDTHS = tuple(1 / 255 / 4**k for k in range(5))
"""How much a step may change a pixel; each of them is tried."""
REPEATS = 5
"""Of measurements of time."""
LEAST_FALL, SURE = 1e-3, 1e-4
"""Of the scores' logits, so that rounding is no fall; and how near to 0 and 1 these are taken."""


@dataclass(frozen=True)
class Finding:
    """What one check found."""

    passed: bool | None
    """None where it does not apply, or is told without being judged."""
    words: str
    """What was seen, or why not."""
    figures: dict[str, object] = field(default_factory=dict)
    """For the report, by its keys."""


@dataclass(frozen=True, eq=False)
class Subject:
    """What is checked, and on what."""

    detector: Detector
    images: Images
    """In [0, 1], or bytes; photographs first; four or more."""
    original: Detector | None
    """The same in the runtime it comes from, or as it was trained."""

    @property
    def size(self) -> tuple[int, int]:
        return self.images.shape[2], self.images.shape[3]

    @property
    def few(self) -> Float[Tensor, "b 3 H W"]:
        """The first four images."""
        return next(self.batches())

    def batches(self) -> Iterator[Float[Tensor, "b 3 H W"]]:
        """Yield all images, four at a time; the last batch is filled up with the first images."""
        whole = torch.cat([self.images, self.images[: -len(self.images) % BATCH]])
        for batch in whole.split(BATCH):
            yield (batch if batch.is_floating_point() else batch.float() / 255).to(self.detector.device)

    def sureness(self, images: Tensor) -> Tensor:
        return sureness(self.detector(images).scores)


@torch.no_grad()
def shapes(subject: Subject) -> Finding:
    """Check shapes for one image and for several: boxes [B, N, 4], scores [B, N], float32, all finite."""
    wrong = []
    for images in (subject.few[:1], subject.few):
        detections = subject.detector(images)
        count, boxes = len(images), detections.scores.shape[1:]
        for name, part in detections._asdict().items():
            if part is None:
                continue
            expected = (count, *boxes, 4) if name == "boxes" else (count, *boxes)
            if tuple(part.shape) != expected:
                wrong.append(f"{name} {list(part.shape)} for {count} images, not {list(expected)}")
            elif part.is_floating_point() and not bool(part.isfinite().all()):
                wrong.append(f"{name} not finite")
            elif part.dtype not in (torch.float32, torch.bool, torch.int64):
                wrong.append(f"{name} of type {part.dtype}")
    return Finding(
        not wrong, "; ".join(wrong) or f"boxes {list(detections.boxes.shape)}, scores {list(detections.scores.shape)}"
    )


@torch.no_grad()
def ranges(subject: Subject) -> Finding:
    """Check that every probability lies in [0, 1], and that classes have names."""
    detections, ranges, passed = subject.detector(subject.few), [], True
    for name in ("scores", "objectness", "other"):
        values = getattr(detections, name)
        if values is not None and values.numel():
            low, high = float(values.min()), float(values.max())
            passed &= low >= -ROUNDING and high <= 1 + ROUNDING
            ranges.append(f"{name} from {low:.3g} to {high:.3g}")
    if detections.other_class is not None and detections.other_class.numel():
        names, most = subject.detector.class_names, int(detections.other_class.max())
        passed &= int(detections.other_class.min()) >= 0 and (names is None or most < len(names))
        ranges.append(f"other classes up to {most}{'' if names is None else f' of {len(names)}'}")
    return Finding(passed, ", ".join(ranges) or "no boxes at all")


@torch.no_grad()
def sane_boxes(subject: Subject) -> Finding:
    """Check that boxes that matter have their corners in order and reach into the image."""
    detections, (height, width) = subject.detector(subject.few), subject.size
    boxes = detections.boxes[detections.scores > CLEAR]
    swapped = int(((boxes[:, 2] < boxes[:, 0]) | (boxes[:, 3] < boxes[:, 1])).sum())
    inside = (boxes[:, 2] > 0) & (boxes[:, 3] > 0) & (boxes[:, 0] < width) & (boxes[:, 1] < height)
    outside = int((~inside).sum())
    words = f"of {len(boxes)} above a score of {CLEAR}: {swapped} with corners swapped, {outside} outside the image"
    return Finding(not swapped and not outside, words)


@torch.no_grad()
def repeatable(subject: Subject) -> Finding:
    """Check that two calls say the same to the last bit."""
    first, second = subject.detector(subject.few), subject.detector(subject.few)
    same = all(a is b is None or torch.equal(a, b) for a, b in zip(first, second, strict=True))
    return Finding(same, "two calls say the same" if same else "two calls on the same images differ")


@torch.no_grad()
def batch_invariance(subject: Subject) -> Finding:
    """Check that an image is answered alike alone and among others, wherever it stands among them."""
    images = subject.few
    alone = [subject.detector(image) for image in images.split(1)]
    worst = Apart(0.0, 0.0)
    for order in (range(BATCH), range(BATCH - 1, -1, -1)):
        together = subject.detector(images[list(order)])
        for place, i in enumerate(order):
            worst = worst.joined(apart(row(together, place), alone[i], subject.size))
    return Finding(worst.same, f"alone and among others {worst}", {"batch_invariant": worst.same})


def extremes(subject: Subject) -> Finding:
    """Check black, white and noise: finite answers, and finite gradients."""
    noise = torch.rand(1, 3, *subject.size, generator=torch.Generator().manual_seed(0))
    wrong = []
    for name, image in {"black": 0 * noise, "white": 0 * noise + 1, "noise": noise}.items():
        image = image.to(subject.detector.device)
        with torch.no_grad():
            detections = subject.detector(image)
        parts = [part for part in detections if part is not None and part.is_floating_point()]
        if not all(bool(part.isfinite().all()) for part in parts):
            wrong.append(f"{name}: answers are not finite")
        elif subject.detector.differentiable and not bool(gradient_of(subject.sureness, image).isfinite().all()):
            wrong.append(f"{name}: gradients are not finite")
    return Finding(not wrong, "; ".join(wrong) or "black, white and noise are answered with numbers")


def gradient(subject: Subject) -> Finding:
    """Compare the gradient with a finite difference.

    Only its being finite is judged where a detector says that it holds something fixed on purpose.
    """
    if not subject.detector.differentiable:
        return Finding(None, "a black box has none", {"gradient_error": None})
    error = gradient_error(subject.sureness, subject.few[:1])
    if error is None:
        return Finding(False, "no finite gradient but zero", {"gradient_error": None})
    words, passed = f"the slope along it is {error:.1%} off a finite difference", error <= AGREES
    why = subject.detector.partial_gradient
    if not passed and (why or error <= ROUGH):
        words, passed = f"{words}; {why or 'is something held fixed, as two-stage detectors do?'}", None
    return Finding(passed, words, {"gradient_error": error})


def descent(subject: Subject) -> Finding:
    """Check that the best person scores fall down the gradient, averaged over the images.

    Each of a few steps looks along the sign of the gradient at several widths and keeps each image's lowest score:
    detectors are rough, and one image may sit on an edge. Their logits' mean must fall; images that stay are told.
    """
    detector, images = subject.detector, subject.few
    if not detector.differentiable:
        return Finding(None, "a black box has no way down")
    before = lowest = _best(detector, images)
    for _ in range(DESCENTS):
        way, here = _uphill(detector, images).sign(), images
        for width in WIDTHS:
            tried = (here - width * way).clamp(0, 1)
            reached = _best(detector, tried)
            better = reached < lowest
            images = torch.where(better[:, None, None, None], tried, images)
            lowest = torch.where(better, reached, lowest)
    fall = torch.logit(before.double(), SURE) - torch.logit(lowest.double(), SURE)
    stuck = [str(number + 1) for number in (fall < LEAST_FALL).nonzero()[:, 0].tolist()]
    scores = [" ".join(f"{score:.3g}" for score in some.tolist()) for some in (before, lowest)]
    words = f"best person scores {' fall to '.join(scores)} in {DESCENTS} steps of at most 1/255"
    words += f"; image {', '.join(stuck)} of {len(images)} tells nothing" if stuck else ""
    return Finding(float(fall.mean()) >= LEAST_FALL, words)


@torch.no_grad()
def parity(subject: Subject) -> Finding:
    """Compare with the original, one by one and four images at a time."""
    if subject.original is None:
        why = getattr(subject.detector, "black_box", "")
        words = f"it runs in its own runtime alone: {why}" if why else "there is no other runtime to compare it with"
        return Finding(None, words, {"parity_scores": None, "parity_boxes_px": None})
    worst = Apart(0.0, 0.0)
    for images in subject.batches():
        together = subject.detector(images)
        for i, image in enumerate(images.split(1)):
            expected = subject.original(image)
            for detections in (subject.detector(image), row(together, i)):
                worst = worst.joined(apart(detections, expected, subject.size))
    words = f"on {len(subject.images)} images, it and its original {worst}"
    return Finding(worst.same, words, {"parity_scores": worst.scores, "parity_boxes_px": worst.boxes_px})


@torch.no_grad()
def other_size(subject: Subject) -> Finding:
    """Check that boxes grow with the image: the same images at twice the size, by each one's best person.

    A wrapper that forgets to convert boxes from its network's pixels to the image's leaves them where they were. That
    shows only away from the network's own size. Pixels are repeated, so that a network that resizes images sees the
    same ones.
    """
    images = subject.few
    usual, large = subject.detector(images), subject.detector(interpolate(images, scale_factor=2, mode="nearest"))
    grown = stayed = 0
    for i in range(len(images)):
        if min(float(max_person_score(row(detections, i))) for detections in (usual, large)) > CLEAR:
            before, after = (detections.boxes[i, detections.scores[i].argmax()] for detections in (usual, large))
            grown += float(box_iou(after, 2 * before)) > SAME_BOX
            stayed += float(box_iou(after, before)) > SAME_BOX
    words = f"twice as large: of {len(images)} best boxes {grown} grow with the image, {stayed} stay as they were"
    if not grown and not stayed:
        return Finding(None, f"{words}, too few are clear to judge")
    return Finding(2 * stayed <= len(images), words)


def speed(subject: Subject) -> Finding:
    """Time it beside the original on the same threads, in turns; told, not judged: machines are busy."""
    images, ways = subject.few, {"forward": lambda: _best(subject.detector, images)}
    if subject.detector.differentiable:
        ways["gradient"] = lambda: _uphill(subject.detector, images)
    if subject.original is not None:
        ways["original"] = lambda: _best(subject.original, images)
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for turn in range(REPEATS + 1):  # the first warms up
        for name, work in ways.items():
            start = time.perf_counter()
            work()
            if torch.cuda.is_available():
                torch.cuda.synchronize()
            if turn:
                seconds[name].append(time.perf_counter() - start)
    took = {name: statistics.median(values) for name, values in seconds.items()}
    figures = {f"{name}_ms": 1000 * seconds / len(images) for name, seconds in took.items()}
    figures["forward_ratio"] = took["forward"] / took["original"] if "original" in took else None
    figures["gradient_ratio"] = took["gradient"] / took["forward"] if "gradient" in took else None
    words = f"{figures['forward_ms']:.1f} ms an image ({torch.get_num_threads()} threads)"
    if figures["forward_ratio"]:
        words += f", {figures['forward_ratio']:.2f} times its original"
    if figures["gradient_ratio"]:
        words += f"; with the gradient {figures['gradient_ratio']:.2f} times that"
    return Finding(None, words, figures)


@torch.no_grad()
def _best(detector: Detector, images: Tensor) -> Tensor:
    return max_person_score(detector(images))


def _uphill(detector: Detector, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
    """Compute the gradient of the logarithm of each image's best person score."""
    return gradient_of(lambda pixels: max_person_score(detector(pixels)).clamp(min=1e-30).log().sum(), images)


def row(detections: Detections, index: int) -> Detections:
    """Take the detections of one of several images."""
    return detections.each(lambda part: part[index : index + 1])
