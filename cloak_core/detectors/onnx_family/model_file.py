"""A network's file: what it says of its input, classes and size; of ONNX also what of it cannot be run."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cloak_core.detectors.classes import Description, describe, literal, read_description
from cloak_core.detectors.onnx_family.layouts import Layout
from cloak_core.detectors.specs import check_size
from cloak_core.files.errors import InputError, first_line
from cloak_core.files.identity import sha256_arrays
from cloak_core.files.reading import MAX_BYTES, read_bytes

if TYPE_CHECKING:
    import onnx

DEFAULT_SIDE = 640
QUANTISED = re.compile(r"(Dynamic)?(Quantize|Dequantize)Linear|QLinear\w+|\w+Integer")
"""Operators that compute in integers."""


@dataclass(frozen=True, eq=False, kw_only=True)
class NetworkFile:
    """A network's file, for any runtime."""

    path: Path
    digest: str
    """SHA-256 of all its files."""
    channels_last: bool
    """The input is [N, H, W, 3] (exports of TensorFlow), not [N, 3, H, W]."""
    size: tuple[int, int]
    """(height, width) that it is run at."""
    output_names: tuple[str, ...]
    said: tuple[Description, ...]
    """What the file says of itself, then what a JSON file beside it says."""
    layout: tuple[str, Layout] | None = None
    """How its outputs are read, by a name."""
    suppresses: str = ""
    """Name of a node that suppresses boxes; "" for none."""

    def first(self, what: str) -> Any:
        """Give a field of `Description` as the first says it who says it; None where nobody does."""
        return next((value for one in self.said if (value := getattr(one, what)) is not None), None)


@dataclass(frozen=True, eq=False, kw_only=True)
class ModelFile(NetworkFile):
    """An ONNX model of images, read and understood as far as its file tells."""

    model: onnx.ModelProto
    """Its weights with it, all of them float32."""
    opset: int
    input_name: str
    batch: int | None
    """The batch that the file fixes; None where any goes."""
    quantised: tuple[str, ...]
    """Names of its first nodes that compute in integers."""


def image_input(
    shape: Sequence[int | None], wanted: tuple[int, int] | None, usual: tuple[int, int] | None, path: Path
) -> tuple[bool, tuple[int, int]]:
    """Tell from an input's shape (None: any) whether channels stand last, and (height, width) to run at.

    usual: where neither the file nor the caller (`wanted`) says. InputError: no batch of RGB images; fixed to several
    images, or to another size than wanted; nobody says a size.
    """
    words = [extent or "any" for extent in shape]
    channels_last = len(shape) == 4 and shape[3] == 3 and shape[1] != 3
    if len(shape) != 4 or shape[3 if channels_last else 1] not in (3, None):
        raise InputError(f"{path}: its input {words} is not a batch of RGB images")
    if shape[0] not in (1, None):
        raise InputError(f"{path}: its batch is fixed to {shape[0]} images; export it for one, or for any number")
    sides = tuple(shape[1:3] if channels_last else shape[2:4])
    if None not in sides and wanted not in (None, sides):
        fixed, other = (f"{h}x{w}" for h, w in (sides, wanted))
        raise InputError(f"{path}: its input is fixed to {fixed}, it cannot run at {other}")
    size = wanted or (usual if None in sides else sides)
    if size is None:
        raise InputError(f"{path}: its input {words} has any size; say one, @HEIGHTxWIDTH")
    return channels_last, check_size(size, path)


def read_model(path: Path, wanted: tuple[int, int] | None = None) -> ModelFile:
    """Read a file to be run at the size wanted (None: its own, or 640 x 640).

    InputError: no ONNX; weights outside its folder; several inputs; what `image_input` refuses.
    """
    model, digest = read_proto(path)
    _as_float32(model, path)
    weights = {initializer.name for initializer in model.graph.initializer}
    inputs = [value for value in model.graph.input if value.name not in weights]
    if len(inputs) != 1:
        raise InputError(f"{path}: has {len(inputs)} inputs ({', '.join(i.name for i in inputs)}), not one of images")
    shape = [d.dim_value if d.dim_value > 0 else None for d in inputs[0].type.tensor_type.shape.dim]
    said = {entry.key: entry.value for entry in model.metadata_props}
    sides = literal(said.get("imgsz", ""))
    sides = [sides, sides] if isinstance(sides, int) else sides
    is_size = isinstance(sides, list) and len(sides) == 2 and all(isinstance(s, int) and s > 0 for s in sides)
    usual = tuple(sides) if is_size else (DEFAULT_SIDE, DEFAULT_SIDE)
    channels_last, size = image_input(shape, wanted, usual, path)
    kinds = [(node.op_type, node.name or node.op_type) for node in model.graph.node]
    return ModelFile(
        path=path,
        model=model,
        digest=digest,
        opset=_opset(model),
        input_name=inputs[0].name,
        output_names=tuple(output.name for output in model.graph.output),
        channels_last=channels_last,
        batch=shape[0],
        size=size,
        said=(describe(said), read_description(path)),
        quantised=tuple(name for kind, name in kinds if QUANTISED.fullmatch(kind))[:3],
        suppresses=next((name for kind, name in kinds if "NMS" in kind or kind == "NonMaxSuppression"), ""),
    )


