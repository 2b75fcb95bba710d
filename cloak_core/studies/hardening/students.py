"""From a spec to a student: how the detectors of each family learn, and how they are written."""

from __future__ import annotations

import hashlib
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torchvision.models.detection import FCOS
from torchvision.models.detection.rpn import concat_box_prediction_layers
from torchvision.models.detection.ssd import SSD

from cloak_core.core.detector.protocol import at_least_float32
from cloak_core.detectors.classes import COCO, UNDERSTOOD, VOC, Description, names_beside
from cloak_core.detectors.darknet.cfg import read_cfg_text
from cloak_core.detectors.darknet.detector import BUILTIN_CFG, DarknetDetector
from cloak_core.detectors.darknet.layers import BatchNorm
from cloak_core.detectors.darknet.weights import write_darknet
from cloak_core.detectors.decoding import AnchorBoxes
from cloak_core.detectors.families import FAMILIES
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.onnx_family.detector import OnnxDetector
from cloak_core.detectors.onnx_family.model_file import read_model, read_proto
from cloak_core.detectors.onnx_family.weights import NotTrainable
from cloak_core.detectors.pixels import YOLO_GREY, fit
from cloak_core.detectors.python_module import PythonDetector
from cloak_core.detectors.specs import parse_spec
from cloak_core.detectors.torchvision_family import (
    DenseDetector,
    TorchvisionDetector,
    TwoStageDetector,
    write_torchvision,
)
from cloak_core.detectors.ultralytics_family.checkpoint import write_ultralytics
from cloak_core.detectors.ultralytics_family.detector import UltralyticsDetector
from cloak_core.detectors.ultralytics_family.heads import AnchorHead, DenseHead, distances, rows
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.files.writing import replace_file, write_bytes, write_json, write_text
from cloak_core.studies.hardening.answers import Answer, Maps, Stages, Surer, answer_of, in_the_order_of
from cloak_core.studies.hardening.student import NAME, TRAINABLE, Student

SOURCE = "harden the weights that it was exported from (a .pt or .pth), export those, and assess both"
"""What to do with a file whose weights cannot be trained."""
PROPOSALS = 128
"""Proposals per image: the second stages of teacher and student both judge the teacher's best ones."""


def open_student(spec: str, device: str | torch.device = "cpu") -> Student:
    """Open a detector that is to learn. InputError: one that cannot be read, or whose weights are not in reach."""
    family = parse_spec(spec).family
    if family not in TRAINABLE:
        if family not in FAMILIES:
            load_detector(spec, device=device)  # refuses it, with the spec that was meant
        known = f"{', '.join(TRAINABLE[:-1])} and {TRAINABLE[-1]}"
        raise InputError(f"harden {spec}: cannot train {family!r}, only {known}; {SOURCE}")
    try:
        detector = load_detector(spec, device=device, fold=False)
    except NotTrainable as error:
        raise InputError(f"harden {error}; {SOURCE}") from None
    return STUDENTS[family](detector, load_detector(spec, device=device), spec)


class DarknetStudent(Student):
    """The built-in detector or any .cfg and .weights, by the terms of YOLO's own loss."""

    files = (".cfg", ".weights")
    lr = 1e-3

    def __init__(self, detector: DarknetDetector, teacher: DarknetDetector, spec: str) -> None:
        super().__init__(detector, teacher, spec)
        _usual_epsilon(detector.network)
        detector.network.to(memory_format=torch.channels_last)  # twice as fast to learn, most of it in max pooling
        detector.memory_format = torch.channels_last
        own = self.request.family == "builtin"
        cfg = BUILTIN_CFG if own else Path(self.request.parts[0]).expanduser()
        self.cfg = read_cfg_text(cfg)
        self.class_names = () if own else names_beside(cfg, teacher.network.heads[0].classes) or ()
        """Where a file beside the cfg says them; none where their number does."""

    def answer(self, detector: DarknetDetector, images: Float[Tensor, "B 3 H W"]) -> Maps:
        inputs, _ = fit(images, detector.network.input_size, detector.letterbox)
        with self.autocast(images):
            raw = detector.network(inputs.contiguous(memory_format=detector.memory_format))
        return Maps(detector.network.heads, raw)

    def save(self, stem: Path, seen: int) -> str:
        write_darknet(self.cfg, self.network, stem, seen)
        if self.class_names:
            write_text(stem.with_suffix(".names"), "\n".join(self.class_names) + "\n")
        if self.request.family == "builtin":
            return f"builtin:{stem}.weights{self.options}"
        return f"darknet:{stem}.cfg:{stem}.weights{self.options}"


@torch.no_grad()
def _usual_epsilon(network: nn.Module) -> None:
    """Batch norm of the original Darknet's files adds its epsilon outside the root; what we write adds it inside, so
    that the scale takes up the difference."""
    for norm in network.modules():
        if isinstance(norm, BatchNorm) and norm.epsilon_outside:
            scale, _ = norm.scale_and_shift()
            norm.weight.copy_(scale * (norm.running_var.double() + norm.eps).sqrt())
            norm.epsilon_outside = False


