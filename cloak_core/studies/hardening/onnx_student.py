"""ONNX files as students: every box learns, and the trained weights go back into the file's own graph."""

from __future__ import annotations

import hashlib
from pathlib import Path

from jaxtyping import Bool, Float
from torch import Tensor

from cloak_core.detectors.classes import COCO, UNDERSTOOD, VOC, Description, names_beside
from cloak_core.detectors.onnx_family.detector import OnnxDetector
from cloak_core.detectors.onnx_family.model_file import read_model, read_proto
from cloak_core.detectors.pixels import fit
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_bytes, write_json, write_text
from cloak_core.studies.hardening.answers import Answer, answer_of, in_the_order_of, score_distance
from cloak_core.studies.hardening.student import Student


class OnnxStudent(Student):
    """A converted graph, box by box; where it chooses among its boxes, each learns from the teacher's most like it.

    Normalisations that the file has folded into its convolutions stay folded and learn with them.
    """

    files = (".onnx",)
    detector: OnnxDetector
    teacher: OnnxDetector

    def answer(self, detector: OnnxDetector, images: Float[Tensor, "B 3 H W"]) -> Answer:
        """Read every box of a detector's outputs: scores of all classes, as its runtimes report them."""
        inputs, _ = fit(images, detector.input_size, detector.letterbox, detector.fill)
        with self.autocast(images):
            decoded = detector.answer(detector.pixels.apply(inputs))
        return answer_of(decoded.scores, decoded.boxes)

    def compare(
        self, said: Answer, wanted: Answer, surer: Bool[Tensor, " B"] | None, sure: float
    ) -> Float[Tensor, " B"]:
        own = self.detector
        if own.weights.chooses:
            wanted = in_the_order_of(said, wanted)
        return score_distance(said, wanted, own.person, own.operating_point, surer, sure)

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
        """See `Student.licence`."""
        said = read_model(self.detector.path).licence
        return said or f"unknown; {self.detector.path.name} does not say, ask those who made it"

    def _describe(self, target: Path, facts: dict[str, object]) -> None:
        """Write beside the new file its facts, with what was said beside the old one and holds on, or names of classes.

        What was measured of the old file is left out.
        """
        file, described = read_model(self.detector.path), self.detector.path.with_suffix(".json")
        if file.described != Description():
            holds = {key: value for key, value in read_json(described).items() if key in UNDERSTOOD}
            write_json(target.with_suffix(".json"), facts | {"made_from": self.spec} | holds)
        names = self.detector.class_names
        if names and not file.names and not file.described.names:
            beside = names_beside(self.detector.path, len(names))
            if beside == names and names not in (COCO, VOC):
                write_text(target.with_suffix(".names"), "\n".join(names) + "\n")
