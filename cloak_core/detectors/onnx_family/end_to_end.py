"""End-to-end exports, [N, 300, 6] (YOLOv10 and later): their boxes before the graph chooses the best.

What is not chosen has no gradient, and of each box chosen only its best class is told. So the graph is cut before its
first TopK, where every box still has the scores of all classes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
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
    if len(file.model.graph.output) != 1:
        return file
    ways = map(partial(_parted, file.model), _all_rows(file)) if file.suppresses else _boxes_and_scores(file.model)
    for model, names in ways:
        cut = replace(file, model=_ending_in(model, names), output_names=names, before_choice=True, suppresses="")
        with contextlib.suppress(InputError, RuntimeError, IndexError):  # onnxruntime's words, or other shapes
            if _has_the_same_best(file, cut, size):
                return cut
    return file


Ways = Iterator[tuple["onnx.ModelProto", tuple[str, str]]]
"""A model, and names of its tensors that may hold all boxes and all scores."""


def _all_rows(file: ModelFile) -> Iterator[str]:
    """Names of the tensors, from the last to the first, through which all goes from the image to the suppression."""
    graph = file.model.graph
    depends, needed, suppressed = _downstream(graph, [file.input_name]), {graph.output[0].name}, False
    for node in reversed(graph.node):
        if needed.intersection(node.output):
            needed = (needed - set(node.output)) | depends.intersection(node.input)
            suppressed |= node.op_type == "NonMaxSuppression"
            if suppressed and len(needed) == 1:
                yield from needed


def _parted(model: onnx.ModelProto, rows: str) -> tuple[onnx.ModelProto, tuple[str, str]]:
    """Copy the model, with rows [N, A, 4 + K] parted into boxes and scores."""
    from onnx import helper, numpy_helper

    copied = type(model)()
    copied.CopyFrom(model)
    ends = {"cloak/start": [0], "cloak/four": [4], "cloak/end": [np.iinfo(np.int32).max], "cloak/last": [2]}
    copied.graph.initializer.extend(numpy_helper.from_array(np.array(v, np.int64), k) for k, v in ends.items())
    for name, first, last in (("boxes", "start", "four"), ("scores", "four", "end")):
        inputs = [rows, f"cloak/{first}", f"cloak/{last}", "cloak/last"]
        copied.graph.node.append(helper.make_node("Slice", inputs, [f"cloak/{name}"]))
    return copied, ("cloak/boxes", "cloak/scores")


def _boxes_and_scores(model: onnx.ModelProto) -> Ways:
    """Find all boxes and all scores before every choice by TopK that the output comes from."""
    graph = model.graph
    made_by = {output: node for node in graph.node for output in node.output}
    for choice in (node for node in graph.node if node.op_type == "TopK"):
        scores = choice.input[0]
        while scores in made_by and made_by[scores].op_type in KEEPS_SCORES:
            scores = made_by[scores].input[0]
        chosen = _downstream(graph, choice.output)
        for node in graph.node:
            data, index = (*node.input, "")[:2] if node.op_type in GATHERS else ("", "")
            if index in chosen and data not in chosen and data != scores and graph.output[0].name in chosen:
                yield model, (data, scores)
                break


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
    """Whether the file's best rows of sample images stand among the boxes before its choice; padding is no row.

    Where the file reports nothing there: whether these are corners in their order, and probabilities.
    """
    sessions = [Session(f.session(torch.get_num_threads()), f) for f in (file, cut)]
    found, sane = 0, True
    for image in sample_images(size).split(1):
        (rows,), (boxes, scores) = (session(image) for session in sessions)
        if rows.dim() != 3 or rows.shape[2] != 6 or boxes.shape[:2] != scores.shape[:2] or boxes.shape[2] != 4:
            return False
        best = [row for row in rows[0, :ROWS] if row[4] > 0]
        if not all(_stands_in(row, boxes[0], scores[0]) for row in best):
            return False
        found += len(best)
        sane &= bool((boxes[..., 2:] >= boxes[..., :2]).all()) and bool(((scores >= 0) & (scores <= 1)).all())
    return found > 0 or sane


def _stands_in(row: Tensor, boxes: Tensor, scores: Tensor) -> bool:
    near = (boxes - row[:4]).abs().amax(dim=1) <= PIXELS
    return bool((near & ((scores[:, int(row[5])] - row[4]).abs() <= SCORE)).any())