class UltralyticsStudent(Student):
    """A network with a box at every cell, and original YOLOv5 pickles; every cell of every branch learns.

    InputError: RT-DETR, whose queries stand in no order.
    """

    files = (".pt",)

    def __init__(self, detector: UltralyticsDetector, teacher: UltralyticsDetector, spec: str) -> None:
        super().__init__(detector, teacher, spec)
        self.head = detector.network.model[-1]
        if not isinstance(self.head, DenseHead | AnchorHead):
            raise InputError(f"harden {spec}: cannot train RT-DETR, only networks with a box at every cell")

    def answer(self, detector: UltralyticsDetector, images: Float[Tensor, "B 3 H W"]) -> Answer | Maps:
        inputs, _ = fit(images, detector.input_size, detector.letterbox, YOLO_GREY)
        with self.autocast(images):
            raw = detector.network(inputs)
        if isinstance(self.head, AnchorHead):  # in each box places and sizes, objectness, classes, as Darknet has them
            classes = raw[0].shape[1] // self.head.anchors.shape[1] - 5
            return Maps([AnchorBoxes(level, classes) for level in self.head.anchors.tolist()], raw)
        boxes = torch.cat([distances(box) for box, _ in raw], dim=1)
        return Answer(torch.cat([rows(kind) for _, kind in raw], dim=1), boxes.unsqueeze(2))

    def save(self, stem: Path, seen: int) -> str:
        path = stem.with_suffix(".pt")
        write_ultralytics(path, self.network, Path(self.request.what).expanduser())
        return f"ultralytics:{path}{self.options}"


class OnnxStudent(Student):
    """A converted graph, box by box; where it chooses among its boxes, each learns from the teacher's most like it.

    The trained weights go back into the file's own graph. Normalisations that the file has folded into its convolutions
    stay folded and learn with them.
    """

    files = (".onnx",)
    corners = True

    def answer(self, detector: OnnxDetector, images: Float[Tensor, "B 3 H W"]) -> Answer:
        """Read every box of a detector's outputs: scores of all classes, as its runtimes report them."""
        inputs, _ = fit(images, detector.input_size, detector.letterbox, detector.fill)
        with self.autocast(images):
            decoded = detector.answer(detector.pixels.apply(inputs))
        return answer_of(decoded.scores, decoded.boxes)

    def matched(self, answer: Answer, wanted: Answer) -> Answer:
        return in_the_order_of(answer, wanted) if self.detector.weights.chooses else wanted

    def save(self, stem: Path, seen: int) -> str:
        """See `Student.save`. InputError: the file that was begun with is there no more, or has changed."""
        path, target = self.detector.path, stem.with_suffix(".onnx")
        original, digest = read_proto(path)
        if digest != self.teacher.source["file"]:
            raise InputError(f"{path}: changed since it was loaded; the hardened weights are in the checkpoint")
        self.detector.weights.write_into(original)
        data = original.SerializeToString()
        write_bytes(target, data)
        self._describe(target, {"file": target.name, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()})
        layout = ":".join(self.request.parts[1:])
        return f"onnx:{target}{layout and f':{layout}'}{self.options}"

    @property
    def licence(self) -> str:
        words = read_model(self.detector.path).first("licence")
        return words or f"unknown; {self.detector.path.name} does not say, ask those who made it"

    def _describe(self, target: Path, facts: dict[str, object]) -> None:
        """Write beside the new file its facts, with what was said beside the old one and holds on, or names of classes.

        What was measured of the old file is left out.
        """
        file, described = read_model(self.detector.path), self.detector.path.with_suffix(".json")
        if file.said[1] != Description():
            holds = {key: value for key, value in read_json(described).items() if key in UNDERSTOOD}
            write_json(target.with_suffix(".json"), facts | {"made_from": self.spec} | holds)
        names = self.detector.class_names
        if names and not file.first("names"):
            beside = names_beside(self.detector.path, len(names))
            if beside == names and names not in (COCO, VOC):
                write_text(target.with_suffix(".names"), "\n".join(names) + "\n")


LOADER = '''"""{function}() of {file} with the hardened weights beside this file."""

import importlib.util
from pathlib import Path

import torch

WEIGHTS = Path(__file__).parent / "{weights}"
MODULE = {file!r}


def {function}() -> torch.nn.Module:
    """Make the network and load the hardened weights into it."""
    spec = importlib.util.spec_from_file_location("unhardened", MODULE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    network = module.{function}()
    network.load_state_dict(torch.load(WEIGHTS, weights_only=True))
    return network
'''


