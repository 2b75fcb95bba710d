"""Networks' files as detectors; `onnx:FILE[:LAYOUT]`, one that can be trained against, or else a black box."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.detectors.classes import COCO_IDS, names_beside, person_index, read_names
from cloak_core.detectors.decoding import Decoded
from cloak_core.detectors.onnx_family.decoders import Decode
from cloak_core.detectors.onnx_family.end_to_end import before_choice
from cloak_core.detectors.onnx_family.layouts import (
    END_TO_END,
    LAYOUTS,
    Layout,
    guess_layout,
    why_unknown,
)
from cloak_core.detectors.onnx_family.model_file import ModelFile, NetworkFile, read_model, read_proto
from cloak_core.detectors.onnx_family.networks import (
    BlackBox,
    Converted,
    NotConvertible,
    Session,
    Verdict,
    as_input,
    compare,
    prepared,
    remembered,
    takes_batches,
    to_torch,
)
from cloak_core.detectors.onnx_family.plainer import order_channels
from cloak_core.detectors.onnx_family.weights import NotTrainable, TrainableWeights
from cloak_core.detectors.pixels import YOLO_GREY, PixelFormat, fit
from cloak_core.detectors.specs import Request
from cloak_core.detectors.verification.comparing import sample_images
from cloak_core.files.errors import InputError, first_line

CHOSEN_ALONE = "only the boxes that the file chooses have a gradient"
WIDEST_ROW = 7
"""Numbers of a box that is left after suppression, at most: image, class, score and corners."""
COCO_91 = (90, 91, 92)
"""Numbers of classes of exports that count COCO's own ids, where "nothing" may be among them."""
PACKAGES = ("onnx", "onnx2torch", "onnxruntime")
_log = logging.getLogger("cloak")


class OnnxDetector(Detector):
    """A network from a file: a torch module where conversion succeeded, else run by the file's own runtime."""

    def __init__(
        self, network: nn.Module, decode: Decode, size: tuple[int, int], pixels: PixelFormat, letterbox: bool, spec: str
    ) -> None:
        super().__init__("onnx", spec)
        self.network, self.decode, self.input_size = network, decode, size
        self.pixels, self.letterbox = pixels, letterbox
        self.pixels_assumed, self.fill = True, YOLO_GREY
        self.differentiable = isinstance(network, Converted)
        self.person, self.first_class = 0, 0
        self.path = Path(spec)
        self.weights: TrainableWeights | None = None
        """Of a network that was loaded as it is, to be trained."""
        self.opset: int | None = None
        self.black_box = ""
        """Why an ONNX file is one; "" for a network that was converted."""
        self.untranslated: Sequence[dict[str, object]] = ()
        """Operators that made it one: {"op", "version", "node"} of each."""

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        if images.requires_grad and not self.differentiable:
            raise InputError(f"{self.spec}: a black box without gradients: evaluate with it, do not train")
        inputs, placement = fit(images, self.input_size, self.letterbox, self.fill)
        return self.answer(self.pixels.apply(inputs)).of_person(self.person, placement, self.first_class)

    def original(self) -> OnnxDetector | None:
        """Load the file into onnxruntime; None for a black box, which runs there already."""
        if not self.differentiable:
            return None
        file = read_model(self.path, self.input_size)
        if file.digest != self.source["file"]:
            raise InputError(f"{self.path}: changed since it was loaded")
        if self.source["layout"] == END_TO_END:
            file = before_choice(file)
        made = OnnxDetector(Session(file), self.decode, self.input_size, self.pixels, self.letterbox, self.spec)
        for name in ("person", "first_class", "class_names", "path", "source", "fill"):
            setattr(made, name, getattr(self, name))
        return made.freeze()

    def answer(self, inputs: Float[Tensor, "B 3 H W"]) -> Decoded:
        """Run the network on its own input and decode the outputs."""
        return self.decode(self.network(inputs), self.input_size)


