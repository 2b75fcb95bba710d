"""`onnx:FILE[:LAYOUT]` through onnxruntime: a black box, for evaluation only."""

import ast
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.detectors.classes import names_beside, person_index
from cloak_core.detectors.extras import require
from cloak_core.detectors.protocol import Detections, Detector
from cloak_core.detectors.resizing import Placement, fit
from cloak_core.detectors.specs import Request
from cloak_core.detectors.transformers_family import IMAGENET
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_bytes

if TYPE_CHECKING:
    import onnxruntime

GREY = 114 / 255
"""What the YOLO exports were trained to see around letterboxed pictures."""
DEFAULT_SIDE = 640
YOLOX_STRIDES = (8, 16, 32)
COCO_91 = (91, 92)
"""Numbers of classes of DETR exports that count COCO's own ids, in which person is 1."""

Decoded = tuple[Tensor, Tensor, Tensor | None]


def _yolov5(outputs: list[Tensor], size: tuple[int, int]) -> Decoded:
    """[B, N, 5 + K]: centre and size in input pixels, objectness, classes."""
    rows = outputs[0]
    return _corners(rows[..., :4]), rows[..., 5:], rows[..., 4]


def _yolov8(outputs: list[Tensor], size: tuple[int, int]) -> Decoded:
    """[B, 4 + K, N]: centre and size in input pixels, classes; no objectness."""
    rows = outputs[0].transpose(1, 2)
    return _corners(rows[..., :4]), rows[..., 4:], None


def _yolox(outputs: list[Tensor], size: tuple[int, int]) -> Decoded:
    """[B, N, 5 + K] as YOLOv5, but offsets in cells and log sizes, for strides 8, 16 and 32 in turn."""
    rows = outputs[0]
    cells, strides = [], []
    for stride in YOLOX_STRIDES:
        h, w = size[0] // stride, size[1] // stride
        y, x = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
        cells.append(torch.stack([x, y], dim=-1).reshape(-1, 2))
        strides.append(torch.full((h * w, 1), float(stride)))
    grid, stride = torch.cat(cells), torch.cat(strides)
    boxes = torch.cat([(rows[..., :2] + grid) * stride, rows[..., 2:4].exp() * stride], dim=-1)
    return _corners(boxes), rows[..., 5:], rows[..., 4]


def _detr(outputs: list[Tensor], size: tuple[int, int]) -> Decoded:
    """Logits [B, Q, K + 1] (the last is "no object") and boxes [B, Q, 4], centre and size as fractions."""
    logits, boxes = outputs[:2] if outputs[1].shape[-1] == 4 else outputs[1::-1]
    pixels = torch.tensor([size[1], size[0]] * 2, dtype=boxes.dtype)
    return _corners(boxes * pixels), logits.softmax(dim=-1)[..., :-1], None


LAYOUTS: dict[str, Callable[[list[Tensor], tuple[int, int]], Decoded]] = {
    "yolov5": _yolov5,
    "yolov8": _yolov8,
    "yolox": _yolox,
    "detr": _detr,
}


class OnnxDetector(Detector):
    """Runs an ONNX session on the CPU, image by image where the model's batch is fixed to 1. Carries no gradient."""

    differentiable = False

    def __init__(self, session, layout: str, size: tuple[int, int], name: str, spec: str) -> None:
        super().__init__(name, spec)
        self.session, self.layout, self.input_size = session, layout, size
        self.person = 0
        entry = session.get_inputs()[0]
        self.one_by_one = isinstance(entry.shape[0], int)
        self.dtype = np.float16 if "float16" in entry.type else np.float32

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        if images.requires_grad:
            raise InputError(
                f"{self.spec}: an ONNX model is a black box without gradients: evaluate with it, do not train"
            )
        boxes, classes, objectness, placement = self.decode(images)
        person = classes[..., self.person]
        likeliest = person >= classes.amax(dim=-1)
        scores = person if objectness is None else person * objectness
        return Detections(placement.restore(boxes), scores, objectness, None if objectness is None else likeliest)

    @torch.no_grad()
    def decode(self, images: Float[Tensor, "B 3 H W"]) -> tuple[Tensor, Tensor, Tensor | None, Placement]:
        """Boxes [B, N, 4] in input pixels, class probabilities [B, N, K], objectness [B, N] or None."""
        inputs, placement = self._prepare(images)
        array = inputs.cpu().numpy().astype(self.dtype)
        chunks = [array[i : i + 1] for i in range(len(array))] if self.one_by_one else [array]
        name = self.session.get_inputs()[0].name
        runs = [self.session.run(None, {name: chunk}) for chunk in chunks]
        outputs = [torch.from_numpy(np.concatenate(parts)).float() for parts in zip(*runs, strict=True)]
        boxes, classes, objectness = LAYOUTS[self.layout](outputs, self.input_size)
        device = images.device
        return boxes.to(device), classes.to(device), None if objectness is None else objectness.to(device), placement

    def _prepare(self, images: Tensor) -> tuple[Tensor, Placement]:
        if self.layout == "detr":
            inputs, placement = fit(images, self.input_size)
            mean, std = (torch.tensor(v, device=images.device)[:, None, None] for v in IMAGENET)
            return (inputs - mean) / std, placement
        inputs, placement = fit(images, self.input_size, letterbox=True, fill=GREY)
        return (inputs.flip(1) * 255 if self.layout == "yolox" else inputs), placement  # YOLOX: BGR, 0..255


