"""The two ways to run an ONNX file: converted to a torch module, through onnx2torch, or by onnxruntime.

Whether a converted network answers as onnxruntime does, for one image and for several, and whether its gradient is one,
is asked once for each file and each version of what converts it (`compare`, `remembered`).
"""

from __future__ import annotations

import contextlib
import json
import warnings
from collections.abc import Callable, Sequence
from importlib.metadata import version
from queue import Empty, Queue
from threading import Thread
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, fx, nn

from cloak_core.detectors.checkpoints import fold_batch_norm
from cloak_core.detectors.decoding import Decoded
from cloak_core.detectors.onnx_family.model_file import ModelFile
from cloak_core.detectors.onnx_family.plainer import activate_in_place, simplify
from cloak_core.detectors.onnx_family.weights import COPIES, constant_of, reads
from cloak_core.detectors.verification.comparing import (
    AGREES,
    Apart,
    gradient_error,
    in_any_order,
    largest_difference,
    sureness,
)
from cloak_core.files.caching import DiskCache, cache_folder
from cloak_core.files.errors import InputError, first_line
from cloak_core.files.identity import code_hash, sha256_arrays
from cloak_core.files.reading import parse_json

if TYPE_CHECKING:
    import onnx

SECONDS = 120.0
"""For one image, of a network in another runtime."""
NEWEST_SURE = 17
"""Opset up to which onnx2torch knows nearly all that detectors are made of."""
LIMIT_BYTES = 1 << 20
FEW = 1000
"""Rows that a network answers with, where it may have chosen them."""
Answer = Callable[[Float[Tensor, "B 3 H W"]], Decoded]


class NotConvertible(Exception):
    """Says why a graph has no torch twin."""

    def __init__(self, why: str, way: str = "", untranslated: Sequence[dict[str, object]] = ()) -> None:
        """way: how to come by a file that has one; untranslated: {"op", "version", "node"} of each such operator."""
        super().__init__(why)
        self.way = way or f"export it with opset={NEWEST_SURE}, or name the .pt that it was exported from"
        self.untranslated = untranslated


def prepared(model: onnx.ModelProto) -> onnx.ModelProto:
    """Copy a model as `to_torch` takes it: nodes in the order they run, constants as weights, operators translatable.

    NotConvertible names the operators that are not.
    """
    from cloak_core.detectors.onnx_family.operators import make_translatable

    copied = type(model)()
    copied.CopyFrom(model)
    _sort(copied.graph)
    _lift_constants(copied.graph)
    try:
        missing = make_translatable(copied)
    except Exception as error:  # a damaged file's, which onnx meets where a tensor is first read
        raise _unexpected(error) from None
    if missing:
        first, more = missing[0], len(missing) - 1
        place = f"node {first['node']}{f' and {more} more' if more else ''}"
        why = f"no translation for {first['op']} of version {first['version']} ({place})"
        raise NotConvertible(why, untranslated=missing)
    return copied


def to_torch(model: onnx.ModelProto, fold: bool = True) -> fx.GraphModule:
    """Convert a `prepared` model to a torch module, frozen, batch norm folded after convolutions unless told not to.

    NotConvertible says what has no translation.
    """
    from onnx2torch import convert

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            graph = convert(model)
        graph.eval().requires_grad_(False)
        simplify(graph)
        if fold:
            fold_batch_norm(graph)
        activate_in_place(graph)
    except NotImplementedError as error:
        missing = getattr(error, "args", [""])[0]
        raise NotConvertible(f"no translation for {missing}") from None
    except Exception as error:  # whatever a translation meets that it did not expect
        raise _unexpected(error) from None
    return graph


def _unexpected(error: Exception) -> NotConvertible:
    return NotConvertible(f"{type(error).__name__}: {first_line(error)[:120]}")


def _sort(graph: onnx.GraphProto) -> None:
    """Order the nodes so that each comes after what it reads, in place: some exports list a cast after its use."""
    waiting, made_by = list(graph.node), {name for node in graph.node for name in node.output}
    done: set[str] = set()
    ordered = []
    while waiting:
        late = []
        for node in waiting:
            if made_by.intersection(reads(node)) <= done:
                ordered.append(node)
                done.update(node.output)
            else:
                late.append(node)
        if len(late) == len(waiting):
            raise NotConvertible(f"its graph runs in a circle (node {late[0].name or late[0].op_type})")
        waiting = late
    del graph.node[:]
    graph.node.extend(ordered)


