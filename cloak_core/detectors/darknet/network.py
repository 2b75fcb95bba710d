"""From .cfg sections to a torch network that runs, trains and folds."""

import math
from functools import partial

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from cloak_core.detectors.darknet.cfg import Section, parse_cfg
from cloak_core.detectors.darknet.layers import (
    ACTIVATIONS,
    BatchNorm,
    Convolution,
    MaxPool,
    Plain,
    match_channels,
    reorg,
)
from cloak_core.detectors.decoding import AnchorBoxes
from cloak_core.detectors.specs import MAX_SIDE

MAX_CHANNELS = 1 << 16
MAX_VALUES = 1 << 28
"""Of one layer's output on one image: 1 GiB."""

Shape = tuple[int, int, int]


class Network(nn.Module):
    """A Darknet network: layer i is section i + 1 of its cfg.

    `build_network` makes it ready for training: train mode, batch norm apart, seeded He initialisation.
    `read_weights` (darknet.weights) fills it, `fold` readies it for inference.
    """

    def __init__(self, sections: list[Section], input_size: tuple[int, int] | None = None) -> None:
        """Build from a cfg's sections; `input_size` (height, width) replaces the cfg's.

        InputError names the cfg line.
        """
        super().__init__()
        net, self.sections = sections[0], sections[1:]
        size = input_size or (net.integer("height", low=1), net.integer("width", low=1))
        self.input_size: tuple[int, int] = (int(size[0]), int(size[1]))
        if max(self.input_size) > MAX_SIDE:
            raise net.error(f"input size {self.input_size} beyond {MAX_SIDE}")
        shape: Shape = (net.integer("channels", 3, low=1), *self.input_size)
        if shape[0] != 3:
            raise net.error(f"channels={shape[0]}: only networks on RGB images are supported")
        shapes: list[Shape] = []
        layers: list[nn.Module] = []
        for section in self.sections:
            if section.kind not in BUILDERS:
                raise section.error(f"unknown section; known are {', '.join(sorted(BUILDERS))}")
            layer, shape = BUILDERS[section.kind](section, shape, shapes)
            if min(shape) < 1:
                raise section.error(
                    f"the input {self.input_size[0]}x{self.input_size[1]} is too small to reach this layer"
                )
            if math.prod(shape) > MAX_VALUES:
                raise section.error(f"its output of {' x '.join(map(str, shape))} numbers is beyond any known network")
            layers.append(layer)
            shapes.append(shape)
        self.layers = nn.ModuleList(layers)
        self._needed = {i for layer in layers for i in getattr(layer, "sources", ())}
        if not self.heads:
            raise net.error("the network has no [region] and no [yolo]: not a detector")

    @property
    def heads(self) -> list[AnchorBoxes]:
        """Detection heads, in network order."""
        return [layer for layer in self.layers if isinstance(layer, AnchorBoxes)]

    def forward(self, images: Tensor) -> list[Tensor]:
        """Run on images [B, 3, H, W] in [0, 1] at network size: a raw map [B, A * (5 + K), h, w] per head.

        H and W may differ from the cfg's, as long as they are multiples of the network's stride.
        """
        x, earlier, maps = images, {}, []
        for index, layer in enumerate(self.layers):
            x = layer(x, *(earlier[source] for source in getattr(layer, "sources", ())))
            if index in self._needed:
                earlier[index] = x
            if isinstance(layer, AnchorBoxes):
                maps.append(x)
        return maps

    def fold(self) -> "Network":
        """Fold every batch norm into its convolution, in place. Outputs in eval mode stay equal up to rounding."""
        for layer in self.layers:
            if isinstance(layer, Convolution):
                layer.fold()
        return self