def load_onnx(request: Request) -> OnnxDetector:
    """Load an ONNX file; its layout is one of LAYOUTS, told from the outputs where it is not given.

    The file is converted to torch, and what came of it is compared with onnxruntime at the first loading; where that
    fails it stays a black box, and a line says why. Class names, input size and confidence come from the file's own
    metadata, else class names as for Darknet. InputError names what is missing or ambiguous; with `fold` False also why
    the file cannot be converted.
    """
    path, named = file_and_layout(request)
    file = read_model(path, request.input_size)
    if named in ("", END_TO_END):
        file = before_choice(file)
    try:
        detector = _white_box(request, file)
    except NotConvertible as error:
        if not request.fold:
            raise NotTrainable(f"{file.path}: its weights cannot be trained: {error}") from None
        session = Session(file)
        detector = assemble(request, file, session)
        if not session.one_by_one:
            images = detector.pixels.apply(sample_images(file.size))
            alone = [detector.answer(image) for image in images.split(1)]
            session.one_by_one = not takes_batches(detector.answer, alone, images)
        detector.black_box, detector.untranslated = str(error), error.untranslated
        words = "%s: a black box, good for evaluation alone: %s; to train against it, %s"
        _log.warning(words, file.path, error, error.way)
    detector.opset, detector.packages = file.opset, PACKAGES
    return detector.freeze()


def file_and_layout(request: Request) -> tuple[Path, str]:
    """Find which file a spec names, and its layout; "" for none."""
    name, layout = (*request.parts, "")[:2]
    return Path(name).expanduser(), layout


def _white_box(request: Request, file: ModelFile) -> OnnxDetector:
    """Convert a file to torch and compare it with onnxruntime. NotConvertible: it cannot be, or they disagree.

    Without folding, every weight of it is one of the file's, and NotTrainable says why none can be trained.
    """
    if file.quantised:
        raise NotConvertible(f"it computes in integers ({', '.join(file.quantised)})", "export it without quantising")
    if file.suppresses:
        why = f"it suppresses boxes itself (node {file.suppresses}), and what it cuts has no gradient"
        raise NotConvertible(why, "export it without (nms=False)")
    model = prepared(file.model)
    graph = to_torch(model, request.fold)
    for tensor in (*graph.parameters(), *graph.buffers()):
        if tensor.dim() == 4:
            tensor.data = tensor.data.contiguous(memory_format=torch.channels_last)
    try:
        order_channels(graph, as_input(sample_images(file.size)[:1], file), weights=request.fold)
    except Exception as error:  # onnx2torch's modules fail in their own ways
        raise _fails(error) from None
    detector = assemble(request, file, Converted(graph, file, one_by_one=file.batch is not None))
    if detector.source["layout"] == END_TO_END and file.layout is None:
        detector.partial_gradient = CHOSEN_ALONE
    _compare(detector, file, request.fold)
    if request.fold and detector.partial_gradient:
        _log.warning("%s: %s; its graph shows no others", file.path, detector.partial_gradient)
    elif detector.partial_gradient:
        raise NotTrainable(f"{file.path}: its graph chooses boxes itself, and {CHOSEN_ALONE}")
    elif not request.fold:
        detector.weights = TrainableWeights(graph, model, read_proto(file.path)[0], file.path)
    return detector


def _fails(error: Exception) -> NotConvertible:
    return NotConvertible(f"it fails in torch ({type(error).__name__}: {first_line(error)[:120]})")


def assemble(request: Request, file: NetworkFile, network: Converted | BlackBox) -> OnnxDetector:
    """Make a detector of a network: its layout, its person, its operating point.

    Each as the spec says, else the file, else the JSON file beside it, else as the layout usually has it. InputError
    names what is missing or ambiguous.
    """
    try:
        with torch.no_grad():
            outputs = network(sample_images(file.size)[:1])
    except InputError as error:
        raise InputError(f"{file.path}: {error}") from None
    except Exception as error:  # of onnx2torch's modules, or the runtime's own
        raise (_fails(error) if isinstance(network, Converted) else _does_not_run(file, error)) from None
    name, layout, decode = _layout(request, file, outputs)
    letterbox = request.letterbox or (layout.letterbox and not request.stretch)
    pixels = request.pixels or file.first("pixels")
    detector = OnnxDetector(network, decode, file.size, pixels or layout.pixels, letterbox, request.spec)
    detector.name, detector.path = file.path.stem, file.path
    detector.pixels_assumed, detector.fill = pixels is None, layout.fill
    count = None if layout.chosen else decode(outputs, file.size).classes.shape[-1]
    detector.class_names = _names(file, layout, count)
    # Among 91 and more of COCO's own numbering the first is nothing.
    detector.first_class = int(detector.class_names is COCO_IDS and count != COCO_91[0])
    detector.person = _person(request, detector.class_names, file, count)
    confidence = request.confidence or file.first("confidence")
    detector.operating_point = confidence or layout.confidence
    detector.operating_point_assumed = not confidence
    options = {"layout": name, "pixels": repr(detector.pixels), "letterbox": letterbox}
    detector.source = {"file": file.digest, "input_size": list(file.size), "person": detector.person} | options
    return detector


