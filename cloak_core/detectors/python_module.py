"""Anyone's own detector: `python:FILE.py:FUNCTION`, a callable that returns a module images -> (boxes, scores)."""

import contextlib
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.core.detector.protocol import Detections, Detector, state_hash
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.detectors.foreign_code import data_beside, excused, limited, set_back, watched
from cloak_core.detectors.pixels import Placement, fit
from cloak_core.detectors.specs import Request
from cloak_core.files.errors import InputError
from cloak_core.files.identity import source_hash

ROUNDING = 1e-3
"""Scores may be beyond [0, 1] by so much."""
SAME = 0.01
"""Best scores of an image that differ by more are two answers."""
CLEAR = 0.05
"""Boxes with a higher score have their corners in order."""


class PythonDetector(Detector):
    """Wraps a module that takes images [B, 3, H, W] (RGB, 0..1) and returns boxes [B, N, 4] and person scores [B, N].

    It may return a `Detections` instead: with `other` and `other_class` it tells what else it sees. Images are handed
    over as they are unless an input size is given, their memory channels last (`channels_last`): the same numbers, and
    convolutions are faster for it. A module that takes views which that layout does not allow gets the usual one. The
    module's attributes `differentiable`, `partial_gradient` and `class_names` are taken over, see `Detector`.
    """

    def __init__(
        self,
        module: nn.Module,
        name: str,
        spec: str,
        input_size: tuple[int, int] | None = None,
        letterbox: bool = False,
        channels_last: bool = True,
        file: Path | None = None,
    ) -> None:
        super().__init__(name, spec)
        self.differentiable = bool(getattr(module, "differentiable", True))
        self.partial_gradient = str(getattr(module, "partial_gradient", ""))
        names = getattr(module, "class_names", None)
        self.class_names = None if names is None else tuple(map(str, names))
        self.module, self.input_size, self.letterbox, self.file = module, input_size, letterbox, file
        self._range: Tensor | None = None
        self._asked: set[str] = set()
        self._lay_out(torch.channels_last if channels_last else torch.contiguous_format)

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        """Detect as every detector does. InputError, with the line of the user's file: what it does wrong.

        It raises, exits, or returns what cannot be; at the first images also: no gradients where they are asked for, a
        changed state, scores outside [0, 1].
        """
        first, layout = self._range is None, self.memory_format
        before = self._versions() if first else []
        with set_back():
            detections = super().forward(images)
        if images.requires_grad and torch.is_grad_enabled() and not detections.scores.requires_grad:
            if detections.scores.numel():
                raise self._error("its scores carry no gradient of the images (detached, or made without one?)")
            detections = detections._replace(scores=detections.scores + 0 * images.sum())
        self._watch(detections.scores.detach())
        if first and self._range is not None:
            self._check_range()
            if self.memory_format == layout and self._versions() != before:
                raise self._error("it changes its own parameters or buffers when it is called")
        with set_back():
            self._ask_again(images.detach(), detections)
        return detections

    def verify(self, before: str) -> None:
        """See `Detector.verify`; what the user's module did wrong is an InputError."""
        self._check_range()
        self._require_finite(self._not_finite)
        if state_hash(self) != before:
            raise self._error("it changed its own parameters or buffers while it was used")

    @torch.no_grad()
    def _ask_again(self, images: Float[Tensor, "B 3 H W"], detections: Detections) -> None:
        """Ask the first images twice, and one of the first batch alone. InputError: it does not answer the same."""
        before = max_person_score(detections).detach()
        for how, least, rows in (
            ("is asked twice about the same images", 1, slice(None)),
            ("sees an image alone and among others", 2, slice(-1, None)),
        ):
            if how in self._asked or len(images) < least:
                continue
            self._asked.add(how)
            worst = float((max_person_score(super().forward(images[rows])) - before[rows]).abs().max())
            if not worst <= SAME:
                raise self._error(f"it answers otherwise where it {how}: best scores differ by {worst:.3g}")

    def _versions(self) -> list[tuple[int, int]]:
        """List the module's tensors and how often each was written to, from the host's memory alone."""
        return [(id(tensor), tensor._version) for tensor in (*self.parameters(), *self.buffers())]

    def _watch(self, scores: Float[Tensor, "B N"]) -> None:
        """Note the lowest and highest score so far, without waiting for the device."""
        if not scores.numel():
            return
        extremes = torch.stack(scores.aminmax())
        if self._range is None or self._range.device != extremes.device:
            self._range = extremes
        self._range = torch.stack(
            [torch.minimum(self._range[0], extremes[0]), torch.maximum(self._range[1], extremes[1])]
        )

    def _check_range(self) -> None:
        low, high = (0.0, 0.0) if self._range is None else self._range.tolist()
        if not (-ROUNDING <= low and high <= 1 + ROUNDING):
            raise self._error(
                f"its scores must lie in [0, 1], probabilities of a person; they reach {low:g} to {high:g}"
            )

    def _error(self, words: str) -> InputError:
        """Say what is wrong with the user's module, with the line where its `forward` begins."""
        code = getattr(type(self.module).forward, "__code__", None)
        ours = code is not None and self.file is not None and code.co_filename == str(self.file)
        return InputError(f"{self.spec}: {f'{self.file}:{code.co_firstlineno}: ' if ours else ''}{words}")

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        inputs, placement = images, Placement()
        if self.input_size is not None:
            inputs, placement = fit(images, self.input_size, self.letterbox)
        detections = self._checked(self._run(inputs), images)
        return (
            detections._replace(boxes=placement.restore(detections.boxes))
            if self.input_size is not None
            else detections
        )

    def _run(self, inputs: Float[Tensor, "B 3 H W"]) -> object:
        # An object of a program's own may stand at a breakpoint; its signals are the program's.
        limit = limited() if "function" in self.source else contextlib.nullcontext()
        with excused(self.spec, self.file), limit:
            try:
                return self.module(inputs.contiguous(memory_format=self.memory_format))
            except RuntimeError as error:
                # torch's words where `Tensor.view` meets strides it cannot join: it never returns wrong numbers.
                if self.memory_format == torch.contiguous_format or "view size is not compatible" not in str(error):
                    raise
            self._lay_out(torch.contiguous_format)
            return self.module(inputs.contiguous())

    def _lay_out(self, memory_format: torch.memory_format) -> None:
        self.memory_format = memory_format
        self.module.to(memory_format=memory_format)

    def _checked(self, output: object, images: Float[Tensor, "B 3 H W"]) -> Detections:
        count = len(images)
        if (
            not isinstance(output, (tuple, list))
            or len(output) < 2
            or not all(isinstance(o, Tensor) for o in output[:2])
        ):
            raise self._error(f"must return (boxes, scores), two tensors; it returned {type(output).__name__}")
        detections = output if isinstance(output, Detections) else Detections(output[0], output[1])
        boxes, scores = tuple(detections.boxes.shape), tuple(detections.scores.shape)
        if len(boxes) != 3 or boxes[2] != 4 or scores != boxes[:2] or boxes[0] != count:
            raise self._error(
                f"for {count} images must return boxes [{count}, N, 4] and scores [{count}, N]; "
                f"it returned {list(boxes)} and {list(scores)}"
            )
        for name, tensor in zip(("boxes", "scores"), detections, strict=False):
            if tensor.device != images.device:
                raise self._error(f"its {name} are on {tensor.device}, the images on {images.device}")
            if not tensor.is_floating_point() or tensor.layout != torch.strided:
                kind = tensor.dtype if tensor.layout == torch.strided else f"{tensor.layout}, a sparse tensor"
                raise self._error(f"its {name} are {kind}, not floating-point numbers")
        if detections.boxes.device.type == "cpu":
            sizes = (detections.boxes[..., 2:] - detections.boxes[..., :2]).detach()
            if bool(((sizes < 0).any(dim=2) & (detections.scores.detach() > CLEAR)).any()):
                raise self._error("a box has its corners swapped: they are x1, y1, x2, y2")
        if (detections.other is None) != (detections.other_class is None):
            raise self._error("must return both of other and other_class, or neither")
        return detections