def load_onnx(request: Request) -> OnnxDetector:
    """A detector from an ONNX file. The layout is one of LAYOUTS; without one it is told from the outputs if possible.

    Class names come from the file's own metadata ("names", as YOLOv8 exports have it) or as for Darknet; input size
    from the file, else the one asked for, else 640. InputError names what is missing or ambiguous.
    """
    require("onnxruntime", request.spec)
    name, named = (*request.parts, "")[:2]
    if named and request.layout:
        raise InputError(f"detector {request.spec!r}: names its layout already; drop --layout")
    file = Path(name).expanduser()
    digest = hashlib.sha256(read_bytes(file)).digest()
    session = _session(file)
    shape = session.get_inputs()[0].shape
    if len(shape) != 4 or (isinstance(shape[1], int) and shape[1] != 3):
        raise InputError(f"{file}: its input {shape} is not a batch of RGB images")
    layout = request.layout or named or _guess(session, file)
    if layout not in LAYOUTS:
        raise InputError(f"detector {request.spec!r}: unknown layout {layout!r}; known are {', '.join(LAYOUTS)}")
    size = _size(shape, request.input_size, file)
    detector = OnnxDetector(session, layout, size, file.stem, request.spec)
    detector.register_buffer("digest", torch.tensor(list(digest), dtype=torch.uint8))  # for `state_hash`
    try:
        count = detector.decode(torch.zeros(1, 3, *size))[1].shape[-1]
    except (RuntimeError, IndexError, ValueError) as error:  # what tensors of another shape end in
        shapes = [output.shape for output in session.get_outputs()]
        raise InputError(f"{file}: its outputs {shapes} are not laid out as {layout}") from error
    detector.person = _person(session, file, count, request.person)
    detector.source = {"layout": detector.layout, "input_size": list(detector.input_size), "person": detector.person}
    detector.packages = ("onnxruntime",)
    detector.freeze()
    return detector


def _session(file: Path) -> "onnxruntime.InferenceSession":
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    options.intra_op_num_threads = torch.get_num_threads()
    try:
        return onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has a class of its own for each kind of broken file
        raise InputError(
            f"{file}: not an ONNX model that onnxruntime can run ({str(error).splitlines()[0][:160]})"
        ) from error


def _guess(session, file: Path) -> str:
    outputs = session.get_outputs()
    shapes = [output.shape for output in outputs]
    if len(outputs) >= 2 and any(shape[-1] == 4 for shape in shapes):
        return "detr"
    first = shapes[0]
    if len(first) == 3 and isinstance(first[1], int) and isinstance(first[2], int) and first[1] < first[2]:
        return "yolov8"
    raise InputError(f"{file}: outputs {shapes} fit several layouts; say onnx:FILE:LAYOUT ({', '.join(LAYOUTS)})")


def _size(shape: list, wanted: tuple[int, int] | None, file: Path) -> tuple[int, int]:
    fixed = (shape[2], shape[3])
    if not all(isinstance(side, int) for side in fixed):
        return wanted or (DEFAULT_SIDE, DEFAULT_SIDE)
    if wanted is not None and wanted != fixed:
        raise InputError(
            f"{file}: its input is fixed to {fixed[0]}x{fixed[1]}, it cannot run at {wanted[0]}x{wanted[1]}"
        )
    return fixed


def _person(session, file: Path, count: int, person_class: str) -> int:
    stored = session.get_modelmeta().custom_metadata_map.get("names")
    names = None
    if stored:
        try:
            parsed = ast.literal_eval(stored)
            names = tuple(str(parsed[i]) for i in range(count))
        except (ValueError, SyntaxError, KeyError, IndexError, TypeError):
            names = None
    if names is None:
        names = names_beside(file, count)
    if names is None and count in COCO_91 and person_class == "person":
        return 1
    return person_index(names, person_class, count, str(file))


def _corners(boxes: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 4"]:
    """Centre and size to corners."""
    half = boxes[..., 2:] / 2
    return torch.cat([boxes[..., :2] - half, boxes[..., :2] + half], dim=-1)
