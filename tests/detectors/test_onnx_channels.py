"""Channels that only change places are moved at once, with the same answers; nothing else is touched."""

import copy

import pytest
import torch
from torch import Tensor, fx, nn

from cloak_core.detectors.onnx_family.plainer import activate_in_place, cut, interleave, order_channels, reshape

IMAGES = torch.rand(3, 8, 5, 6, generator=torch.Generator().manual_seed(0))


class OnnxTranspose(nn.Module):
    """Named as onnx2torch's, which only that name is known by."""

    def __init__(self, *order: int) -> None:
        super().__init__()
        self.order = order

    def forward(self, x: Tensor) -> Tensor:
        return x.permute(self.order)


class OnnxGather(nn.Module):
    """Of one axis, one place (which drops it) or several."""

    def __init__(self, axis: int, places: int | list[int]) -> None:
        super().__init__()
        self.index = (*[slice(None)] * axis, places)

    def forward(self, x: Tensor) -> Tensor:
        return x[self.index]


def traced(build, **modules: nn.Module) -> fx.GraphModule:
    """A graph from a function of (graph, call); `call` adds a node and answers with it."""
    graph = fx.Graph()

    def call(what, *arguments):
        return graph.call_module(what, arguments) if isinstance(what, str) else graph.call_function(what, arguments)

    graph.output(build(graph.placeholder("x"), call))
    return fx.GraphModule(nn.ModuleDict(modules), graph).eval().requires_grad_(False)


def nanodets_shuffle(x, call):
    x = call("before", x)
    x = call(reshape, x, (-1, 2, 4, 5, 6))
    x = call(reshape, call("swap", x), (-1, 8, 5, 6))
    return call("after", call(cut, x, (0,), (4,), (1,))), call(cut, x, (4,), (8,), (1,))


def fastestdets_shuffle(x, call):
    x = call(reshape, call("before", x), (-1, 2, 30))
    x = call(reshape, call("swap", x), (2, -1, 4, 5, 6))
    return call("after", call("first", x)), call("second", x)


def parts(swap: tuple[int, ...]) -> dict[str, nn.Module]:
    convolutions = {"before": nn.Conv2d(8, 8, 1), "after": nn.Conv2d(4, 2, 1), "all": nn.Conv2d(8, 3, 3)}
    convolutions["turn"] = OnnxGather(1, [7, 0, 3, 2, 1, 6, 5, 4])
    return convolutions | {"swap": OnnxTranspose(*swap), "first": OnnxGather(0, 0), "second": OnnxGather(0, 1)}


def turned(x, call):
    """All channels in another order, which goes into the convolution."""
    return (call("all", call("turn", x)),)


@pytest.mark.parametrize(
    ("shuffle", "swap", "left"),
    [
        (nanodets_shuffle, (0, 2, 1, 3, 4), [interleave] * 2),
        (fastestdets_shuffle, (1, 0, 2), [cut] * 2),
        (turned, (), []),
    ],
)
def test_shuffles(shuffle, swap, left) -> None:
    graph = traced(shuffle, **parts(swap))
    expected = graph(IMAGES)
    order_channels(graph, IMAGES[:1])
    calls = [node for node in graph.graph.nodes if node.op.startswith("call")]
    assert [node.target for node in calls if node.op == "call_function"] == left and "turn" not in map(str, calls)
    for found, wanted in zip(graph(IMAGES), expected, strict=True):
        torch.testing.assert_close(found, wanted)


@pytest.mark.parametrize(
    ("shape", "swap"),
    [((1, 2, 4, 5, 6), (0, 2, 1, 3, 4)), ((-1, 8, 6, 5), (0, 1, 3, 2))],  # a fixed batch; rows become columns
)
def test_what_moves_more_than_channels_stays(shape, swap) -> None:
    def build(x, call):
        return call("after", call(reshape, call("swap", call(reshape, x, shape)), (-1, 8, 5, 6)))

    graph = traced(build, swap=OnnxTranspose(*swap), after=nn.Conv2d(8, 3, 1))
    before, weight = [str(node) for node in graph.graph.nodes], graph.after.weight.clone()
    expected = graph(IMAGES[:1])
    order_channels(graph, IMAGES[:1])
    assert [str(node) for node in graph.graph.nodes] == before and torch.equal(graph.after.weight, weight)
    torch.testing.assert_close(graph(IMAGES[:1]), expected)


def test_only_what_nobody_else_reads_is_overwritten() -> None:
    def build(x, call):
        a = call("conv", x)
        b = call("other", x)
        return call("relu", a), call("leaky", b), b, call("plain", x)

    modules = {"conv": nn.Conv2d(8, 4, 1), "other": nn.Conv2d(8, 4, 1), "relu": nn.ReLU(), "plain": nn.ReLU()}
    graph = traced(build, **modules, leaky=nn.LeakyReLU(0.1))
    changed = copy.deepcopy(graph)
    activate_in_place(changed)
    assert [changed.get_submodule(name).inplace for name in ("relu", "leaky", "plain")] == [True, False, False]
    pixels = IMAGES.clone().requires_grad_()
    slopes = [torch.autograd.grad(g(pixels)[0].sum(), pixels)[0] for g in (graph, changed)]
    torch.testing.assert_close(*slopes)
