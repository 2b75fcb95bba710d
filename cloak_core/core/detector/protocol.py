"""The one call every detector answers, and what tells one detector from another."""

import hashlib
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from cloak_core.files.errors import InputError
from cloak_core.files.identity import package_versions


class Detections(NamedTuple):
    """What a detector says about B images, before thresholding and non-maximum suppression.

    Everything is differentiable in the images. A detector may pad: padded rows have a box of zeros and score 0.
    """

    boxes: Float[Tensor, "B N 4"]
    """xyxy, in pixels of the given images (not of the network's input); may reach beyond the image."""
    scores: Float[Tensor, "B N"]
    """The detector's own probability of a person, 0..1: class-conditional times objectness where there is one."""
    objectness: Float[Tensor, "B N"] | None = None
    """Probability of any object, 0..1; None where the family has none."""
    is_person: Bool[Tensor, "B N"] | None = None
    """Person is the likeliest class of this box; None where there is no objectness."""
    other: Float[Tensor, "B N"] | None = None
    """As `scores`, of the likeliest class beside the person; None where the detector knows or tells of no other class.
    Families that place each class apart give rows of a person alone (other 0) and of another class alone (score 0)."""
    other_class: Int[Tensor, "B N"] | None = None
    """Which class that is: its index among the detector's `class_names`. None exactly where `other` is."""

    def each(self, change: Callable[[Tensor], Tensor]) -> "Detections":
        """Change every part that is there."""
        return Detections(*(None if part is None else change(part) for part in self))


class Detector(nn.Module):
    """A frozen person detector: eval mode, no parameter gradients, deterministic.

    Families derive from it and implement `detect`; `differentiable` is False for black boxes (ONNX), whose
    detections carry no gradient. `precision` "bfloat16" runs it under autocast, for hardware made for it: on rendered
    bodies and a photograph scores stayed within 0.01, but the images' gradients had a cosine to the exact ones of 0.71
    to 0.97 in the median (by detector), down to -0.14 for a single image; so it is off unless asked for.
    """

    name: str
    """Short name for tables and file names."""
    spec: str
    """What `load_detector` was given; loading it again gives the same detector."""
    differentiable: bool = True
    """Whether detections carry a gradient to the images."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """What it computes in."""
    compiled: bool = False
    """Whether it runs through torch.compile."""
    partial_gradient: str = ""
    """Why the gradient is not all of its answer's slope, where something is held fixed on purpose; "" where it is."""
    operating_point: float = 0.5
    """The score above which the detector, as people run it, reports a box."""
    operating_point_assumed: bool = True
    """Nobody said so: it is what its family usually runs at."""
    source: dict[str, object]
    """What decides its answers beside its tensors, as plain values: hashes of the files that run it, its input size and
    options. Families fill it."""
    look_again: Callable[[], dict[str, object]] = dict
    """Tells what of `source` may change while it is in memory, as attributes of a program's own object do."""
    packages: tuple[str, ...]
    """The packages that run it, beside torch."""
    class_names: tuple[str, ...] | None = None
    """Names of its classes, by index; None where nobody said."""

    def __init__(self, name: str, spec: str) -> None:
        super().__init__()
        self.name = name
        self.spec = spec
        self.source = {}
        self.packages = ()
        self._not_finite: Tensor | None = None

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        """Detect persons in RGB images in [0, 1], of any size, on the detector's device.

        InputError: a box is not finite. On a GPU, which is not waited for, `verify` says so.
        """
        if self.precision == "float32":
            detections = self.detect(images)
        else:
            with torch.autocast(images.device.type, torch.bfloat16):
                detections = self.detect(images).each(lambda part: part.float() if part.is_floating_point() else part)
        broken = ~detections.boxes.detach().isfinite().all()
        if broken.device.type == "cpu":
            self._require_finite(broken)
        else:
            self._not_finite = broken if self._not_finite is None else self._not_finite | broken
        return detections

    def _require_finite(self, broken: Tensor | None) -> None:
        if broken is not None and bool(broken):
            raise self._error("a corner of its boxes is not a finite number")

    def _error(self, words: str) -> InputError:
        """Make the error that says what is wrong with what the detector answers."""
        return InputError(f"{self.spec}: {words}")

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        """Do the family's own work behind `forward`."""
        raise NotImplementedError

    def freeze(self) -> "Detector":
        """Switch to eval mode, without gradients for parameters. Families call it last in their loader."""
        return self.eval().requires_grad_(False)

    def verify(self, before: str) -> None:
        """Check after use that the `state_hash` is still `before`, and what `forward` left to be checked.

        RuntimeError: the detector has changed. InputError: a box was not finite.
        """
        self._require_finite(self._not_finite)
        if state_hash(self) != before:
            raise RuntimeError(f"detector {self.spec} changed while it was used")

    def original(self) -> "Detector | None":
        """Load the same network in the runtime that its file was made for, to compare with; None for none."""
        return None

    def whole_source(self) -> dict[str, object]:
        """Give `source`, and what `look_again` tells now; the spec for one that no family loaded."""
        return (self.source or {"spec": self.spec}) | self.look_again()

    @property
    def device(self) -> torch.device:
        """Where the images must be."""
        tensor = next(iter(self.parameters()), None)
        tensor = next(iter(self.buffers()), None) if tensor is None else tensor
        return torch.device("cpu") if tensor is None else tensor.device


def join_detections(parts: Sequence[Detections]) -> Detections:
    """Join detections of several batches into one, padded to the most boxes; no gradients."""
    most = max(part.scores.shape[1] for part in parts)

    def joined(name: str) -> Tensor | None:
        values = [getattr(part, name) for part in parts]
        if values[0] is None:
            return None
        ends = [(0, 0) * (value.dim() - 2) + (0, most - value.shape[1]) for value in values]
        return torch.cat([F.pad(value.detach(), end) for value, end in zip(values, ends, strict=True)])

    return Detections(*(joined(name) for name in Detections._fields))


def at_least_float32(x: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Convert what autocast left in bfloat16 to float32: eight bits hold no coordinate, and no probability near 1."""
    return x.float() if x.dtype in (torch.bfloat16, torch.float16) else x


def detector_record(detector: Detector) -> dict[str, object]:
    """Record all that decides a detector's answers, wherever its files lie and whatever it is called.

    Its tensors ("sha256", see `state_hash`), "precision", "compiled", "source" and the versions of its "packages". Of
    one that no family loaded, the spec stands for its source.
    """
    return {
        "sha256": state_hash(detector),
        "precision": detector.precision,
        "compiled": detector.compiled,
        "source": detector.whole_source(),
        "packages": package_versions(*detector.packages),
    }


def state_hash(detector: nn.Module) -> str:
    """Hash (SHA-256, hex) every parameter, buffer and train flag; equal hashes mean a bit-identical detector.

    Independent of device and memory format.
    """
    digest = hashlib.sha256()
    tensors = [*detector.named_parameters(remove_duplicate=False), *detector.named_buffers(remove_duplicate=False)]
    for name, tensor in sorted(tensors, key=lambda item: item[0]):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)};".encode())
        # Copied: a tensor of one element calls itself contiguous whatever its strides are, and has no bytes to look at.
        flat = tensor.detach().cpu().flatten().clone(memory_format=torch.contiguous_format)
        digest.update(flat.view(torch.uint8).numpy().tobytes())
    for name, module in sorted(detector.named_modules(remove_duplicate=False), key=lambda item: item[0]):
        digest.update(f"{name} training={module.training};".encode())
    return digest.hexdigest()