def _lift_constants(graph: onnx.GraphProto) -> None:
    """Make Constant nodes and copies of weights weights, in place: onnx2torch looks for kernels and biases there alone.

    Exporters write equal biases once, and copy them by Identity nodes; of half precision, by a Cast to single.
    """
    weights = {weight.name: weight for weight in graph.initializer}
    for node in [n for n in graph.node if n.op_type in ("Constant", *COPIES)]:
        value = constant_of(node) if node.op_type == "Constant" else weights.get(node.input[0])
        if node.op_type == "Cast" and value is not None and node.attribute[0].i != value.data_type:
            value = None
        if value is not None:
            lifted = graph.initializer.add()
            lifted.CopyFrom(value)
            lifted.name = node.output[0]
            weights[lifted.name] = lifted  # of which another may be a copy
            graph.node.remove(node)


def as_input(images: Float[Tensor, "B 3 H W"], network: ModelFile | nn.Module) -> Tensor:
    """Order the axes as the network has them: exports of TensorFlow want channels last."""
    return images.permute(0, 2, 3, 1) if network.channels_last else images


class BlackBox(nn.Module):
    """A network that another runtime runs, as a module, on the CPU, without gradients."""

    def __init__(
        self,
        run: Callable[[np.ndarray], list[np.ndarray]],
        digest: str,
        channels_last: bool,
        one_by_one: bool,
        stop: Callable[[], object] = lambda: None,
    ) -> None:
        """run: images to outputs; digest: SHA-256 of the network's file; one_by_one: it takes one image at a time.

        stop: ends a run that takes too long, where the runtime can.
        """
        super().__init__()
        self.run, self.channels_last, self.one_by_one, self._stop = run, channels_last, one_by_one, stop
        # The runtime's weights are no tensors of ours; this stands for them in `state_hash`.
        self.register_buffer("digest", torch.frombuffer(bytearray.fromhex(digest), dtype=torch.uint8))

    @torch.no_grad()
    def forward(self, inputs: Float[Tensor, "B 3 H W"]) -> list[Tensor]:
        array = np.ascontiguousarray(as_input(inputs, self).cpu().numpy())
        chunks = np.split(array, len(array)) if self.one_by_one else [array]
        runs = [self._timed(chunk) for chunk in chunks]
        joined = (np.concatenate(parts) for parts in zip(*runs, strict=True))
        return [torch.from_numpy(part).float().to(inputs.device) for part in joined]

    def _timed(self, images: np.ndarray) -> list[np.ndarray]:
        """Run the network. InputError: it takes longer than any network taken here, as with a loop without end."""
        answers: Queue[list[np.ndarray] | Exception] = Queue()

        def work() -> None:
            try:
                answers.put(self.run(images))
            except Exception as error:  # the runtime's own
                answers.put(error)

        # Not a pool's thread: the process would wait for those when it ends.
        Thread(target=work, daemon=True).start()
        try:
            answer = answers.get(timeout=SECONDS * len(images))
        except Empty:
            self._stop()
            raise InputError(f"a network that takes more than {SECONDS:g} s for an image is not run") from None
        if isinstance(answer, Exception):
            raise answer
        return answer


class Session(BlackBox):
    """An ONNX file in onnxruntime, with torch's threads; image by image where the batch is fixed."""

    def __init__(self, file: ModelFile) -> None:
        """InputError: onnxruntime cannot run the file, in its words."""
        import onnxruntime

        options, run_options = onnxruntime.SessionOptions(), onnxruntime.RunOptions()
        options.log_severity_level = 3
        options.intra_op_num_threads = torch.get_num_threads()
        try:
            data = file.model.SerializeToString()
            session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime has a class of its own for each kind of broken file
            words = first_line(error)[:160]
            raise InputError(f"{file.path}: not an ONNX model that onnxruntime can run ({words})") from error
        super().__init__(
            lambda array: session.run(None, {file.input_name: array}, run_options),
            file.digest,
            file.channels_last,
            one_by_one=file.batch is not None,
            stop=lambda: setattr(run_options, "terminate", True),
        )


