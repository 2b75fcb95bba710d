"""A converted graph made plainer, in place, with the same answers.

What onnx2torch leaves as tensors to be read at every run (where to cut, which shape) becomes numbers, x * sigmoid(x)
one operation, and channels that are only put into another order are moved in one step, in the channels-last layout.
Exporters write a shuffle as reshape, transpose, reshape and split; each of them is a copy in torch, and what follows is
laid out anew. The order is found by sending the channels' numbers through such nodes. What that is worth: forward and
backward of eight images of 416 x 416 on one thread take 0.84 (NanoDet-m) and 0.81 (FastestDet) of the time without.
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
    x, *bounds = node.args
    known = [value if value is None else tuple(value.tolist()) for value in (constant(v, graph) for v in bounds)]
    starts, ends, axes, steps = (*known, None, None)[:4]
    if None in known[2:] or min(steps or (1,)) < 1:
        return None
    if starts is None or ends is None:
        return cut_between, (x, *bounds[:2], axes, steps)
    return cut, (x, starts, ends, axes, steps)


def cut_between(
    x: Tensor, starts: Tensor, ends: Tensor, axes: Sequence[int] | None, steps: Sequence[int] | None
) -> Tensor:
    """Like `cut`, where the graph itself computes from where to where: no part of a chain that moves channels."""
    return cut(x, starts.tolist(), ends.tolist(), axes, steps)


def cut(
    x: Tensor,
    starts: Sequence[int],
    ends: Sequence[int],
    axes: Sequence[int] | None = None,
    steps: Sequence[int] | None = None,
) -> Tensor:
    """Slice along several axes at once, all from the first unless told; ends beyond the tensor are its end."""
    index = [slice(None)] * x.dim()
    for k, (start, end) in enumerate(zip(starts, ends, strict=True)):
        index[k if axes is None else axes[k]] = slice(start, end, None if steps is None else steps[k])
    return x[tuple(index)]


def _reshape(node: fx.Node, module: nn.Module, graph: fx.GraphModule) -> Plainer:
    shape = constant(node.args[1], graph)
    return None if shape is None else (reshape, (node.args[0], tuple(map(int, shape))))


def reshape(x: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Reshape as ONNX does: 0 keeps the extent that stands there."""
    return x.reshape([x.shape[i] if extent == 0 else extent for i, extent in enumerate(shape)])


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
}
"""By the name of onnx2torch's module."""


REARRANGING = {"reshape", "cut", "getitem", "OnnxTranspose", "OnnxGather", "OnnxSplit", "OnnxSplit13"}
"""Names of functions and modules that move values without changing them."""
IMAGES = 3
"""Of the trial with numbers: an order that mixes images is none of channels."""


class ShapeRecorder(fx.Interpreter):
    """Runs a graph and notes in every node's `meta["shape"]` what it answers."""

    def run_node(self, n: fx.Node) -> object:
        answer = super().run_node(n)
        n.meta["shape"] = tuple(answer.shape) if isinstance(answer, Tensor) else None
        return answer


@torch.no_grad()
def order_channels(graph: fx.GraphModule, image: Tensor, weights: bool = True) -> None:
    """Replace, in place, chains of nodes that only put channels into another order; `image` is one to run it on.

    weights: the order may go into the weights of a convolution.
    """
    modules = dict(graph.named_modules())
    names = {node: _name(node, modules) for node in graph.graph.nodes}
    moving = [node for node, name in names.items() if name in REARRANGING]
    if not any(names[node].startswith("Onnx") for node in moving):
        return
    ShapeRecorder(graph).run(image)
    for node in moving:
        if all(names.get(user) in REARRANGING for user in node.users):
            continue  # not the end of its chain
        chain = [node]
        while names[chain[0]] in REARRANGING:
            chain.insert(0, chain[0].args[0])
        order = _order(chain, modules, graph)
        if order is not None and not (weights and _into_convolution(chain, order, modules)):
            _replace(chain, order, graph)
    graph.graph.eliminate_dead_code()
    graph.delete_all_unused_submodules()
    graph.recompile()


def interleave(x: Tensor, starts: Sequence[int], count: int) -> Tensor:
    """Take `count` channels from each of several starts, by turns."""
    last = x.permute(0, 2, 3, 1)
    parts = torch.stack([last[..., start : start + count] for start in starts], dim=-1)
    return parts.flatten(-2).permute(0, 3, 1, 2)


def _name(node: fx.Node, modules: dict[str, nn.Module]) -> str:
    """Name what a node calls, a module's class or a function; "" for none."""
    if node.op == "call_module":
        return type(modules[node.target]).__name__
    return getattr(node.target, "__name__", "") if node.op == "call_function" else ""


def _order(chain: list[fx.Node], modules: dict[str, nn.Module], graph: fx.GraphModule) -> Tensor | None:
    """Find the order in which channels come out; None where something else than channels is moved."""
    source, end = chain[0].meta["shape"], chain[-1].meta["shape"]
    if source is None or end is None or len(source) != 4 or len(end) != 4 or source[2:] != end[2:]:
        return None
    pixels = source[2] * source[3]
    numbers = torch.arange(IMAGES * source[1] * pixels).view(IMAGES, *source[1:])
    values: object = numbers
    try:
        for node in chain[1:]:
            others = [attribute(part, graph) if isinstance(part, fx.Node) else part for part in node.args[1:]]
            run = modules[node.target] if node.op == "call_module" else node.target
            values = run(values, *others)
    except (RuntimeError, IndexError, ValueError, AttributeError):  # numbers of several images do not fit through
        return None
    if not isinstance(values, Tensor) or values.dim() != 4 or values.shape[0] != IMAGES:
        return None
    order = values[0, :, 0, 0] // pixels
    return order if torch.equal(numbers[:, order], values) else None


def _into_convolution(chain: list[fx.Node], order: Tensor, modules: dict[str, nn.Module]) -> bool:
    """Reorder the weights of the one convolution that reads all channels; tell whether there is one."""
    source, end = chain[0], chain[-1]
    channels = source.meta["shape"][1]
    if len(end.users) != 1 or len(order) != channels or len(order.unique()) != channels:
        return False
    (user,) = end.users
    conv = modules.get(user.target) if user.op == "call_module" else None
    if type(conv) is not nn.Conv2d or conv.groups != 1:
        return False
    conv.weight.copy_(conv.weight[:, order.argsort()])
    end.replace_all_uses_with(source)
    return True


def _replace(chain: list[fx.Node], order: Tensor, graph: fx.GraphModule) -> None:
    """Replace a chain by a plain operation, a strided view or runs by turns; leave it where its order is neither."""
    source, end = chain[0], chain[-1]
    steps = order.diff()
    if len(order) < 2:
        return
    if bool((steps == steps[0]).all()) and steps[0] > 0:
        function, arguments = cut, ((int(order[0]),), (int(order[-1]) + 1,), (1,), (int(steps[0]),))
    else:
        fitting = (
            turns
            for turns in range(2, 5)
            if len(order) % turns == 0 and bool((order.view(-1, turns).diff(dim=0) == 1).all())
        )
        turns = next(fitting, 0)
        if not turns:
            return
        function, arguments = interleave, (tuple(order[:turns].tolist()), len(order) // turns)
    with graph.graph.inserting_before(end):
        rewritten = graph.graph.call_function(function, (source, *arguments))
    rewritten.meta = dict(end.meta)
    end.replace_all_uses_with(rewritten)
