"""`ultralytics:FILE`: a network of ultralytics, or of an original YOLOv5 pickle, as a detector to train against."""

from __future__ import annotations

import copy
import math
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.core.detector.protocol import Detections, Detector, at_least_float32
from cloak_core.detectors.checkpoints import fold_batch_norm, load_state
from cloak_core.detectors.classes import COCO, person_index
from cloak_core.detectors.decoding import Decoded, queries
from cloak_core.detectors.pixels import YOLO_GREY, fit
from cloak_core.detectors.specs import Request, check_size
from cloak_core.detectors.ultralytics_family.architecture import (
    PACKAGE,
    QUERIES,
    SEED,
    build,
    fuse,
    read_architecture,
    settle_batch_norm,
)
from cloak_core.detectors.ultralytics_family.checkpoint import Checkpoint, read_checkpoint
from cloak_core.detectors.ultralytics_family.heads import AnchorHead, DenseHead
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record

CONFIDENCE = 0.25
"""The score above which ultralytics and YOLOv5 report a box unless told otherwise."""
IMAGE_SIZE = 640
SUFFIXES = (".pt", ".yaml", ".yml")


class UltralyticsDetector(Detector):
    """A network whose boxes and scores are all there, before the best are chosen or suppressed."""

    def __init__(
        self, network: nn.Module, size: tuple[int, int], letterbox: bool, person: int, name: str, spec: str
    ) -> None:
        super().__init__(name, spec)
        self.network, self.input_size, self.letterbox, self.person = network, size, letterbox, person
        self.operating_point, self.packages = CONFIDENCE, (PACKAGE,)

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        inputs, placement = fit(images, self.input_size, self.letterbox, YOLO_GREY)
        return self.answer(inputs).of_person(self.person, placement)

    def answer(self, inputs: Float[Tensor, "B 3 H W"]) -> Decoded:
        """Run the network on its own input and decode the outputs."""
        output, head = self.network(inputs), self.network.model[-1]
        if isinstance(head, DenseHead | AnchorHead):
            return head.decode(output)
        # RT-DETR's decoder, before its best are chosen: boxes [1, B, Q, 4], logits [1, B, Q, K] and more.
        boxes, logits = (at_least_float32(part[-1]) for part in output[1][:2])
        return queries(logits, boxes, inputs.shape[2:], exclusive=False)


def load_ultralytics(request: Request) -> UltralyticsDetector:
    """Load a .pt file of ultralytics or of the original YOLOv5, or a .yaml.

    A .yaml is the user's own, or one that ultralytics has, by its name; its weights are random, the same each time.

    Nothing is fetched and no code of a file is run. Batch norm is folded unless told not to. InputError: a file that is
    none of these or wants to run code, a missing package, a network that does not detect, an impossible input size.
    """
    where = request.what
    if Path(where).suffix.lower() not in SUFFIXES:
        raise InputError(f"detector {request.spec!r}: expected a checkpoint (.pt) or a description (.yaml)")
    checkpoint = read_checkpoint(Path(where).expanduser()) if Path(where).suffix.lower() == ".pt" else None
    architecture = checkpoint.architecture if checkpoint else read_architecture(where)
    network = _original(checkpoint) if checkpoint and checkpoint.original else _network(architecture, checkpoint, where)
    if request.fold:
        fuse(network)
        fold_batch_norm(network)
        network = network.to(memory_format=torch.channels_last)
    size = _size(request, checkpoint, int(max(network.stride)))
    # Without names 80 classes are COCO's, and the only one of a network for poses is the person.
    usual = {len(COCO): COCO, 1: ("person",) if "Pose" in architecture["head"][-1][2] else None}
    names = (checkpoint and checkpoint.names) or usual.get(int(architecture["nc"]))
    person = person_index(names, request.person, int(architecture["nc"]), request.what)
    # The package stretches images for RT-DETR and letterboxes them for all others.
    letterbox = request.letterbox or not (request.stretch or architecture["head"][-1][2] == QUERIES)
    detector = UltralyticsDetector(network, size, letterbox, person, Path(where).stem, request.spec)
    detector.class_names = names
    content = {"file": checkpoint.digest} if checkpoint else {"yaml": sha256_record(architecture), "seed": SEED}
    detector.source = content | {"input_size": list(size), "letterbox": letterbox, "person": person}
    return detector.freeze()


def _network(architecture: dict, checkpoint: Checkpoint | None, where: str) -> nn.Module:
    """Build ultralytics' network, the file's weights in it, its head replaced by one that leaves nothing out."""
    network = build(architecture, where)
    if checkpoint is None:
        settle_batch_norm(network)
    else:
        if not any(".bn." in key for key in checkpoint.state):  # saved after its batch norm was folded
            fuse(network)
        load_state(network, checkpoint.state, checkpoint.path)
        _as_in_the_file(network, checkpoint)
    if architecture["head"][-1][2] != QUERIES:
        network.model[-1] = DenseHead(network.model[-1])
    return network


def _original(checkpoint: Checkpoint) -> nn.Module:
    """Build the body of a YOLOv5 network, which ultralytics builds as well, under an anchor head of ours."""
    architecture = copy.deepcopy(checkpoint.architecture)
    source, repeats, name, _ = architecture["head"][-1]
    architecture["head"][-1] = [source, repeats, name, ["nc"]]
    network = build(architecture, str(checkpoint.path))
    last = network.model[-1]
    channels = [int(branch[0].conv.in_channels) for branch in last.cv2]
    head = AnchorHead(checkpoint.anchors, checkpoint.strides, channels, int(architecture["nc"]), (last.f, last.i))
    network.model[-1], network.stride = head, torch.tensor(checkpoint.strides)
    prefix = f"model.{last.i}."
    state = {key: value for key, value in checkpoint.state.items() if key != f"{prefix}anchor_grid"}
    load_state(network, state | {f"{prefix}anchors": checkpoint.anchors}, checkpoint.path)
    _as_in_the_file(network, checkpoint)
    return network


def _as_in_the_file(network: nn.Module, checkpoint: Checkpoint) -> None:
    """Take over what weights do not say: batch norm's epsilon; check that activations are the file's.

    InputError: another activation or pooling in the file than in the network built, as early versions had.
    """
    for name, module in network.named_modules():
        record = checkpoint.modules.get(name)
        if record is None or not type(record).__module__.startswith("torch.nn."):
            continue
        is_plain = not list(module.children()) and not list(module.parameters())
        if is_plain and type(record).__name__ != type(module).__name__:
            kinds = f"{type(record).__name__} in the file, {type(module).__name__} in the network that it describes"
            raise InputError(f"{checkpoint.path}: {name} is {kinds}: written by a version too old")
        eps = record.state.get("eps")
        if isinstance(eps, float) and hasattr(module, "eps"):
            module.eps = eps


def _size(request: Request, checkpoint: Checkpoint | None, stride: int) -> tuple[int, int]:
    """Choose (height, width) of the network's input. InputError: not a multiple of its coarsest stride."""
    if request.input_size is None:
        trained = (checkpoint and checkpoint.image_size) or (IMAGE_SIZE, IMAGE_SIZE)
        sides = math.ceil(trained[0] / stride) * stride, math.ceil(trained[1] / stride) * stride
        return check_size(sides, request.what)
    if any(side % stride for side in request.input_size):
        sides = "x".join(map(str, request.input_size))
        raise InputError(f"detector {request.spec!r}: an input of {sides} is not a multiple of {stride}")
    return request.input_size
