"""ultralytics' detectors and original YOLOv5 pickles as students, learning from every cell of every branch."""

from __future__ import annotations

from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from cloak_core.detectors.darknet.heads import Yolo
from cloak_core.detectors.pixels import YOLO_GREY, fit
from cloak_core.detectors.ultralytics_family.checkpoint import write_ultralytics
from cloak_core.detectors.ultralytics_family.detector import UltralyticsDetector
from cloak_core.detectors.ultralytics_family.heads import AnchorHead, DenseHead, Maps, distances, rows
from cloak_core.files.errors import InputError
from cloak_core.studies.hardening.answers import Answer, Reading, answer_distance
from cloak_core.studies.hardening.distillation import distance
from cloak_core.studies.hardening.student import Student


class UltralyticsStudent(Student):
    """A network with a box at every cell. InputError: RT-DETR, whose queries stand in no order."""

    files = (".pt",)
    detector: UltralyticsDetector
    teacher: UltralyticsDetector

    def __init__(self, detector: UltralyticsDetector, teacher: UltralyticsDetector, spec: str) -> None:
        super().__init__(detector, teacher, spec)
        if not isinstance(detector.network.model[-1], DenseHead | AnchorHead):
            raise InputError(f"harden {spec}: cannot train RT-DETR, only networks with a box at every cell")

    def answer(self, detector: UltralyticsDetector, images: Float[Tensor, "B 3 H W"]) -> Answer | list[Tensor]:
        inputs, _ = fit(images, detector.input_size, detector.letterbox, YOLO_GREY)
        with self.autocast(images):
            maps = detector.network(inputs)
        return maps if isinstance(detector.network.model[-1], AnchorHead) else _answer(maps)

    def compare(
        self, said: Answer | list[Tensor], wanted: Answer | list[Tensor], surer: Bool[Tensor, " B"] | None, sure: float
    ) -> Float[Tensor, " B"]:
        own = self.detector
        head, point = own.network.model[-1], own.operating_point
        if isinstance(head, AnchorHead):
            return distance(_yolo_heads(head), said, wanted, own.person, surer, sure, point)
        reading = Reading(softmax=False, person=own.person, found_at=point)
        return answer_distance(said, wanted, reading, surer, sure)

    def save(self, stem: Path, seen: int) -> str:
        path = stem.with_suffix(".pt")
        write_ultralytics(path, self.network, Path(self.request.what).expanduser())
        return f"ultralytics:{path}{self.options}"


def _answer(maps: Maps) -> Answer:
    boxes = torch.cat([distances(box) for box, _ in maps], dim=1)
    return Answer(torch.cat([rows(kind) for _, kind in maps], dim=1), boxes.unsqueeze(2))


def _yolo_heads(head: AnchorHead) -> list[Yolo]:
    """Heads that read YOLOv5's raw maps: in each, an anchor after the other, box, objectness and classes, as Darknet
    has them."""
    classes = head.m[0].out_channels // head.anchors.shape[1] - 5
    return [
        Yolo([tuple(anchor) for anchor in level], classes, 1.0, new_coords=False) for level in head.anchors.tolist()
    ]
