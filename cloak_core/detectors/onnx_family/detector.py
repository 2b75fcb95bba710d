"""`onnx:FILE[:LAYOUT]`: an ONNX file as a detector that can be trained against, or else as a black box."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.detectors.classes import COCO_IDS, names_beside, person_index
from cloak_core.detectors.decoding import Decoded
from cloak_core.detectors.onnx_family.channels import order_channels
from cloak_core.detectors.onnx_family.end_to_end import before_choice
from cloak_core.detectors.onnx_family.guessing import guess_layout, is_classifier, what_it_may_be
from cloak_core.detectors.onnx_family.layouts import LAYOUTS, Decode
from cloak_core.detectors.onnx_family.model_file import ModelFile, read_model, read_proto
from cloak_core.detectors.onnx_family.networks import (
    Converted,
    NotConvertible,
    Session,
    as_input,
    node_that_mixes,
    prepared,
    to_torch,
)
from cloak_core.detectors.onnx_family.parity import Parity, compare, remembered, takes_batches
from cloak_core.detectors.onnx_family.weights import NotTrainable, TrainableWeights
from cloak_core.detectors.pixels import YOLO_GREY, PixelFormat, fit
from cloak_core.detectors.specs import Request
from cloak_core.detectors.verification.comparing import sample_images
from cloak_core.files.errors import InputError, first_line

if TYPE_CHECKING:
    import onnx

END_TO_END = "end2end"
CHOSEN_ALONE = "only the boxes that the file chooses have a gradient"
COCO_91 = (90, 91, 92)
"""Numbers of classes of exports that count COCO's own ids, where "nothing" may be among them."""
PACKAGES = ("onnx", "onnx2torch", "onnxruntime")
_log = logging.getLogger("cloak")


class OnnxDetector(Detector):
    """A network from an ONNX file: a torch module where conversion succeeded, else an onnxruntime session."""

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
        self.opset = 0
        self.black_box = ""
        """Why it is one; "" for a network that was converted."""
        self.untranslated: Sequence[dict[str, object]] = ()
        """Operators that made it one: {"op", "version", "node"} of each."""

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        if images.requires_grad and not self.differentiable:
            raise InputError(f"{self.spec}: a black box without gradients: evaluate with it, do not train")
        inputs, placement = fit(images, self.input_size, self.letterbox, self.fill)
        found = self.answer(self.pixels.apply(inputs))
        return found.of_person(self.person, placement, self.first_class)

    def original(self) -> OnnxDetector | None:
        """Load the file into onnxruntime; None for a black box, which runs there already."""
        if not self.differentiable:
            return None
        file = read_model(self.path)
        if file.digest != self.source["file"]:
            raise InputError(f"{self.path}: changed since it was loaded")
        if self.source["layout"] == END_TO_END:
            file = before_choice(file, self.input_size)
        session = Session(file.session(torch.get_num_threads()), file)
        made = OnnxDetector(session, self.decode, self.input_size, self.pixels, self.letterbox, self.spec)
        made.person, made.path, made.source = self.person, self.path, self.source
        made.first_class, made.class_names = self.first_class, self.class_names
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
    name, named = (*request.parts, "")[:2]
    if named and request.layout:
        raise InputError(f"detector {request.spec!r}: names its layout already; drop --layout")
    file = read_model(Path(name).expanduser())
    size = file.input_size(request.input_size)
    if (request.layout or named or END_TO_END) == END_TO_END:
        file = before_choice(file, size)
    try:
        model = _prepared(file)
        detector = _assemble(request, named, file, _converted(file, model, size, request.fold))
        _compare(detector, file, request.fold)
        if detector.partial_gradient and request.fold:
            _log.warning("%s: %s; its graph shows no others", file.path, detector.partial_gradient)
        if not request.fold:
            if detector.partial_gradient:
                raise NotTrainable(f"{file.path}: its graph chooses boxes itself, and {CHOSEN_ALONE}")
            detector.weights = TrainableWeights(detector.network.graph, model, read_proto(file.path)[0])
    except NotConvertible as error:
        if not request.fold:
            raise NotTrainable(f"{file.path}: its weights cannot be trained: {error}") from None
        session = Session(file.session(torch.get_num_threads()), file)
        detector = _assemble(request, named, file, session)
        session.one_by_one |= not takes_batches(session, detector.pixels.apply(sample_images(size)))
        detector.black_box, detector.untranslated = str(error), error.untranslated
        words = "%s: a black box, good for evaluation alone: %s; to train against it, %s"
        _log.warning(words, file.path, error, error.way)
    return detector.freeze()


