"""Anyone's own detector: `python:FILE.py:FUNCTION`, a callable that returns a module images -> (boxes, scores)."""

import importlib.util
import sys
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.detectors.protocol import Detections, Detector
from cloak_core.detectors.resizing import Placement, fit
from cloak_core.detectors.specs import Request
from cloak_core.files.errors import InputError
from cloak_core.files.identity import source_hash


class PythonDetector(Detector):
    """Wraps a module that takes images [B, 3, H, W] (RGB, 0..1) and returns boxes [B, N, 4] and person scores [B, N].

    It may return a `Detections` instead, with `proposal_scores` where it has a first stage that can be attacked. Images
    are handed over as they are unless an input size is given, their memory channels last (`channels_last`): the same
    numbers, and convolutions are faster for it. A module that takes views which that layout does not allow gets the
    usual one.
    """

    def __init__(
        self,
        module: nn.Module,
        name: str,
        spec: str,
        input_size: tuple[int, int] | None = None,
        letterbox: bool = False,
        channels_last: bool = True,
    ) -> None:
        super().__init__(name, spec)
        self.module, self.input_size, self.letterbox = module, input_size, letterbox
        self._lay_out(torch.channels_last if channels_last else torch.contiguous_format)

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        inputs, placement = images, Placement()
        if self.input_size is not None:
            inputs, placement = fit(images, self.input_size, self.letterbox)
        found = self._checked(self._run(inputs), len(images))
        return found._replace(boxes=placement.restore(found.boxes)) if self.input_size is not None else found

    def _run(self, inputs: Float[Tensor, "B 3 H W"]) -> object:
        try:
            return self.module(inputs.contiguous(memory_format=self.memory_format))
        except RuntimeError as error:
            # torch's words where `Tensor.view` meets strides it cannot join; it never returns wrong numbers instead.
            if self.memory_format == torch.contiguous_format or "view size is not compatible" not in str(error):
                raise
        self._lay_out(torch.contiguous_format)
        return self.module(inputs.contiguous())

    def _lay_out(self, memory_format: torch.memory_format) -> None:
        self.memory_format = memory_format
        self.module.to(memory_format=memory_format)

    def _checked(self, output: object, count: int) -> Detections:
        if (
            not isinstance(output, (tuple, list))
            or len(output) < 2
            or not all(isinstance(o, Tensor) for o in output[:2])
        ):
            raise InputError(
                f"{self.spec}: must return (boxes, scores), two tensors; it returned {type(output).__name__}"
            )
        found = output if isinstance(output, Detections) else Detections(output[0], output[1])
        boxes, scores = tuple(found.boxes.shape), tuple(found.scores.shape)
        if len(boxes) != 3 or boxes[2] != 4 or scores != boxes[:2] or boxes[0] != count:
            raise InputError(
                f"{self.spec}: for {count} images must return boxes [{count}, N, 4] and scores [{count}, N]; "
                f"it returned {list(boxes)} and {list(scores)}"
            )
        return found


def load_python(request: Request) -> PythonDetector:
    """Run FILE.py (it is trusted: it is the user's own code), call FUNCTION(), freeze what it returns.

    Told not to fold, the memory layout is left alone; the module itself is never changed.
    """
    name, function = request.parts
    file = Path(name).expanduser()
    if not file.is_file():
        raise InputError(f"{file}: no such file")
    made = _function(file, function)()
    if not isinstance(made, nn.Module):
        raise InputError(f"{file}: {function}() must return a torch.nn.Module, it returned {type(made).__name__}")
    detector = PythonDetector(
        made, file.stem, request.spec, request.input_size, request.letterbox, channels_last=request.fold
    )
    size = None if request.input_size is None else list(request.input_size)
    detector.source = {"file": source_hash(file), "function": function, "input_size": size}
    detector.source["letterbox"] = request.letterbox
    detector.freeze()
    return detector


def _function(file: Path, function: str):
    name = f"cloak_detector_{file.stem}"
    module_spec = importlib.util.spec_from_file_location(name, file)
    if module_spec is None or module_spec.loader is None:
        raise InputError(f"{file}: not a Python file")
    module = importlib.util.module_from_spec(module_spec)
    sys.modules[name] = module  # dataclasses and the like look their module up there
    try:
        module_spec.loader.exec_module(module)
    except (SyntaxError, ImportError) as error:
        raise InputError(f"{file}: cannot be loaded: {error}") from error
    if not callable(getattr(module, function, None)):
        raise InputError(f"{file}: has no function {function!r}")
    return getattr(module, function)
