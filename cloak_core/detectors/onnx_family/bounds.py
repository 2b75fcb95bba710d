"""What of an ONNX model's tensors is checked before any library sees it: onnxruntime ends the process over some."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from cloak_core.files.errors import InputError
from cloak_core.files.reading import MAX_BYTES

if TYPE_CHECKING:
    import onnx

MAX_DEPTH = 32
"""Graphs within graphs (branches of If, bodies of Loop)."""


def check_tensors(model: onnx.ModelProto, path: Path) -> None:
    """Check the tensors' shapes. InputError: a negative extent, or more numbers than any model taken here."""
    nodes = [*model.graph.node, *(node for function in model.functions for node in function.node)]
    for name, extents in _extents(model.graph, nodes, path, 0):
        if min(extents, default=0) < 0 or math.prod(extents) > MAX_BYTES:
            shape = "x".join(map(str, extents[:8]))
            raise InputError(f"{path}: its tensor {name or '(without a name)'} declares a shape of {shape}")


def _extents(
    graph: onnx.GraphProto, nodes: list[onnx.NodeProto], path: Path, depth: int
) -> Iterator[tuple[str, list[int]]]:
    """Name and extents of every tensor of a graph, and of the graphs and constants in its nodes."""
    if depth > MAX_DEPTH:
        raise InputError(f"{path}: graphs within graphs without end")
    attributes = [attribute for node in nodes for attribute in node.attribute]
    sparse = [*graph.sparse_initializer]
    tensors = [*graph.initializer]
    for attribute in attributes:
        tensors += [attribute.t, *attribute.tensors]
        sparse += [attribute.sparse_tensor, *attribute.sparse_tensors]
    tensors += [part for tensor in sparse for part in (tensor.values, tensor.indices)]
    yield from ((tensor.name, list(tensor.dims)) for tensor in tensors)
    yield from (("(sparse)", list(tensor.dims)) for tensor in sparse)
    for attribute in attributes:
        for inner in (attribute.g, *attribute.graphs):
            if inner.ByteSize():
                yield from _extents(inner, list(inner.node), path, depth + 1)
