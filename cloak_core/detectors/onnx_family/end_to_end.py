"""End-to-end exports, [N, 300, 6] (YOLOv10 and later): their boxes before the graph chooses the best.

What is not chosen has no gradient, and of each box chosen only its best class is told. So the graph is cut before its
first TopK, or before its suppression, where every box still has the scores of all classes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from cloak_core.detectors.onnx_family.decoders import every_box
from cloak_core.detectors.onnx_family.layouts import END_TO_END, LAYOUTS
from cloak_core.detectors.onnx_family.model_file import ModelFile
from cloak_core.detectors.onnx_family.networks import Session
from cloak_core.detectors.verification.comparing import sample_images
from cloak_core.files.errors import InputError

if TYPE_CHECKING:
    import onnx

GATHERS = ("Gather", "GatherElements", "GatherND")
KEEPS_SCORES = ("ReduceMax", "Flatten", "Reshape", "Squeeze")
"""Operators between the scores of all classes and the choice of the best."""
ROWS = 10
"""Best rows of the file that must be found again among the boxes before its choice."""
SCORE, PIXELS = 1e-4, 0.05
"""How far they may be off."""
EVERY_BOX = replace(LAYOUTS[END_TO_END], decode=every_box, chosen=False)


def before_choice(file: ModelFile) -> ModelFile:
    """The file with every box as its output (`every_box`) where it is an end-to-end export, else as it is.

    It stays as it is where the best rows of the file do not stand among these boxes, too.
    """
    from onnx import TensorProto
    from onnx.helper import make_tensor_value_info
    from onnx.utils import Extractor

    if len(file.model.graph.output) != 1:
        return file
    for names in _all_rows(file) if file.suppresses else _boxes_and_scores(file.model.graph):
        with contextlib.suppress(InputError, RuntimeError, IndexError, ValueError, AssertionError):
            # Words of onnxruntime and of onnx, or other shapes.
            part = Extractor(file.model)
            part.value_infos |= {name: make_tensor_value_info(name, TensorProto.FLOAT, None) for name in names}
            model = part.extract_model([file.input_name], list(names))
            cut = replace(file, model=model, output_names=names, layout=(END_TO_END, EVERY_BOX), suppresses="")
            if _has_the_same_best(file, cut):
                return cut
    return file


def _all_rows(file: ModelFile) -> Iterator[tuple[str]]:
    """Names of the tensors, from the last to the first, through which all goes from the image to the suppression."""
    graph = file.model.graph
    depends, needed, suppressed = _downstream(graph, [file.input_name]), {graph.output[0].name}, False
    for node in reversed(graph.node):
        if needed.intersection(node.output):
            needed = (needed - set(node.output)) | depends.intersection(node.input)
            suppressed |= node.op_type == "NonMaxSuppression"
            if suppressed and len(needed) == 1:
                yield tuple(needed)


def _boxes_and_scores(graph: onnx.GraphProto) -> Iterator[tuple[str, str]]:
    """Find all boxes and all scores before every choice by TopK that the output comes from."""
    made_by = {output: node for node in graph.node for output in node.output}
    for choice in (node for node in graph.node if node.op_type == "TopK"):
        scores = choice.input[0]
        while scores in made_by and made_by[scores].op_type in KEEPS_SCORES:
            scores = made_by[scores].input[0]
        chosen = _downstream(graph, choice.output)
        for node in graph.node:
            data, index = (*node.input, "")[:2] if node.op_type in GATHERS else ("", "")
            if index in chosen and data not in chosen and data != scores and graph.output[0].name in chosen:
                yield data, scores
                break


def _downstream(graph: onnx.GraphProto, names: Iterable[str]) -> set[str]:
    """These tensors and all that are computed from them; nodes stand in the order they run in."""
    reached = set(names)
    for node in graph.node:
        if reached.intersection(node.input):
            reached.update(node.output)
    return reached


def _has_the_same_best(file: ModelFile, cut: ModelFile) -> bool:
    """Whether the file's best rows of sample images stand among the boxes before its choice; padding is no row.

    Where the file reports nothing there: whether these are corners in their order, and probabilities.
    """
    whole, before = Session(file), Session(cut)
    matches, sane = 0, True
    for image in sample_images(file.size).split(1):
        (rows,), (boxes, scores, _) = whole(image), every_box(before(image), file.size)
        if rows.dim() != 3 or rows.shape[2] != 6 or boxes.shape[:2] != scores.shape[:2] or boxes.shape[2] != 4:
            return False
        best = [row for row in rows[0, :ROWS] if row[4] > 0]
        for row in best:
            near = (boxes[0] - row[:4]).abs().amax(dim=1) <= PIXELS
            if not bool((near & ((scores[0, :, int(row[5])] - row[4]).abs() <= SCORE)).any()):
                return False
        matches += len(best)
        sane &= bool((boxes[..., 2:] >= boxes[..., :2]).all()) and bool(((scores >= 0) & (scores <= 1)).all())
    return matches > 0 or sane
