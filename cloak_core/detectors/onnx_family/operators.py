"""Translations of ONNX operators that onnx2torch lacks, has wrong, or knows in older versions alone.

Most newer versions of an operator only take more types: they are translated as the version before, unless a node uses
an attribute or an input that is new. Importing this module imports onnx2torch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial

import onnx
import torch
import torch.nn.functional as F
from onnx import defs, helper, numpy_helper
from onnx2torch.node_converters.registry import add_converter, get_converter
from onnx2torch.onnx_graph import OnnxGraph
from onnx2torch.onnx_node import OnnxNode
from onnx2torch.utils.common import OnnxMapping, OperationConverterResult
from torch import Tensor, nn

OURS = "cloak"
"""Domain of the operators that are translated here."""
Constants = Mapping[str, onnx.TensorProto]


def make_translatable(model: onnx.ModelProto) -> list[dict[str, object]]:
    """Rewrite a graph's operators, in place, so that each has a translation. List those without one.

    Returns {"op", "version", "node"} of each. What is written has a meaning for `onnx2torch.convert` alone.
    """
    opsets = {entry.domain: entry.version for entry in model.opset_import}
    constants = {tensor.name: tensor for tensor in model.graph.initializer}
    missing = []
    for node in model.graph.node:
        version = _version(node, opsets.get(node.domain, 1))
        _rewrite(node, constants)
        if not node.domain and node.op_type in TRANSLATED and TRANSLATED[node.op_type](node, constants):
            node.domain = OURS
        elif not _is_known(node, version):
            missing.append({"op": node.op_type, "version": version, "node": node.name or node.output[0]})
    model.opset_import.append(helper.make_opsetid(OURS, 1))
    return missing


def _version(node: onnx.NodeProto, opset: int) -> int:
    """Find the version of an operator that stands in an opset."""
    try:
        return defs.get_schema(node.op_type, max_inclusive_version=opset, domain=node.domain).since_version
    except defs.SchemaError:
        return opset


_BORROWED: dict[tuple[str, str, int], int] = {}
"""By domain, operator and version registered here: the version whose translation it has. The registry is one for all
files of a process, and what one file may borrow another may not."""


def _is_known(node: onnx.NodeProto, version: int) -> bool:
    """Tell whether a node has a translation; an older version's is registered for its own where it means the same."""
    operator = node.domain, node.op_type
    for registered in range(version, 0, -1):
        try:
            translation = get_converter(node.op_type, registered, node.domain)
        except NotImplementedError:
            continue
        meant = _BORROWED.get((*operator, registered), registered)
        if meant < version:
            new, old = (defs.get_schema(node.op_type, v, node.domain) for v in (version, meant))
            added = [a for a in node.attribute if a.name in new.attributes and a.name not in old.attributes]
            if len(node.input) > old.max_input or any(a != new.attributes[a.name].default_value for a in added):
                return False  # it uses an input or an attribute that the older version does not know
        if registered < version:
            add_converter(node.op_type, version, node.domain)(translation)
            _BORROWED[*operator, version] = meant
        return True
    return False


def _rewrite(node: onnx.NodeProto, constants: Constants) -> None:
    """Write what a node says in a newer way as its operator's older versions do, where that says the same."""
    while node.input and not node.input[-1]:
        node.input.pop()
    if node.op_type.startswith("Reduce") and node.op_type != "ReduceSum" and node.input[-1] in constants:
        axes = numpy_helper.to_array(constants[node.input.pop()]).tolist()
        node.attribute.extend([helper.make_attribute("axes", axes)] if axes else [])
    if node.op_type == "Reshape":
        # 0 means an empty tensor here, else the extent that stands there; of a computed shape no extent is 0.
        shape = constants.get(node.input[1])
        if shape is None or numpy_helper.to_array(shape).all():
            for attribute in [a for a in node.attribute if a.name == "allowzero"]:
                node.attribute.remove(attribute)


class Function(nn.Module):
    """A function of tensors as a module."""

    def __init__(self, function: Callable[..., Tensor | tuple[Tensor, ...]]) -> None:
        super().__init__()
        self.function = function

    def forward(self, *tensors: Tensor) -> Tensor | tuple[Tensor, ...]:
        return self.function(*tensors)


TRANSLATED: dict[str, Callable[[onnx.NodeProto, Constants], bool]] = {}
"""Operators that are translated here, and for which of their nodes."""


def _translates(operation: str, where: Callable[[onnx.NodeProto, Constants], bool] = lambda *_: True) -> Callable:
    """Register what makes a function of tensors of an operator's node."""

    def register(build: Callable[[OnnxNode], Callable]) -> Callable[[OnnxNode], Callable]:
        def convert(node: OnnxNode, graph: OnnxGraph) -> OperationConverterResult:
            inputs = tuple(name for name in node.input_values if name)
            return OperationConverterResult(Function(build(node)), OnnxMapping(inputs, node.output_values))

        add_converter(operation, 1, OURS)(convert)
        TRANSLATED[operation] = where
        return build

    return register


@_translates("Clip", lambda node, constants: len(node.input) > 1 and not all(n in constants for n in node.input[1:]))
def _clip(node: OnnxNode) -> Callable:
    """Clip by bounds that are computed, or by one of two."""
    bounds = [name for name, value in zip(("min", "max"), node.input_values[1:], strict=False) if value]
    return lambda x, *values: torch.clamp(x, **dict(zip(bounds, values, strict=True)))


@_translates("Flatten")
def _flatten(node: OnnxNode) -> Callable:
    axis = node.attributes.get("axis", 1)
    return lambda x: x.reshape(math.prod(x.shape[:axis]), -1)


@_translates("Gelu")
def _gelu(node: OnnxNode) -> Callable:
    return partial(F.gelu, approximate=node.attributes.get("approximate", "none"))


SAMPLING = {"linear": "bilinear", "cubic": "bicubic"}
"""Names of opset 20; torch has those of opset 16."""


@_translates("GridSample")
def _grid_sample(node: OnnxNode) -> Callable:
    mode, padding = node.attributes.get("mode", "linear"), node.attributes.get("padding_mode", "zeros")
    corners = bool(node.attributes.get("align_corners", 0))
    return partial(F.grid_sample, mode=SAMPLING.get(mode, mode), padding_mode=padding, align_corners=corners)


@_translates("LayerNormalization", lambda node, _: len(node.output) == 1)
def _layer_norm(node: OnnxNode) -> Callable:
    axis, epsilon = node.attributes.get("axis", -1), node.attributes.get("epsilon", 1e-5)
    return lambda x, scale, bias=None: F.layer_norm(x, x.shape[axis:], scale, bias, epsilon)


@_translates("Split", lambda node, _: len(node.output) == 1 or any(a.name == "num_outputs" for a in node.attribute))
def _split(node: OnnxNode) -> Callable:
    """Split into equal parts, of which the last may be smaller; a single part is the whole tensor."""
    count, axis = len(node.output_values), node.attributes.get("axis", 0)
    return lambda x, sizes=None: x if count == 1 else x.split(-(-x.shape[axis] // count), axis)


@_translates("TopK", lambda node, _: len(node.input) == 2)
def _top_k(node: OnnxNode) -> Callable:
    """The best along an axis and where they stand; of equal ones the first, which torch leaves open."""
    axis, largest = node.attributes.get("axis", -1), bool(node.attributes.get("largest", 1))

    def top_k(x: Tensor, count: Tensor) -> tuple[Tensor, Tensor]:
        ordered = x.sort(dim=axis, descending=largest, stable=True)
        return tuple(part.narrow(axis, 0, int(count)) for part in ordered)

    return top_k