def _prepared(file: ModelFile) -> onnx.ModelProto:
    """Copy the file's model as it can be converted. NotConvertible: it cannot."""
    if file.quantised:
        raise NotConvertible(f"it computes in integers ({', '.join(file.quantised)})", "export it without quantising")
    if file.suppresses:
        why = f"it suppresses boxes itself (node {file.suppresses}), and what it cuts has no gradient"
        raise NotConvertible(why, "export it without (nms=False)")
    return prepared(file.model)


def _converted(file: ModelFile, model: onnx.ModelProto, size: tuple[int, int], fold: bool) -> Converted:
    """Convert a prepared model to a torch module; without folding, every weight of it is one of the file's."""
    graph = to_torch(model, fold)
    for tensor in (*graph.parameters(), *graph.buffers()):
        if tensor.dim() == 4:
            tensor.data = tensor.data.contiguous(memory_format=torch.channels_last)
    try:
        order_channels(graph, as_input(sample_images(size)[:1], file), weights=fold)
    except Exception as error:  # onnx2torch's modules fail in their own ways
        raise _fails(error) from None
    return Converted(graph, file, one_by_one=file.batch is not None)


def _fails(error: Exception) -> NotConvertible:
    return NotConvertible(f"it fails in torch ({type(error).__name__}: {first_line(error)[:120]})")


def _assemble(request: Request, named: str, file: ModelFile, network: Converted | Session) -> OnnxDetector:
    """Make a detector of a network: its layout, its person, its operating point."""
    size = file.input_size(request.input_size)
    outputs = _first_outputs(file, network, size)
    layout_name, decode = _layout(request, named, file, outputs, size)
    layout = LAYOUTS[layout_name]
    letterbox = request.letterbox or (layout.letterbox and not request.stretch)
    pixels, said = request.pixels or file.described.pixels, file.confidence or file.described.confidence
    detector = OnnxDetector(network, decode, size, pixels or layout.pixels, letterbox, request.spec)
    detector.name, detector.pixels_assumed = file.path.stem, pixels is None
    detector.path, detector.opset = file.path, file.opset
    if layout_name == END_TO_END and not file.before_choice and detector.differentiable:
        detector.partial_gradient = CHOSEN_ALONE
    count = len(file.names) if layout_name == END_TO_END and file.names else decode(outputs, size).classes.shape[-1]
    detector.class_names = _names(file, count)
    # Among 91 and more of COCO's own numbering the first is nothing.
    detector.first_class = int(detector.class_names is COCO_IDS and count != COCO_91[0])
    detector.person = chosen_person(request, detector.class_names, file.described.person, count, file.path)
    detector.operating_point = request.confidence or said or layout.confidence
    detector.operating_point_assumed = not (request.confidence or said)
    options = {"layout": layout_name, "pixels": repr(detector.pixels), "letterbox": letterbox}
    detector.source = {"file": file.digest, "input_size": list(size), "person": detector.person} | options
    detector.packages = PACKAGES
    return detector


@torch.no_grad()
def _first_outputs(file: ModelFile, network: Converted | Session, size: tuple[int, int]) -> list[Tensor]:
    """Run the network on one sample image."""
    try:
        return network(sample_images(size)[:1])
    except InputError as error:
        raise InputError(f"{file.path}: {error}") from None
    except Exception as error:  # of onnx2torch's modules, or onnxruntime's own
        if isinstance(network, Converted):
            raise _fails(error) from None
        raise _does_not_run(file, size, error) from None


def _does_not_run(file: ModelFile, size: tuple[int, int], error: Exception) -> InputError:
    return InputError(f"{file.path}: does not run at {size[0]}x{size[1]} ({first_line(error)[:160]})")