def build_network(cfg_text: str, input_size: tuple[int, int] | None = None, seed: int = 0) -> Network:
    """Build a trainable network: unfolded batch norm, train mode, He-initialised weights from `seed`."""
    network = Network(parse_cfg(cfg_text), input_size)
    generator = torch.Generator().manual_seed(seed)
    for layer in network.layers:
        if isinstance(layer, Convolution):
            fan_in = layer.conv.weight[0].numel()
            nn.init.normal_(layer.conv.weight, 0, (2 / fan_in) ** 0.5, generator=generator)
            if layer.conv.bias is not None:
                nn.init.zeros_(layer.conv.bias)
    return network.train()


def _convolutional(section: Section, shape: Shape, shapes: list[Shape]) -> tuple[nn.Module, Shape]:
    section.refuse("binary", "xnor", "antialiasing", "share_index", "assisted_excitation", "deform", "sway", "rotate")
    section.refuse("stretch", "padding")
    section.refuse("dilation", but=1)
    channels, height, width = shape
    filters, groups = section.integer("filters", 1, low=1), section.integer("groups", 1, low=1)
    size, stride = section.integer("size", 1, low=1), _stride(section)
    if filters > MAX_CHANNELS or size > 64:
        raise section.error(f"filters={filters}, size={size}: beyond any known network")
    if channels % groups or filters % groups:
        raise section.error(f"groups={groups} does not divide its {channels} input channels and {filters} filters")
    padding = size // 2 if section.integer("pad", 0) else 0
    normalize = bool(section.integer("batch_normalize", 0))
    conv = nn.Conv2d(channels, filters, size, stride, padding, groups=groups, bias=not normalize)
    layer = Convolution(conv, BatchNorm(filters) if normalize else None, _activation(section, "logistic"))
    return layer, (filters, *((n + 2 * padding - size) // stride + 1 for n in (height, width)))


def _maxpool(section: Section, shape: Shape, shapes: list[Shape]) -> tuple[nn.Module, Shape]:
    section.refuse("maxpool_depth", "antialiasing")
    stride = _stride(section)
    size = section.integer("size", stride, low=1)
    section.refuse("padding", but=size - 1)
    pool = MaxPool(size, stride)
    return pool, (shape[0], pool.out(shape[1]), pool.out(shape[2]))


def _route(section: Section, shape: Shape, shapes: list[Shape]) -> tuple[nn.Module, Shape]:
    sources = _sources(section, "layers", shapes)
    groups, group = section.integer("groups", 1, low=1), section.integer("group_id", 0, low=0)
    picked = [shapes[index] for index in sources]
    if any(other[1:] != picked[0][1:] for other in picked):
        sizes = ", ".join(f"layer {i}: {shapes[i][1]}x{shapes[i][2]}" for i in sources)
        raise section.error(f"joins layers of different sizes ({sizes}); the input size must be a multiple of 32")
    if group >= groups or any(other[0] % groups for other in picked):
        raise section.error(f"groups={groups}, group_id={group} do not fit its channels")

    def route(x: Tensor, *earlier: Tensor) -> Tensor:
        """Earlier outputs side by side in channels, or one group of their channels."""
        parts = [part.chunk(groups, dim=1)[group] for part in earlier] if groups > 1 else earlier
        return parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)

    return Plain(route, sources), (sum(other[0] // groups for other in picked), *picked[0][1:])


def _reorg(section: Section, shape: Shape, shapes: list[Shape]) -> tuple[nn.Module, Shape]:
    section.refuse("reverse", "flatten", "extra")
    stride = section.integer("stride", 1, low=1)
    channels, height, width = shape
    if channels % stride**2 or height % stride or width % stride:
        raise section.error(f"stride={stride} does not divide its input {channels}x{height}x{width}")
    return Plain(partial(reorg, stride=stride)), (channels * stride**2, height // stride, width // stride)


def _shortcut(section: Section, shape: Shape, shapes: list[Shape]) -> tuple[nn.Module, Shape]:
    section.refuse("weights_type")
    section.refuse("alpha", "beta", but=1)
    sources = _sources(section, "from", shapes)
    for index in sources:
        if shapes[index][1:] != shape[1:]:
            raise section.error(f"adds layer {index} of another size ({shapes[index]} to {shape})")
    activation = ACTIVATIONS[_activation(section, "linear")]

    def shortcut(x: Tensor, *earlier: Tensor) -> Tensor:
        """Activation of the sum, on the channels that both have."""
        for other in earlier:
            x = x + match_channels(other, x.shape[1])  # a new tensor: x itself may be needed again
        return activation(x)

    return Plain(shortcut, sources), shape


def _upsample(section: Section, shape: Shape, shapes: list[Shape]) -> tuple[nn.Module, Shape]:
    section.refuse("scale", but=1)
    stride = section.integer("stride", 2, low=1)
    upsample = partial(F.interpolate, scale_factor=float(stride), mode="nearest")
    return Plain(upsample), (shape[0], shape[1] * stride, shape[2] * stride)


def _dropout(section: Section, shape: Shape, shapes: list[Shape]) -> tuple[nn.Module, Shape]:
    probability = section.number("probability", 0.5)
    if not 0 <= probability <= 1:
        raise section.error(f"probability={probability:g} is not in [0, 1]")
    return nn.Dropout(probability), shape


def _head(section: Section, shape: Shape, shapes: list[Shape]) -> tuple[nn.Module, Shape]:
    """Build the head of [region] (YOLOv2, anchors in cells) or [yolo] (v3, v4; anchors in pixels, chosen by a mask)."""
    section.refuse("tree", "map", "background", "obj_channels", "embedding_layer")
    if section.integer("coords", 4) != 4:
        raise section.error("coords other than 4 are not supported")
    count, values = section.integer("num", 1, low=1), section.listed("anchors", float)
    if len(values) != 2 * count:
        raise section.error(f"num={count} needs {2 * count} numbers in anchors=, found {len(values)}")
    classes = section.integer("classes", 20, low=1)
    anchors = list(zip(values[::2], values[1::2], strict=True))
    if section.kind == "region":
        head = AnchorBoxes(anchors, classes, in_cells=True, softmax=bool(section.integer("softmax", 0)))
    else:
        mask = section.listed("mask", int) or list(range(count))
        if not all(0 <= index < count for index in mask):
            raise section.error(f"mask={section.options.get('mask', '')} reaches beyond its {count} anchors")
        scale, squared = section.number("scale_x_y", 1.0), bool(section.integer("new_coords", 0))
        head = AnchorBoxes([anchors[index] for index in mask], classes, scale_xy=scale, squared=squared)
    if head.channels != shape[0]:
        raise section.error(
            f"{len(head.anchors)} anchors and {classes} classes need {head.channels} channels, "
            f"but the layer before has {shape[0]} filters"
        )
    return head, shape


BUILDERS = {
    "convolutional": _convolutional,
    "conv": _convolutional,
    "maxpool": _maxpool,
    "max": _maxpool,
    "route": _route,
    "reorg": _reorg,
    "shortcut": _shortcut,
    "upsample": _upsample,
    "dropout": _dropout,
    "region": _head,
    "yolo": _head,
}


def _activation(section: Section, default: str) -> str:
    name = section.options.get("activation", default)
    if name not in ACTIVATIONS:
        raise section.error(f"activation={name} is not supported; known are {', '.join(ACTIVATIONS)}")
    return name


def _stride(section: Section) -> int:
    stride = section.integer("stride", 1, low=1)
    section.refuse("stride_x", "stride_y", but=stride)
    return stride


def _sources(section: Section, key: str, shapes: list[Shape]) -> list[int]:
    """Resolve absolute indices of the layers an option names; negative numbers count back from the layer itself."""
    numbers = section.listed(key, int)
    if not numbers:
        raise section.error(f"lacks {key}=")
    absolute = [index if index >= 0 else len(shapes) + index for index in numbers]
    for index, text in zip(absolute, numbers, strict=True):
        if not 0 <= index < len(shapes):
            raise section.error(f"{key}={text}: there is no such layer before this one (layer {len(shapes)})")
    return absolute