def load_python(request: Request) -> PythonDetector:
    """Run FILE.py (it is trusted: it is the user's own code), call FUNCTION(), freeze what it returns.

    Told not to fold, the memory layout is left alone; the module itself is never changed.
    """
    name, function = request.parts
    file = Path(name).expanduser()
    if not file.is_file():
        raise InputError(f"{file}: no such file")
    file = file.absolute()
    with excused(request.spec, file), set_back(signals=True):
        with watched(file), limited():
            made = _function(file, function)()
        if not isinstance(made, nn.Module):
            raise InputError(f"{file}: {function}() must return a torch.nn.Module, it returned {type(made).__name__}")
        detector = PythonDetector(
            made, file.stem, request.spec, request.input_size, request.letterbox, channels_last=request.fold, file=file
        )
        detector.freeze()
        state_hash(detector)  # whoever uses it asks for this; what cannot be hashed is said here
    size = None if request.input_size is None else list(request.input_size)
    detector.source = {"file": source_hash(file), "function": function, "input_size": size}
    detector.source["letterbox"] = request.letterbox
    if data := data_beside(file):
        detector.source["data"] = data
    return detector


def _function(file: Path, function: str) -> Callable[[], object]:
    name = f"cloak_detector_{file.stem}"
    module_spec = importlib.util.spec_from_file_location(name, file)
    if module_spec is None or module_spec.loader is None:
        raise InputError(f"{file}: not a Python file")
    module = importlib.util.module_from_spec(module_spec)
    sys.modules[name] = module  # dataclasses and the like look their module up there
    module_spec.loader.exec_module(module)
    if not callable(getattr(module, function, None)):
        raise InputError(f"{file}: has no function {function!r}")
    return getattr(module, function)