def _layout(
    request: Request, named: str, file: ModelFile, outputs: list[Tensor], size: tuple[int, int]
) -> tuple[str, Decode]:
    """Find the layout's name, and what decodes such outputs."""
    labelled = dict(zip(file.output_names, outputs, strict=True))
    name = request.layout or named or (END_TO_END if file.before_choice else "")
    name = name or guess_layout(labelled, size, file.names and len(file.names))
    if not name and file.described.layout in LAYOUTS:
        name = file.described.layout
    shapes = ", ".join(f"{label} {list(output.shape)}" for label, output in labelled.items())
    if not name and is_classifier(labelled, file.suppresses):
        raise InputError(f"{file.path}: not a detector: one output, {shapes}")
    if not name:
        known, guess = ", ".join(LAYOUTS), what_it_may_be(labelled, file.suppresses)
        words = f"{file.path}: outputs {shapes} are of no known layout{guess and f'; {guess}'}"
        raise InputError(f"{words}; say onnx:FILE:LAYOUT ({known})")
    if name not in LAYOUTS:
        raise InputError(f"detector {request.spec!r}: unknown layout {name!r}; known are {', '.join(LAYOUTS)}")
    try:
        decode = LAYOUTS[name].decoder(outputs)
        decode(outputs, size)
    except (RuntimeError, IndexError, ValueError) as error:  # what tensors of another shape end in
        raise InputError(f"{file.path}: its outputs {shapes} are not laid out as {name}") from error
    return name, decode


def _compare(detector: OnnxDetector, file: ModelFile, fold: bool) -> None:
    """Compare a converted network with onnxruntime. NotConvertible: they disagree.

    Where only batches go wrong its images are run one by one, and a line names the node.
    """
    size, decode, converted = detector.input_size, detector.decode, detector.network
    images = detector.pixels.apply(sample_images(size))

    def look() -> Parity:
        session = Session(file.session(torch.get_num_threads()), file)
        try:
            return compare(lambda x: decode(converted(x), size), lambda x: decode(session(x), size), images)
        except InputError:
            raise
        except Exception as error:  # onnxruntime's own, where it finds a file wrong that torch runs
            raise _does_not_run(file, size, error) from None

    settled = decode if is_dataclass(decode) else ""  # what a layout found out; functions have no words that last
    parity = remembered(f"{detector.source} {settled}{'' if fold else ' as it is'}", look)
    if parity.why or not parity.agrees:
        raise NotConvertible(parity.why or _disagreement(parity))
    if not parity.takes_batches:
        converted.one_by_one = True
        node = node_that_mixes(converted.graph, images[:2])
        place = f" at node {node}" if node else ""
        _log.warning("%s: a batch goes wrong in it%s; its images are run one by one", file.path, place)


def _disagreement(parity: Parity) -> str:
    if parity.same and parity.gradient is None:
        return "its scores have no finite gradient in the image"
    if parity.same:
        return f"its gradient is {parity.gradient:.0%} off a finite difference"
    figures = f"scores by {parity.scores:.1e}, boxes by {parity.boxes_px:.2f} px"
    return f"converted to torch it answers otherwise than in onnxruntime ({figures})"


def _names(file: ModelFile, count: int) -> tuple[str, ...] | None:
    """Find names of its classes: the file's own, its description's, of a list beside it, or COCO's by their number."""
    for said in (file.names, file.described.names):
        if said and len(said) == count:
            return said
    names = names_beside(file.path, count)
    if names is None and count in COCO_91:
        return COCO_IDS if count != COCO_91[0] else COCO_IDS[1:]
    return names


def chosen_person(
    request: Request, names: tuple[str, ...] | None, said: int | None, count: int | None, path: Path
) -> int:
    """Find the class asked for, else the described one (`said`), else the only or first one of a file without names.

    count: of its classes; None where its outputs do not say.
    """
    if request.person_class is None and said is not None and (count is None or said < count):
        return said
    if request.person_class is None and names is None and count in (None, 1):
        return 0
    return person_index(names, request.person, count or len(names or ()) or COCO_91[1], str(path))
