"""Networks that the package ultralytics builds, from descriptions in YAML: finding, checking and building them.

The package is imported so that it reaches no network and leaves the process as it found it.

A description may come with a file from anywhere, and what the package does with one could run code or fetch weights.
So it is looked through first: layers that the package itself defines, plain numbers, nothing that loads anything.
"""

from __future__ import annotations

import contextlib
import copy
import difflib
import importlib.util
import logging
import os
import re
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import PIL.Image
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.files.caching import cache_folder
from cloak_core.files.errors import InputError, first_line
from cloak_core.files.reading import read_text

PACKAGE = "ultralytics"
SWITCHES = {"YOLO_OFFLINE": "1", "YOLO_AUTOINSTALL": "0", "YOLO_VERBOSE": "0", "ULTRALYTICS_SAFE_LOAD": "1"}
"""What the package reads from the environment: no look-ups, no installing, no words, no evaluating of strings."""
_kept: list[tempfile.TemporaryDirectory] = []
"""Where nothing is cached: folders that last as long as the process."""
DENSE = ("Detect", "v10Detect", "Segment", "Segment26", "Pose", "Pose26")
"""Heads that give a box at every cell; what segmentation and pose say beyond that is not asked."""
QUERIES = "RTDETRDecoder"
FETCHING = ("TorchVision",)
"""Layers that load weights of their own."""
MAX_YAML_BYTES = 1 << 20
MAX_NUMBER, MAX_REPEATS, MAX_LAYERS = 1 << 14, 256, 1024
"""Of what layers are given; of the same layer in a row; of all."""
MAX_PARAMETERS = 1 << 29
"""2 GiB of float32."""
_ACTIVATION = re.compile(r"(?:torch\.)?nn\.[A-Za-z0-9]+\((?:[a-z_]+=)?(?:[0-9.e-]+|True|False)?\)\Z")
_SCALED = re.compile(r"(?P<family>.*\d)(?P<scale>[nsmlx])(?P<rest>-[a-z0-9-]+)?\Z")


@contextlib.contextmanager
def library() -> Iterator[ModuleType]:
    """Import `ultralytics.nn.tasks`, to build networks with inside this context.

    The switches stay in the environment, and its settings lie in our cache, never among the user's own. What importing
    it changes otherwise is put back: the environment, PIL.Image.open, torch.save, OpenCV's threads, how numpy and
    torch print, warnings. Nothing reaches standard output.
    """
    first = PACKAGE not in sys.modules
    if first:
        folder = cache_folder(PACKAGE)
        if folder is None:
            _kept.append(tempfile.TemporaryDirectory(prefix="cloak-ultralytics-"))
        os.environ.update(SWITCHES, YOLO_CONFIG_DIR=str(folder or _kept[0].name))
    with _unchanged(), contextlib.redirect_stdout(sys.stderr):
        tasks = importlib.import_module(f"{PACKAGE}.nn.tasks")
        importlib.import_module(f"{PACKAGE}.models.utils.ops")  # what RT-DETR imports when it first runs
        log = logging.getLogger(PACKAGE)
        if first:  # its own handler writes to standard output
            log.handlers.clear()
            log.propagate = True
        before = log.level
        log.setLevel(logging.CRITICAL)
        try:
            yield tasks
        finally:
            log.setLevel(logging.ERROR if first else before)


@contextlib.contextmanager
def _unchanged() -> Iterator[None]:
    """Put back what the package patches for the whole process."""
    import cv2

    environment, threads = dict(os.environ), cv2.getNumThreads()
    opens, saves = PIL.Image.open, torch.save
    numpy_prints, torch_prints = np.get_printoptions(), vars(torch._tensor_str.PRINT_OPTS).copy()
    try:
        with warnings.catch_warnings():
            yield
    finally:
        PIL.Image.open, torch.save = opens, saves
        np.set_printoptions(**numpy_prints)
        torch.set_printoptions(**torch_prints)
        cv2.setNumThreads(threads)
        for name in os.environ.keys() - environment.keys():
            del os.environ[name]
        os.environ.update(environment)


def read_architecture(where: str) -> dict:
    """Read a user's .yaml, or one that the package has, by name: yolov8n.yaml, yolo26s.yaml, rtdetr-l.yaml.

    InputError: no such file or name, not YAML.
    """
    import yaml  # comes with ultralytics

    path, match = Path(where).expanduser(), _SCALED.match(Path(where).stem)
    if not path.is_file():
        (folder,) = importlib.util.find_spec(PACKAGE).submodule_search_locations
        shipped = {file.name: file for file in sorted((Path(folder) / "cfg" / "models").rglob("*.yaml"))}
        unscaled = f"{match['family']}{match['rest'] or ''}.yaml" if match else ""
        name = next((name for name in (where, unscaled) if name in shipped), "")
        if not name or Path(where).name != where:
            near = ", ".join(difflib.get_close_matches(Path(where).name, shipped, 3, 0.5) or ["yolov8.yaml"])
            raise InputError(f"{where}: no such file, and ultralytics has none of that name (near: {near})")
        path = shipped[name]
    try:
        content = yaml.safe_load(read_text(path, MAX_YAML_BYTES))
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{where}: not YAML ({first_line(error)[:160]})") from None
    if not isinstance(content, dict):
        raise InputError(f"{where}: describes no network (backbone, head, nc)")
    if "scales" in content and match and "scale" not in content:
        content["scale"] = match["scale"]
    return content