def load_black_box(
    request: Request, file: NetworkFile, run: Callable[[np.ndarray], list[np.ndarray]], package: str
) -> OnnxDetector:
    """Make a detector of a file that another runtime runs: `run` takes one image, `package` is the runtime's."""
    detector = assemble(request, file, BlackBox(run, file.digest, file.channels_last, one_by_one=True))
    detector.packages = (package,)
    return detector.freeze()


def _does_not_run(file: NetworkFile, error: Exception) -> InputError:
    return InputError(f"{file.path}: does not run at {file.size[0]}x{file.size[1]} ({first_line(error)[:160]})")


def _layout(request: Request, file: NetworkFile, outputs: list[Tensor]) -> tuple[str, Layout, Decode]:
    """Find the layout, its name, and what decodes such outputs."""
    labelled = zip(file.output_names, outputs, strict=True)
    shapes = ", ".join(f"{label} {list(output.shape)}" for label, output in labelled)
    first = outputs[0].shape
    is_row = len(first) >= 2 and first[0] == 1 and first[1] > WIDEST_ROW and all(side == 1 for side in first[2:])
    if len(outputs) == 1 and is_row and not file.suppresses:  # one thing said of a whole image
        raise InputError(f"{file.path}: not a detector: one output, {shapes}")
    name, layout = file_and_layout(request)[1], None
    if file.layout is not None and name in ("", file.layout[0]):
        name, layout = file.layout
    if not name and file.first("layout") in LAYOUTS:
        name = file.first("layout")
    name = name or guess_layout(outputs, file.size, len(file.first("names") or ())) or ""
    known = ", ".join(LAYOUTS)
    if not name:
        why = why_unknown(outputs, file.suppresses)
        words = f"{file.path}: outputs {shapes} are of no known layout{why and f'; {why}'}"
        raise InputError(f"{words}; say {request.family}:FILE:LAYOUT ({known})")
    layout = layout or LAYOUTS.get(name)
    if layout is None:
        raise InputError(f"detector {request.spec!r}: unknown layout {name!r}; known are {known}")
    try:
        decode = layout.settled(outputs)
        decode(outputs, file.size)
    except (RuntimeError, IndexError, ValueError) as error:  # what tensors of another shape end in
        raise InputError(f"{file.path}: its outputs {shapes} are not laid out as {name}") from error
    return name, layout, decode


def _compare(detector: OnnxDetector, file: ModelFile, fold: bool) -> None:
    """Compare a converted network with onnxruntime. NotConvertible: they disagree.

    Where only batches go wrong its images are run one by one, and a line says so.
    """
    decode, converted = detector.decode, detector.network
    images = detector.pixels.apply(sample_images(file.size))

    def look() -> Verdict:
        session = Session(file)
        try:
            return compare(lambda x: decode(converted(x), file.size), lambda x: decode(session(x), file.size), images)
        except InputError:
            raise
        except Exception as error:  # onnxruntime's own, where it finds a file wrong that torch runs
            raise _does_not_run(file, error) from None

    settled = decode if is_dataclass(decode) else ""  # what a layout found out; functions have no words that last
    verdict = remembered(f"{detector.source} {settled}{'' if fold else ' as it is'}", look)
    if verdict.why_not:
        raise NotConvertible(verdict.why_not)
    if not verdict.takes_batches:
        converted.one_by_one = True
        _log.warning("%s: a batch goes wrong in it; its images are run one by one", file.path)


def _names(file: NetworkFile, layout: Layout, count: int | None) -> tuple[str, ...] | None:
    """Find names of its classes: the file's own, its description's, of a list beside it, or COCO's by their number."""
    for value in file.said:
        if value.names and count in (None, len(value.names)):
            return value.names
    if count is None:
        beside = file.path.with_suffix(".names")
        return read_names(beside) if beside.is_file() else layout.names
    names = names_beside(file.path, count)
    if names is None and count in COCO_91:
        return COCO_IDS if count != COCO_91[0] else COCO_IDS[1:]
    return names


def _person(request: Request, names: tuple[str, ...] | None, file: NetworkFile, count: int | None) -> int:
    """Find the class asked for, else the described one, else the only or first one of a file without names.

    count: of its classes; None where its outputs do not say.
    """
    described = file.first("person")
    if request.person_class is None and described is not None and (count is None or described < count):
        return described
    if request.person_class is None and names is None and count in (None, 1):
        return 0
    return person_index(names, request.person, count or len(names or ()) or COCO_91[1], str(file.path))
