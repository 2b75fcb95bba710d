"""From an ONNX graph to a torch module, through onnx2torch, and where a batch goes wrong in it."""

from __future__ import annotations

import contextlib
import warnings
from typing import TYPE_CHECKING

import torch
from torch import Tensor, fx

from cloak_core.detectors.folding import fold_batch_norm
from cloak_core.detectors.onnx_family.simplify import activate_in_place, simplify
from cloak_core.files.errors import first_line

if TYPE_CHECKING:
    import onnx


class NotConvertible(Exception):
    """Says why a graph has no torch twin."""


def to_torch(model: onnx.ModelProto) -> fx.GraphModule:
    """Convert to a torch module, frozen, batch norm folded where it follows a convolution.

    NotConvertible names the operator, or the node, that has no translation.
    """
    from onnx2torch import convert

    _lift_constants(model)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            graph = convert(model)
    except NotImplementedError as error:
        missing = getattr(error, "args", [""])[0]
        raise NotConvertible(f"no translation for {missing}") from None
    except Exception as error:  # whatever a translation meets that it did not expect
        raise NotConvertible(f"{type(error).__name__}: {first_line(error)[:120]}") from None
    graph.eval().requires_grad_(False)
    simplify(graph)
    fold_batch_norm(graph)
    activate_in_place(graph)
    return graph


def _lift_constants(model: onnx.ModelProto) -> None:
    """Make Constant nodes and copies of weights weights, in place: onnx2torch looks for kernels and biases there alone.

    Exporters write equal biases once, and copy them by Identity nodes.
    """
    graph = model.graph
    weights = {weight.name: weight for weight in graph.initializer}
    for node in [n for n in graph.node if n.op_type in ("Constant", "Identity")]:
        if node.op_type == "Identity":
            value = weights.get(node.input[0])
        else:
            value = next((a.t for a in node.attribute if a.name == "value"), None)
        if value is not None:
            lifted = graph.initializer.add()
            lifted.CopyFrom(value)
            lifted.name = node.output[0]
            graph.node.remove(node)


class _Recorder(fx.Interpreter):
    """Runs a graph and keeps what every node answers."""

    def __init__(self, graph: fx.GraphModule) -> None:
        super().__init__(graph, garbage_collect_values=False)
        self.answers: dict[str, object] = {}

    def run_node(self, n: fx.Node) -> object:
        self.answers[n.name] = answer = super().run_node(n)
        return answer


@torch.no_grad()
def node_that_mixes(graph: fx.GraphModule, images: Tensor) -> str:
    """Name of the first node that answers otherwise for a batch than for its images one by one; "" for none."""
    alone = []
    for image in images.split(1):
        recorder = _Recorder(graph)
        recorder.run(image)
        alone.append(recorder.answers)
    together = _Recorder(graph)
    with contextlib.suppress(Exception):  # the node that fails is the one that is looked for, below
        together.run(images)
    for node in graph.graph.nodes:
        if not isinstance(alone[0].get(node.name), Tensor) or not alone[0][node.name].dim():
            continue
        expected = [answers[node.name] for answers in alone]
        got = together.answers.get(node.name)
        if all(torch.equal(expected[0], other) for other in expected[1:]) and got is not None:
            continue  # a constant of the graph
        if not isinstance(got, Tensor) or got.shape[0] != len(images) * expected[0].shape[0]:
            return str(node.meta.get("onnx", node.target))
        if not torch.allclose(got.float(), torch.cat(expected).float(), atol=1e-3, rtol=1e-3):
            return str(node.meta.get("onnx", node.target))
    return ""