def build(architecture: dict, where: str) -> nn.Module:
    """Build the network of a description, in eval mode, its weights random but always the same.

    InputError: a description that is none, asks for what is refused, or cannot be built.
    """
    with library() as tasks:
        match architecture.get("backbone"):
            case [[place, repeats, "Silence", arguments], *rest]:  # early YOLOv9 files call one layer so
                architecture = architecture | {"backbone": [[place, repeats, "nn.Identity", arguments], *rest]}
        head = check(architecture, tasks, where)
        kind = tasks.RTDETRDetectionModel if head == QUERIES else tasks.DetectionModel
        try:
            with torch.device("meta"):
                layers, _ = tasks.parse_model(copy.deepcopy(architecture), ch=3, verbose=False)  # takes no memory
            if sum(weights.numel() for weights in layers.parameters()) > MAX_PARAMETERS:
                raise ValueError("more parameters than any model taken here")
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(SEED)
                model = kind(copy.deepcopy(architecture), verbose=False)
        except Exception as error:  # layers fail in their own ways when they do not fit one another
            reason = f"{type(error).__name__}: {first_line(error)[:120]}"
            raise InputError(f"{where}: its network cannot be built ({reason})") from None
    return model.eval()


def fuse(model: nn.Module) -> None:
    """Fold batch norm into convolutions and join parallel branches, in place, as the package does it."""
    with library():
        model.fuse(verbose=False)


def check(architecture: dict, tasks: ModuleType, where: str) -> str:
    """Check a description, and give the name of its head. InputError: something is refused."""
    parts = [architecture.get(part) for part in ("backbone", "head")]
    layers = [layer for part in parts if isinstance(part, list) for layer in part]
    whole = all(isinstance(one, list | tuple) and len(one) == 4 and isinstance(one[1], int) for one in layers)
    if not layers or not whole or len(layers) > MAX_LAYERS:
        raise InputError(f"{where}: describes no network (backbone and head: lists of [from, number, module, args])")
    for _, repeats, name, arguments in layers:
        named = str(name)
        kind = getattr(nn, named[3:], None) if named.startswith("nn.") else getattr(tasks, named, None)
        is_layer = isinstance(name, str) and isinstance(kind, type) and issubclass(kind, nn.Module)
        if not is_layer or not kind.__module__.startswith(("torch.nn.", "ultralytics.nn.modules.")):
            raise InputError(f"{where}: a layer {str(name)[:60]!r}, which is none of ultralytics' or torch's")
        if name in FETCHING:
            raise InputError(f"{where}: a layer {name}, which fetches weights of its own")
        if not _plain(arguments) or not 1 <= repeats <= MAX_REPEATS:
            raise InputError(f"{where}: a layer {name} with {str(arguments)[:60]}, more than is taken here")
    activation = architecture.get("activation")
    if activation is not None and not (isinstance(activation, str) and _ACTIVATION.match(activation)):
        raise InputError(f"{where}: an activation {str(activation)[:60]!r}, which is not one of torch.nn's")
    others = [value for key, value in architecture.items() if key not in ("backbone", "head")]
    if not _plain(others) or not isinstance(architecture.get("nc"), int):
        raise InputError(f"{where}: no number of classes (nc), or numbers larger than any taken here")
    channels = architecture.get("channels", architecture.get("ch", 3))
    if channels != 3:
        raise InputError(f"{where}: its network takes {channels} channels, not the three of an RGB image")
    head = layers[-1][2]
    if head not in (*DENSE, QUERIES):
        raise InputError(f"{where}: its head is {head}; detection is needed ({', '.join(DENSE)} or {QUERIES})")
    return head


def _plain(value: object, depth: int = 0) -> bool:
    """Tell whether a value is numbers, words, and lists and dictionaries of these, none of them large."""
    if isinstance(value, dict):
        value = [*value.values(), *map(str, value)]
    if isinstance(value, list | tuple):
        return depth < 8 and len(value) <= MAX_NUMBER and all(_plain(part, depth + 1) for part in value)
    if isinstance(value, int | float):
        return abs(value) <= MAX_NUMBER
    return value is None or (isinstance(value, str) and len(value) <= 256)


SEED = 0
SIDE, SCALES = 128, (2, 4, 8, 16, 32, 64, 128)
"""Of the noise images, in pixels: their sides, and how many patches across there are at each scale."""


def settle_batch_norm(model: nn.Module) -> None:
    """Set batch norm from noise images, in place, the same on every machine.

    As weights are drawn, the signal loses some of itself in every layer, until scores no longer depend on the image to
    seven digits, and the gradient with it; so each batch norm is set to what noise brings to it, layer by layer
    (compare arXiv:1511.06422). Worked out in float64, for threads change sums in float32.
    """
    generator = torch.Generator().manual_seed(SEED)
    patches = [torch.rand(2, 3, n, n, dtype=torch.float64, generator=generator) - 0.5 for n in SCALES]
    noise = (0.5 + sum(F.interpolate(p, size=SIDE, mode="bilinear") for p in patches)).clamp(0, 1)
    hooks = [m.register_forward_pre_hook(_settle) for m in model.modules() if isinstance(m, nn.BatchNorm2d)]
    with torch.no_grad():
        model.double()(noise)
    for hook in hooks:
        hook.remove()
    model.float()


def _settle(norm: nn.BatchNorm2d, inputs: tuple[Float[Tensor, "B C h w"]]) -> None:
    (x,) = inputs
    norm.running_mean.copy_(x.mean(dim=(0, 2, 3)))
    # One for all channels: one that noise hardly reaches would be blown up by whatever does reach it in a photograph.
    norm.running_var.fill_(x.var(dim=(0, 2, 3), correction=0).mean())