def read_proto(path: Path) -> tuple[onnx.ModelProto, str]:
    """Read a file as it is, with the weights that lie beside it, and the SHA-256 of all that. InputError: no ONNX."""
    import onnx

    data = read_bytes(path)
    try:
        model = onnx.load_from_string(data)
    except Exception as error:  # protobuf's own
        raise InputError(f"{path}: not an ONNX file ({first_line(error)[:120]})") from None
    if not model.graph.node:
        raise InputError(f"{path}: not an ONNX file, or one without a network")
    if _opset(model) > onnx.defs.onnx_opset_version():
        known = f"the installed onnx {onnx.__version__} knows opsets up to {onnx.defs.onnx_opset_version()}"
        raise InputError(
            f"{path}: is of opset {_opset(model)}, {known}; update onnx, or export the file with an older one"
        )
    # Before any library sees its tensors: onnxruntime ends the process over shapes that are negative or too large.
    nodes = [*model.graph.node, *(node for function in model.functions for node in function.node)]
    for name, extents in _extents(model.graph, nodes, path, 0):
        if min(extents, default=0) < 0 or math.prod(extents) > MAX_BYTES:
            shape = "x".join(map(str, extents[:8]))
            raise InputError(f"{path}: its tensor {name or '(without a name)'} declares a shape of {shape}")
    outside = _load_outside(model, path)
    return model, sha256_arrays(np.frombuffer(data, np.uint8), *outside)


def _opset(model: onnx.ModelProto) -> int:
    """Find the version of ONNX's own operators; 1 where the file says none, as ONNX has it."""
    return next((entry.version for entry in model.opset_import if entry.domain in ("", "ai.onnx")), 1)


def _load_outside(model: onnx.ModelProto, path: Path) -> list[np.ndarray]:
    """Load the weights that lie in other files of its folder, and return those files' bytes, in order."""
    from onnx.external_data_helper import load_external_data_for_model, uses_external_data

    places = {
        entry.value
        for tensor in model.graph.initializer
        if uses_external_data(tensor)
        for entry in tensor.external_data
        if entry.key == "location"
    }
    folder, files = path.resolve().parent, []
    for place in sorted(places):
        target = (folder / place).resolve() if "\0" not in place else folder  # which no path may hold
        if folder not in target.parents:
            raise InputError(f"{path}: keeps weights in {place}, outside its folder; they are not read")
        files.append(np.frombuffer(read_bytes(target, MAX_BYTES), np.uint8))
    if places:
        try:
            load_external_data_for_model(model, str(folder))
        except Exception as error:
            raise InputError(f"{path}: its weights beside it cannot be read ({first_line(error)[:120]})") from None
    return files


def _as_float32(model: onnx.ModelProto, path: Path) -> None:
    """Convert half precision to single, in place: torch has no fast half-precision convolutions on a CPU.

    InputError: a tensor holds more or fewer numbers than its shape says.
    """
    from onnx import TensorProto, numpy_helper

    graph, half = model.graph, TensorProto.FLOAT16
    for value in (*graph.input, *graph.output, *graph.value_info):
        if value.type.tensor_type.elem_type == half:
            value.type.tensor_type.elem_type = TensorProto.FLOAT
    attributes = [attribute for node in graph.node for attribute in node.attribute]
    for attribute in attributes:
        if attribute.name in ("to", "dtype") and attribute.i == half:
            attribute.i = TensorProto.FLOAT
    for tensor in (*graph.initializer, *(a.t for a in attributes if a.HasField("t"))):
        if tensor.data_type == half:
            try:
                values = numpy_helper.to_array(tensor)
            except (ValueError, TypeError) as error:
                raise InputError(f"{path}: its tensor {tensor.name} is damaged ({first_line(error)[:120]})") from None
            tensor.CopyFrom(numpy_helper.from_array(values.astype(np.float32), tensor.name))


MAX_DEPTH = 32
"""Graphs within graphs (branches of If, bodies of Loop)."""


def _extents(
    graph: onnx.GraphProto, nodes: list[onnx.NodeProto], path: Path, depth: int
) -> Iterator[tuple[str, list[int]]]:
    """Yield name and extents of every tensor of a graph, and of the graphs and constants in its nodes."""
    if depth > MAX_DEPTH:
        raise InputError(f"{path}: graphs within graphs without end")
    tensors, sparse = [*graph.initializer], [*graph.sparse_initializer]
    for attribute in (attribute for node in nodes for attribute in node.attribute):
        tensors += [attribute.t, *attribute.tensors]
        sparse += [attribute.sparse_tensor, *attribute.sparse_tensors]
        for inner in (attribute.g, *attribute.graphs):
            if inner.ByteSize():
                yield from _extents(inner, list(inner.node), path, depth + 1)
    tensors += [part for tensor in sparse for part in (tensor.values, tensor.indices)]
    yield from ((tensor.name, list(tensor.dims)) for tensor in tensors)
    yield from (("(sparse)", list(tensor.dims)) for tensor in sparse)
