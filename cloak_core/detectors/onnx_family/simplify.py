"""A converted graph made plainer, in place, with the same answers.

What onnx2torch leaves as tensors to be read at every run (where to cut, which shape) becomes numbers, and
x * sigmoid(x) one operation.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, fx, nn


def simplify(graph: fx.GraphModule) -> None:
    """Replace nodes of a graph by plainer ones, in place."""
    modules = dict(graph.named_modules())
    for node in list(graph.graph.nodes):
        if node.op != "call_module":
            continue
        module = modules[node.target]
        rewrite = REWRITES.get(type(module).__name__)
        plainer = None if rewrite is None else rewrite(node, module, graph)
        if plainer is None:
            continue
        function, arguments = plainer
        with graph.graph.inserting_before(node):
            rewritten = graph.graph.call_function(function, arguments)
        rewritten.meta["onnx"] = node.target  # the node's own name in the file
        node.replace_all_uses_with(rewritten)
        graph.graph.erase_node(node)
    graph.graph.eliminate_dead_code()
    graph.delete_all_unused_submodules()
    graph.recompile()


def activate_in_place(graph: fx.GraphModule) -> None:
    """Let activations that follow a convolution overwrite what nobody else reads: new memory costs more than the
    work. Only those whose slope can be told from their answer."""
    modules = dict(graph.named_modules())
    for node in graph.graph.nodes:
        if node.op != "call_module" or type(modules[node.target]) not in (nn.ReLU, nn.ReLU6, nn.LeakyReLU):
            continue
        (source,) = node.args
        ours = source.op == "call_module" and type(modules[source.target]) is nn.Conv2d
        if ours and len(source.users) == 1:
            modules[node.target].inplace = True


Plainer = tuple[Callable, tuple] | None
"""A function, and its arguments."""


def _silu(node: fx.Node, module: nn.Module, graph: fx.GraphModule) -> Plainer:
    """Replace x * sigmoid(x): silu keeps one tensor for the gradient instead of three."""
    if module.math_op_function not in (torch.mul, operator.mul) or len(node.args) != 2:
        return None
    for x, gate in (node.args, node.args[::-1]):
        is_call = isinstance(gate, fx.Node) and gate.op == "call_module" and gate.args == (x,)
        if is_call and isinstance(graph.get_submodule(gate.target), nn.Sigmoid):
            return F.silu, (x,)
    return None


def _slice(node: fx.Node, module: nn.Module, graph: fx.GraphModule) -> Plainer:
    x, *given = node.args
    known = [value if value is None else tuple(value.tolist()) for value in (constant(v, graph) for v in given)]
    starts, ends, axes, steps = (*known, None, None)[:4]
    if None in known[2:] or min(steps or (1,)) < 1:
        return None
    if starts is None or ends is None:
        return cut_between, (x, *given[:2], axes, steps)
    return cut, (x, _slices(starts, ends, axes, steps))


def cut_between(
    x: Tensor, starts: Tensor, ends: Tensor, axes: tuple[int, ...] | None, steps: tuple[int, ...] | None
) -> Tensor:
    """Like `cut`, where the graph itself computes from where to where."""
    return cut(x, _slices(starts.tolist(), ends.tolist(), axes, steps))


def _slices(
    starts: Sequence[int], ends: Sequence[int], axes: Sequence[int] | None, steps: Sequence[int] | None
) -> tuple[tuple[int, int, int, int], ...]:
    """(axis, start, end, step) of each; every axis from the first and every element unless told."""
    axes = range(len(starts)) if axes is None else axes
    steps = [1] * len(starts) if steps is None else steps
    return tuple((int(a), int(b), int(e), int(s)) for a, b, e, s in zip(axes, starts, ends, steps, strict=True))


def cut(x: Tensor, slices: tuple[tuple[int, int, int, int], ...]) -> Tensor:
    """Slice by several (axis, start, end, step) at once; ends beyond the tensor are its end."""
    index = [slice(None)] * x.dim()
    for axis, start, end, step in slices:
        index[axis] = slice(start, end, step)
    return x[tuple(index)]


def _reshape(node: fx.Node, module: nn.Module, graph: fx.GraphModule) -> Plainer:
    shape = constant(node.args[1], graph)
    return None if shape is None else (reshape, (node.args[0], tuple(map(int, shape))))


def reshape(x: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Reshape as ONNX does: 0 keeps the extent that stands there."""
    return x.reshape([x.shape[i] if extent == 0 else extent for i, extent in enumerate(shape)])


def _gather(node: fx.Node, module: nn.Module, graph: fx.GraphModule) -> Plainer:
    """Replace a regular list of channels by a slice, which is a view and no copy."""
    index = constant(node.args[1], graph)
    if index is None or index.ndim != 1 or len(index) < 2 or index.min() < 0:
        return None
    steps = np.unique(np.diff(index))
    if len(steps) != 1 or steps[0] < 1:
        return None
    return cut, (node.args[0], ((module._axis, int(index[0]), int(index[-1]) + 1, int(steps[0])),))


def constant(value: object, graph: fx.GraphModule) -> np.ndarray | None:
    """Give what a node always is; None where it is computed. Of integers only: indices, not weights."""
    if not isinstance(value, fx.Node) or value.op != "get_attr":
        return None
    tensor = attribute(value, graph)
    return tensor.cpu().numpy() if isinstance(tensor, Tensor) and not tensor.is_floating_point() else None


def attribute(node: fx.Node, graph: fx.GraphModule) -> object:
    """Give what of the graph's own a node names."""
    owner, _, name = node.target.rpartition(".")
    return getattr(graph.get_submodule(owner), name)


REWRITES: dict[str, Callable[[fx.Node, nn.Module, fx.GraphModule], Plainer]] = {
    "OnnxBinaryMathOperation": _silu,
    "OnnxSlice": _slice,
    "OnnxReshape": _reshape,
    "OnnxGather": _gather,
}
"""By the name of onnx2torch's module."""
