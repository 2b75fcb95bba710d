"""Weights of a converted graph that can be trained, and written back into the file that they came from.

The file's own graph stays: whatever ran the old file runs the new one, as fast. A weight is an initializer (or a
Constant node); its uses are the places of the torch graph that hold a copy of it.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Shaped
from torch import Tensor, fx, nn

from cloak_core.files.errors import InputError

if TYPE_CHECKING:
    import onnx

KERNELS = {"Conv": 1, "ConvTranspose": 1, "Gemm": 1}
"""Which input of an operator is its weight; its bias is the next."""
NORMALISES = "BatchNormalization"
COPIES = ("Identity", "Cast")
"""Operators whose output may be a weight under another name, or in another precision."""


class NotTrainable(InputError):
    """Says why the weights of a file cannot be trained."""


@dataclass(frozen=True)
class Use:
    """One place where the torch graph holds a weight of the file."""

    module: str
    attribute: str
    transposed: bool = False


class TrainableWeights:
    """The weights of a converted graph that are trained, as parameters; all other tensors become buffers.

    Trained are kernels and biases of convolutions and linear layers, and scale and shift of batch norm. A weight stays
    as it is where anything else in the graph reads it too, or where it is a kernel of whole numbers alone: that is
    arithmetic (the expectation over distances in YOLOv8's head, a cut, a sum), not learned.

    graph: from `to_torch` with fold=False, changed in place. model: what it was converted from. original: the file as
    it is, in which weights may have another name for each use (Identity) and half precision.
    """

    def __init__(self, graph: fx.GraphModule, model: onnx.ModelProto, original: onnx.ModelProto, path: Path) -> None:
        """NotTrainable: there is nothing that is trained in the file at `path`."""
        from onnx import numpy_helper

        self._owners, tensors = _owners(original.graph), _tensors(original.graph)
        uses = self._uses(graph, model)
        read = [name for node in original.graph.node if node.op_type not in COPIES for name in reads(node)]
        read += [output.name for output in original.graph.output]
        times = Counter(self._owners.get(name, name) for name in read)
        self.uses: dict[str, Use] = {}
        self.parameters: dict[str, nn.Parameter] = {}
        """By the name of the initializer, or of the output of the Constant node."""
        self._before: dict[str, Tensor] = {}
        for name, places in uses.items():
            alike = times[name] == len(places) and len({use.transposed for use in places}) == 1
            # What would not go back into the file as it came out of it (after a Gemm's factor) is not trained.
            held = _as_in_the_file(_tensor_at(graph, places[0]), places[0])
            if alike and name in tensors and np.array_equal(held, numpy_helper.to_array(tensors[name])):
                self._tie(graph, name, places)
        if not self.parameters:
            raise NotTrainable(f"{path}: has no weights of convolutions or linear layers that could be trained")
        self.chooses = any(node.op_type == "TopK" for node in model.graph.node)
        """The graph chooses the best of something, so that its outputs stand in no order."""
        trained = set(map(id, self.parameters.values()))
        for module in graph.modules():
            for attribute, parameter in list(module._parameters.items()):
                if parameter is not None and id(parameter) not in trained:
                    delattr(module, attribute)
                    module.register_buffer(attribute, parameter.detach())

    def write_into(self, original: onnx.ModelProto) -> None:
        """Write the weights that have changed into the file's graph, in place, in the precision that they have there.

        What has not changed stays to the bit.
        """
        from onnx import numpy_helper

        tensors = _tensors(original.graph)
        for name, parameter in self.parameters.items():
            if not torch.equal(parameter.detach().cpu(), self._before[name]):
                tensor = tensors[name]
                values = _as_in_the_file(parameter, self.uses[name]).astype(numpy_helper.to_array(tensor).dtype)
                tensor.CopyFrom(numpy_helper.from_array(values, tensor.name))

    def _tie(self, graph: fx.GraphModule, name: str, places: list[Use]) -> None:
        """Let all places that hold copies of a weight hold one parameter."""
        parameter = nn.Parameter(_tensor_at(graph, places[0]).detach(), requires_grad=False)
        for use in places:
            module = graph.get_submodule(use.module)
            delattr(module, use.attribute)
            module.register_parameter(use.attribute, parameter)
        self.uses[name] = places[0]
        self.parameters[name] = parameter
        self._before[name] = parameter.detach().clone()

    def _uses(self, graph: fx.GraphModule, model: onnx.ModelProto) -> Mapping[str, list[Use]]:
        """Find where the torch graph holds which weight that can be trained."""
        from onnx2torch.onnx_graph import OnnxGraph

        arguments = {node.target: node.args for node in graph.graph.nodes if node.op == "call_module"}
        kinds = {output: node.op_type for node in model.graph.node for output in node.output}
        file, uses = OnnxGraph(model.graph), defaultdict(list)
        for path, node in file.nodes.items():
            if path not in arguments:
                continue  # replaced by something plainer, which has no weights
            for position, use in _places(node, graph.get_submodule(path), path, arguments[path], kinds):
                name = node.input_values[position]
                if name not in file.initializers:
                    continue
                values = file.initializers[name].to_numpy()
                # Vectors may be whole numbers: biases begin as zeros, scales as ones.
                fractions = values.ndim == 1 or bool((values != np.round(values)).any())
                if np.issubdtype(values.dtype, np.floating) and fractions:
                    uses[self._owners.get(name, name)].append(use)
        return uses


def _places(
    node: object, module: nn.Module, path: str, arguments: tuple, kinds: Mapping[str, str]
) -> Iterator[tuple[int, Use]]:
    """Yield which inputs of an ONNX node are weights, and where its torch module holds them."""
    operation, inputs = node.operation_type, node.input_values
    kernel = KERNELS.get(operation)
    inner = module[-1] if isinstance(module, nn.Sequential) else module  # an uneven padding before a convolution
    place = f"{path}.{len(module) - 1}" if isinstance(module, nn.Sequential) else path
    if kernel is not None and isinstance(getattr(inner, "weight", None), nn.Parameter):
        linear = operation == "Gemm"
        yield kernel, Use(place, "weight", linear and not node.attributes.get("transB", 0))
        if len(inputs) > kernel + 1 and inputs[kernel + 1]:
            yield kernel + 1, Use(place, "bias")
    elif operation == NORMALISES and isinstance(getattr(inner, "weight", None), nn.Parameter):
        yield 1, Use(place, "weight")
        yield 2, Use(place, "bias")
    elif operation in ("MatMul", "Gemm") or (operation == "Add" and "MatMul" in map(kinds.get, inputs)):
        for position, argument in enumerate(arguments):
            if isinstance(argument, fx.Node) and argument.op == "get_attr":
                owner, _, name = argument.target.rpartition(".")
                yield position, Use(owner, name)


def _tensor_at(graph: fx.GraphModule, use: Use) -> Tensor:
    return getattr(graph.get_submodule(use.module), use.attribute)


def _as_in_the_file(value: Tensor, use: Use) -> Shaped[np.ndarray, "*n"]:
    """Undo what the torch graph does to a weight of the file."""
    values = value.detach().cpu()
    return np.ascontiguousarray((values.T if use.transposed else values).numpy())


def reads(node: onnx.NodeProto) -> Iterator[str]:
    """Yield the names of the tensors that a node reads, those of the graphs in it included."""
    yield from node.input
    for attribute in node.attribute:
        for inner in (attribute.g, *attribute.graphs):
            for step in inner.node:
                yield from reads(step)
            yield from (output.name for output in inner.output)


def _owners(graph: onnx.GraphProto) -> dict[str, str]:
    """By the name of a copy, the name of the weight that it is a copy of."""
    weights = _tensors(graph)
    sources = {node.output[0]: node.input[0] for node in graph.node if node.op_type in COPIES}
    owners: dict[str, str] = {}
    for name, source in sources.items():
        while source in sources:
            source = sources[source]
        if source in weights:
            owners[name] = source
    return owners


def _tensors(graph: onnx.GraphProto) -> dict[str, onnx.TensorProto]:
    """Weights of a graph by the names that nodes read them under."""
    constants = {node.output[0]: constant_of(node) for node in graph.node if node.op_type == "Constant"}
    tensors = {name: value for name, value in constants.items() if value is not None}
    return {tensor.name: tensor for tensor in graph.initializer} | tensors


def constant_of(node: onnx.NodeProto) -> onnx.TensorProto | None:
    """Find the tensor in a Constant node; None where it is written in another way."""
    return next((attribute.t for attribute in node.attribute if attribute.name == "value"), None)
