"""End-to-end exports, [N, 300, 6] (YOLOv10 and later): their boxes before the graph chooses the best.

What is not chosen has no gradient, and of each box chosen only its best class is told. So the graph is cut before its
first TopK, where every box still has the scores of all classes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

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


def before_choice(file: ModelFile, size: tuple[int, int]) -> ModelFile:
    """The file with boxes [N, A, 4] and scores [N, A, K] as outputs where it is an end-to-end export, else as it is.

    It stays as it is where the best rows of the file do not stand among these boxes, too.
    """
    names = _boxes_and_scores(file.model.graph)
    if names is None or file.suppresses:
        return file
    cut = replace(file, model=_ending_in(file.model, names), output_names=names, before_choice=True)
    try:
        return cut if _has_the_same_best(file, cut, size) else file
    except (InputError, RuntimeError, IndexError):  # onnxruntime's words, or outputs of other shapes
        return file


def _boxes_and_scores(graph: onnx.GraphProto) -> tuple[str, str] | None:
    """Names of the tensors that hold all boxes and all scores; None where the only output is no choice among them."""
    made_by = {output: node for node in graph.node for output in node.output}
    choice = next((node for node in graph.node if node.op_type == "TopK"), None)
    if choice is None or len(graph.output) != 1:
        return None
    scores = choice.input[0]
    while scores in made_by and made_by[scores].op_type in KEEPS_SCORES:
        scores = made_by[scores].input[0]
    chosen = _downstream(graph, choice.output)
    for node in graph.node:
        data, index = (*node.input, "")[:2] if node.op_type in GATHERS else ("", "")
        if index in chosen and data not in chosen and data != scores:
            return (data, scores) if graph.output[0].name in chosen else None
    return None


def _downstream(graph: onnx.GraphProto, names: Iterable[str]) -> set[str]:
    """These tensors and all that are computed from them; nodes stand in the order they run in."""
    found = set(names)
    for node in graph.node:
        if found.intersection(node.input):
            found.update(node.output)
    return found


def _ending_in(model: onnx.ModelProto, names: tuple[str, ...]) -> onnx.ModelProto:
    """A copy of the model with these tensors as its outputs, without nodes that they do not need."""
    import onnx

    cut = type(model)()
    cut.CopyFrom(model)
    needed, kept = set(names), []
    for node in reversed(model.graph.node):
        if needed.intersection(node.output):
            kept.append(node)
            needed.update(node.input)
    del cut.graph.node[:], cut.graph.output[:]
    cut.graph.node.extend(reversed(kept))
    kind = onnx.TensorProto.FLOAT
    cut.graph.output.extend(onnx.helper.make_tensor_value_info(name, kind, None) for name in names)
    return cut


def _has_the_same_best(file: ModelFile, cut: ModelFile, size: tuple[int, int]) -> bool:
    """Whether the file's best rows of a sample image stand among the boxes before its choice."""
    image = sample_images(size)[:1]
    (rows,), (boxes, scores) = (Session(f.session(torch.get_num_threads()), f)(image) for f in (file, cut))
    if rows.dim() != 3 or rows.shape[2] != 6 or boxes.shape[:2] != scores.shape[:2] or boxes.shape[2] != 4:
        return False
    return all(_stands_in(row, boxes[0], scores[0]) for row in rows[0, :ROWS])


def _stands_in(row: Tensor, boxes: Tensor, scores: Tensor) -> bool:
    near = (boxes - row[:4]).abs().amax(dim=1) <= PIXELS
    return bool((near & ((scores[:, int(row[5])] - row[4]).abs() <= SCORE)).any())