class PythonStudent(Student):
    """A torch module that answers the same boxes in the same order whatever its weights are.

    InputError: another runtime runs it, or no gradient reaches its parameters.
    """

    files = (".py", ".pth")
    corners = True

    def __init__(self, detector: PythonDetector, teacher: PythonDetector, spec: str) -> None:
        super().__init__(detector, teacher, spec)
        if not detector.differentiable or not list(detector.module.parameters()):
            raise InputError(f"harden {spec}: its module has no parameters that torch could train")
        side = max(detector.input_size or (64, 64))
        detector.requires_grad_(True)
        with torch.enable_grad():
            scores = detector.detect(torch.rand(1, 3, side, side, device=detector.device)).scores
        detector.requires_grad_(False)
        if not scores.requires_grad:
            raise InputError(f"harden {spec}: no gradient of its scores reaches its parameters")

    @property
    def network(self) -> nn.Module:
        return self.detector.module

    def answer(self, detector: PythonDetector, images: Float[Tensor, "B 3 H W"]) -> Answer:
        # The teacher's precision is its own.
        half = detector.precision == "bfloat16"
        with torch.autocast(images.device.type, torch.bfloat16, enabled=half):
            detections = detector.detect(images)
        scores = [detections.scores] if detections.other is None else [detections.scores, detections.other]
        return answer_of(torch.stack(scores, dim=-1), detections.boxes)

    def matched(self, answer: Answer, wanted: Answer) -> Answer:
        if answer.boxes.shape != wanted.boxes.shape:
            raise InputError(
                f"harden {self.spec}: answers other numbers of boxes for other weights; return them all, unsuppressed"
            )
        return wanted

    def save(self, stem: Path, seen: int) -> str:
        file, function = self.request.parts
        weights = {name: value.detach().cpu().contiguous() for name, value in self.network.state_dict().items()}
        replace_file(stem.with_suffix(".pth"), lambda stream: torch.save(weights, stream))
        path = str(Path(file).expanduser().absolute())
        write_text(stem.with_suffix(".py"), LOADER.format(function=function, file=path, weights=f"{NAME}.pth"))
        return f"python:{stem.with_suffix('.py')}:{function}{self.options}"


class TorchvisionStudent(Student):
    """RetinaNet, FCOS, SSD and SSDlite; Faster, Mask and Keypoint R-CNN, whose masks and keypoints do not learn.

    It learns by the terms of the models' own losses at every anchor and proposal. These losses in training mode would
    want labels, draw anchors and proposals at random and let batch norm move; between two networks none of that is
    wanted, and the terms are 0 before anything was learned.
    """

    files = (".pth",)

    def __init__(self, detector: TorchvisionDetector, teacher: TorchvisionDetector, spec: str) -> None:
        super().__init__(detector, teacher, spec)
        exclusive = isinstance(detector, TwoStageDetector) or isinstance(detector.model, SSD)
        # FCOS' score is the root of the product.
        root = isinstance(detector.model, FCOS)
        found_at = detector.operating_point**2 if root else detector.operating_point
        self.reading = self.reading._replace(softmax=exclusive, found_at=found_at)

    @property
    def network(self) -> nn.Module:
        return self.detector.model

    def save(self, stem: Path, seen: int) -> str:
        name = self.request.parts[0]
        write_torchvision(stem.with_suffix(".pth"), name, self.detector.model)
        return f"torchvision:{name}:{stem}.pth{self.options}"

    def answer(
        self,
        detector: DenseDetector | TwoStageDetector,
        images: Float[Tensor, "B 3 H W"],
        proposals: list[Float[Tensor, "_ 4"]] | None = None,
    ) -> Answer | Stages:
        """Ask the network. A second stage judges these proposals, or the network's own best where none are given."""
        with self.autocast(images):
            batch, _ = detector.prepare(images)
            if isinstance(detector, DenseDetector):
                outputs, _ = detector.raw(batch)
                trust = outputs["bbox_ctrness"][..., 0] if "bbox_ctrness" in outputs else None
                return Answer(outputs["cls_logits"], outputs["bbox_regression"].unsqueeze(2), trust)
            features = detector.features(batch)
            logits, deltas = detector.of_anchors(features)
            if proposals is None:
                proposals = [best[:PROPOSALS] for best in detector.propose(batch, features, logits, deltas)]
            kinds, boxes = detector.of_proposals(batch, features, proposals)
        objects, corners = map(at_least_float32, concat_box_prediction_layers(logits, deltas))
        count = len(images)
        anchors = Answer(objects.view(count, -1, 1), corners.view(count, -1, 1, 4))
        return Stages(anchors, proposals, Answer(kinds.unsqueeze(1), boxes.unsqueeze(1)))

    def distance(
        self, images: Float[Tensor, "B 3 H W"], wanted: Answer | Stages, surer: Surer | None = None
    ) -> Float[Tensor, " B"]:
        answer = self.answer(self.detector, images, getattr(wanted, "proposals", None))
        return answer.distance(wanted, self.reading, surer)


STUDENTS: dict[str, type[Student]] = {
    "builtin": DarknetStudent,
    "darknet": DarknetStudent,
    "onnx": OnnxStudent,
    "python": PythonStudent,
    "torchvision": TorchvisionStudent,
    "ultralytics": UltralyticsStudent,
}
"""By family, one for each of TRAINABLE."""
