"""What a .pt file of ultralytics or of the original YOLOv5 says: the network's description, its weights, its classes.

Nothing of it is run and no class that it names is imported: see `files.torch_pickles`.
"""

from __future__ import annotations

import copy
import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.detectors.classes import names_of
from cloak_core.detectors.ultralytics_family.architecture import library
from cloak_core.detectors.ultralytics_family.heads import DenseHead
from cloak_core.files.errors import InputError, first_line
from cloak_core.files.reading import MAX_BYTES, open_regular
from cloak_core.files.torch_pickles import read_torch_pickle, rewrite_torch_pickle
from cloak_core.files.unpickling import Record
from cloak_core.files.writing import replace_file

MAX_DEPTH, MAX_MODULES = 64, 1 << 16
"""Of modules inside modules, and of all together."""


@dataclass(frozen=True)
class Checkpoint:
    """A model as a file has it."""

    path: Path
    digest: str
    """SHA-256 (hex) of the file."""
    original: bool
    """Of the original YOLOv5, whose boxes grow from anchors."""
    architecture: dict
    """The description of its network that the model carries."""
    state: dict[str, Tensor]
    """Names and tensors, float32 where they are no counts."""
    modules: dict[str, Record]
    """All modules by their names."""
    names: tuple[str, ...] | None
    """Of its classes; None where it only numbers them."""
    image_size: tuple[int, int] | None
    """(height, width) that it was trained at, where that is said."""

    anchors: Float[Tensor, "levels A 2"] | None = None
    """Of the original YOLOv5: widths and heights in pixels."""
    strides: tuple[float, ...] = ()
    """Of the feature maps that these stand on."""


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint.

    InputError: what `read_torch_pickle` refuses, no model of the two kinds, numbers not finite.
    """
    content = read_torch_pickle(path)
    with open_regular(path, MAX_BYTES) as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    try:
        return _understood(content, path, digest)
    except InputError:
        raise
    except (KeyError, IndexError, AttributeError, TypeError, ValueError, OverflowError) as error:
        # Records hold whatever the file says.
        raise InputError(f"{path}: its model is damaged ({type(error).__name__}: {first_line(error)[:80]})") from None


def _understood(content: object, path: Path, digest: str) -> Checkpoint:
    model = _model(content, path)
    architecture = model.state.get("yaml")
    if not isinstance(architecture, dict):
        raise InputError(f"{path}: its model carries no description of its network (yaml)")
    original = _original(model, architecture, path)
    modules = _modules(model, path)
    state = _state(modules, path)
    arguments = content.get("train_args") if isinstance(content, dict) else None
    size = arguments.get("imgsz") if isinstance(arguments, dict) else None
    sides = size if isinstance(size, list | tuple) else [size]
    is_size = 1 <= len(sides) <= 2 and all(isinstance(side, int) and side > 0 for side in sides)
    anchors, strides = None, ()
    if original:
        head = f"model.{len(modules['model'].state['_modules']) - 1}"
        strides = tuple(float(stride) for stride in modules[head].state["stride"])
        anchors = state[f"{head}.anchors"] * torch.tensor(strides)[:, None, None]
    names = names_of(model.state.get("names"))
    if names == tuple(map(str, range(len(names or ())))):  # each is but its number
        names = None
    size = (sides[0], sides[-1]) if is_size else None
    return Checkpoint(path, digest, original, architecture, state, modules, names, size, anchors, strides)


def _model(content: object, path: Path) -> Record:
    """Find the model in a checkpoint: its averaged one where it has one, as those who run it take it."""
    module = content
    if isinstance(content, dict):
        module = content.get("ema") or content.get("model")
    if isinstance(module, Record) and isinstance(module.state.get("_modules"), dict):
        return module
    arrays = isinstance(content, dict) and any(isinstance(value, np.ndarray) for value in content.values())
    if arrays or isinstance(module, dict):
        raise InputError(
            f"{path}: a state dict alone, which does not say what network it is for; "
            "give the checkpoint that ultralytics or YOLOv5 wrote (its 'model' is a whole model)"
        )
    raise InputError(f"{path}: no checkpoint of ultralytics or YOLOv5 (its 'model' is no model)")


def _original(model: Record, architecture: dict, path: Path) -> bool:
    """Tell whether it is of the original YOLOv5. InputError: of neither kind, or nothing that detects."""
    module, name = type(model).__module__, type(model).__name__
    if module.startswith("ultralytics."):
        return False
    head = architecture["head"][-1][2]
    if module == "models.yolo" and name in ("Model", "DetectionModel") and head == "Detect":
        return True
    raise InputError(
        f"{path}: its model is {module}.{name} with the head {head}; "
        "of such pickles only original YOLOv5 detection models are read: export it to ONNX and use onnx:FILE"
    )


def _modules(model: Record, path: Path) -> dict[str, Record]:
    """List a model and all modules below it, by their names."""
    modules: dict[str, Record] = {}
    waiting = [("", model)]
    while waiting:
        name, record = waiting.pop()
        modules[name] = record
        if name.count(".") > MAX_DEPTH or len(modules) > MAX_MODULES:
            raise InputError(f"{path}: modules inside modules without end")
        inner = [(f"{name}.{child}".lstrip("."), part) for child, part in record.state.get("_modules", {}).items()]
        waiting += [(place, part) for place, part in reversed(inner) if isinstance(part, Record)]
    return modules


def _state(modules: dict[str, Record], path: Path) -> dict[str, Tensor]:
    state, left = {}, MAX_BYTES
    for prefix, record in modules.items():
        apart = record.state.get("_non_persistent_buffers_set", ())
        tensors = [*record.state.get("_parameters", {}).items(), *record.state.get("_buffers", {}).items()]
        for name, value in tensors:
            if not isinstance(value, np.ndarray) or name in apart:
                continue
            left -= value.nbytes
            if left < 0:
                raise InputError(f"{path}: its tensors take more memory than any model taken here")
            key = f"{prefix}.{name}".lstrip(".")
            state[key] = torch.from_numpy(value.astype(np.float32) if value.dtype.kind == "f" else value.copy())
            if state[key].is_floating_point() and not bool(state[key].isfinite().all()):
                raise InputError(f"{path}: {key} holds numbers that are not finite")
    return state


def write_ultralytics(path: Path, network: nn.Module, source: Path) -> None:
    """Write a network that was loaded, unfolded, from `source`.

    From a .pt: that file with the network's parameters in the place of its own (in the precision that it keeps them
    in, mostly half), so that whatever else it says stays. From a .yaml: a whole model of the package, in float32.
    InputError: as `read_checkpoint`; a parameter that the file does not have in this shape.
    """
    if source.suffix.lower() != ".pt":
        with library():
            model = copy.deepcopy(network)
            model.model[-1] = model.model[-1].replaced[0]
            content = {"model": model.cpu().requires_grad_(False), "ema": None}
            replace_file(path, lambda file: torch.save(content, file))
        return
    head, last = network.model[-1], f"model.{len(network.model) - 1}."
    parameters = dict(network.named_parameters())
    if isinstance(head, DenseHead):  # under the names that they have in files
        parameters = {name: value for name, value in parameters.items() if not name.startswith(last)}
        parameters |= {f"{last}{name}": value for name, value in head.replaced[0].named_parameters()}

    def replace(content: object) -> None:
        modules = _modules(_model(content, source), source)
        for name, value in parameters.items():
            module, _, own = name.rpartition(".")
            there = modules[module].state["_parameters"].get(own) if module in modules else None
            if not isinstance(there, np.ndarray) or there.shape != tuple(value.shape):
                raise InputError(f"{source}: has no {name} of {tuple(value.shape)}")
            there[...] = value.detach().cpu().numpy()

    rewrite_torch_pickle(source, path, replace)