class Converted(nn.Module):
    """A converted graph with its outputs as a list; one image at a time where batches go wrong in it."""

    def __init__(self, graph: nn.Module, file: ModelFile, one_by_one: bool = False) -> None:
        super().__init__()
        self.graph, self.channels_last, self.one_by_one = graph, file.channels_last, one_by_one

    def forward(self, inputs: Float[Tensor, "B 3 H W"]) -> list[Tensor]:
        array = as_input(inputs, self)
        runs = [self.graph(part) for part in (array.split(1) if self.one_by_one else (array,))]
        runs = [[outputs] if isinstance(outputs, Tensor) else list(outputs) for outputs in runs]
        return runs[0] if len(runs) == 1 else [torch.cat(parts) for parts in zip(*runs, strict=True)]


class Verdict(NamedTuple):
    """Whether a converted network can be trained against."""

    why_not: str
    """"" where it can."""
    takes_batches: bool
    """Several images at once are answered as they are one by one."""


def compare(converted: Answer, original: Answer, images: Float[Tensor, "B 3 H W"]) -> Verdict:
    """Ask both about images as the network takes them (`original` image by image: it may not take several)."""
    with torch.no_grad():
        expected = [original(image) for image in images.split(1)]
        try:
            alone = [converted(image) for image in images.split(1)]
        except Exception as error:
            return Verdict(f"it fails in torch ({type(error).__name__}: {error})", False)
    batches, difference = takes_batches(converted, alone, images), apart(alone, expected)
    if not difference.same:
        figures = f"scores by {difference.scores:.1e}, boxes by {difference.boxes_px:.2f} px"
        return Verdict(f"converted to torch it answers otherwise than in onnxruntime ({figures})", batches)
    gradient = gradient_error(lambda pixels: sureness(converted(pixels).scores), images[:1])
    if gradient is None:
        return Verdict("its scores have no finite gradient in the image", batches)
    return Verdict("" if gradient <= AGREES else f"its gradient is {gradient:.0%} off a finite difference", batches)


@torch.no_grad()
def takes_batches(network: Answer, alone: list[Decoded], images: Float[Tensor, "B 3 H W"]) -> bool:
    """Tell whether a network answers several images at once as it does one by one (`alone`)."""
    try:
        together = network(images)
        parts = [Decoded(*(p if p is None else p[i : i + 1] for p in together)) for i in range(len(images))]
        return Apart(apart(parts, alone).scores, 0.0).same
    except Exception:  # a graph of a fixed batch fails in many ways
        return False


def remembered(key: str, find: Callable[[], Verdict]) -> Verdict:
    """Look up what was found for this content and these versions before, else find it now and remember it."""
    versions = [f"{name} {version(name)}" for name in ("torch", "onnx", "onnx2torch", "onnxruntime")]
    versions.append(code_hash("detectors/onnx_family"))
    name = sha256_arrays(np.frombuffer("\n".join([key, *versions]).encode(), np.uint8))
    files = DiskCache(cache_folder("onnx"), ".parity", LIMIT_BYTES, "checks of converted networks")
    known = files.get(name)
    if known is not None:
        with contextlib.suppress(InputError, TypeError):  # of another version
            return Verdict(**parse_json(known.tobytes(), name))
    found = find()
    files.put(name, json.dumps(found._asdict()).encode())
    return found


def apart(some: list[Decoded], others: list[Decoded]) -> Apart:
    """Find the largest difference of scores and of boxes; infinite where shapes differ or a number is not finite.

    Where a graph chooses its rows, rounding may exchange two of them: few rows are compared in any order, too.
    """
    worst = Apart(0.0, 0.0)
    for a, b in zip(some, others, strict=True):
        if a.boxes.shape != b.boxes.shape or a.classes.shape != b.classes.shape:
            return Apart(float("inf"), float("inf"))
        rows = [torch.cat([one.boxes[0], one.scores[0]], dim=1) for one in (a, b)]
        found = largest_difference(rows[0], rows[1])
        if not found.same and len(rows[0]) <= FEW:
            found = in_any_order(*rows)
        worst = worst.joined(found)
    return worst
