"""Models by torchvision's own names, with a checkpoint from a file or the torch cache."""

from pathlib import Path

import torch
from torch import nn
from torchvision import models
from torchvision.models import detection

from cloak_core.core.detector.protocol import Detector
from cloak_core.detectors.checkpoints import load_state, read_state_dict
from cloak_core.detectors.classes import person_index
from cloak_core.detectors.folding import fold_batch_norm
from cloak_core.detectors.specs import Request
from cloak_core.detectors.torchvision_family.detectors import DenseDetector, TwoStageDetector
from cloak_core.files.errors import InputError
from cloak_core.files.writing import replace_file

RANDOM = "random"
"""As a checkpoint: seeded random weights, for timing and tests."""
BACKGROUND = "__background__"
EPS_ZERO = {
    "fasterrcnn_resnet50_fpn",
    "maskrcnn_resnet50_fpn",
    "keypointrcnn_resnet50_fpn",
    "retinanet_resnet50_fpn",
}
"""torchvision runs the official checkpoints of these, which hold frozen batch norm, with epsilon 0."""
CLASS_WEIGHTS = (
    "roi_heads.box_predictor.cls_score.weight",
    "head.classification_head.cls_logits.weight",
    "head.classification_head.module_list.0.weight",
    "head.classification_head.module_list.0.1.weight",
)
"""Whose rows are proportional to the number of classes, background included."""


def model_names() -> list[str]:
    """List every detection model of the installed torchvision."""
    return models.list_models(module=detection)


def load_torchvision(request: Request) -> Detector:
    """Load a torchvision detection model, frozen, batch norm folded unless told not to.

    The checkpoint is a file, none for the official one in the torch cache (fetched there where that is allowed), or
    "random". An input size (one side) is the short side for the R-CNNs, RetinaNet and FCOS, the side of the square for
    SSD; a (height, width) that is not square is taken exactly. InputError names what is unknown, missing or does not
    fit.
    """
    name, checkpoint = (*request.parts, "")[:2]
    if name not in model_names():
        raise InputError(f"detector {request.spec!r}: torchvision has no {name!r}; it has {', '.join(model_names())}")
    weights = models.get_model_weights(name).DEFAULT
    categories = tuple(weights.meta["categories"])
    if checkpoint == RANDOM:
        model, count = _build(name, len(categories)), len(categories)
    else:
        path = Path(checkpoint).expanduser() if checkpoint else _cached(weights, request)
        model, count = _read(name, path, len(categories))
    known = categories if count == len(categories) else None
    person = person_index(known, request.person, count, request.spec)
    if request.input_size is not None:
        transform, (height, width) = model.transform, request.input_size
        if transform.fixed_size is not None or height != width:
            transform.fixed_size = (width, height)
        else:
            transform.max_size = max(height, round(transform.max_size * height / transform.min_size[-1]))
            transform.min_size = (height,)
    model.eval()
    if request.fold:
        fold_batch_norm(model)
    return wrapped(model, person, name, request.spec, known, channels_last=request.fold)


def wrapped(
    model: nn.Module, person: int, name: str, spec: str, names: tuple[str, ...] | None, channels_last: bool
) -> Detector:
    """Make a frozen detector of a torchvision detection model; names: of its classes, None where nobody said."""
    kind = TwoStageDetector if isinstance(model, detection.generalized_rcnn.GeneralizedRCNN) else DenseDetector
    detector = kind(model, person, name, spec, channels_last=channels_last)
    detector.class_names = names
    scored_apart = isinstance(model, detection.RetinaNet | detection.FCOS)
    if scored_apart and (names is None or names[0] != BACKGROUND):
        detector.first_class = 0
    sizes = (model.transform.min_size, model.transform.max_size, model.transform.fixed_size)
    detector.source = {"model": name, "transform": str(sizes), "person": person}
    detector.packages = ("torchvision",)
    return detector.freeze()


def write_torchvision(path: Path, name: str, model: nn.Module) -> None:
    """Write an unfolded model's weights so that `torchvision:NAME:PATH` is that model again: a plain state dict."""
    state = {key: value.detach().cpu() for key, value in model.state_dict().items()}
    if name in EPS_ZERO and all(m.eps == 0 for m in model.modules() if isinstance(m, nn.BatchNorm2d)):
        # By their absence a reader tells the official checkpoints, and what was made of them.
        state = {key: value for key, value in state.items() if not key.endswith("num_batches_tracked")}
    replace_file(path, lambda file: torch.save(state, file))


def _read(name: str, path: Path, classes: int) -> tuple[nn.Module, int]:
    """Read a checkpoint into the model; count the classes of its weights, `classes` or their own number."""
    state = read_state_dict(path)
    model = _build(name, classes)
    own = model.state_dict()
    key = next((key for key in CLASS_WEIGHTS if key in own and key in state), None)
    if key is None:
        raise InputError(f"{path}: not a checkpoint of this model, it lacks the classification layer")
    count = state[key].shape[0] * classes // own[key].shape[0]
    model = model if count == classes else _build(name, count)
    load_state(model, state, path)
    if name in EPS_ZERO and not any(key.endswith("num_batches_tracked") for key in state):
        for norm in model.modules():
            if isinstance(norm, nn.BatchNorm2d):
                norm.eps = 0.0
    return model, count


def _build(name: str, classes: int) -> nn.Module:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return models.get_model(name, weights=None, weights_backbone=None, num_classes=classes)


def _cached(weights: models.WeightsEnum, request: Request) -> Path:
    path = Path(torch.hub.get_dir()) / "checkpoints" / weights.url.rsplit("/", 1)[1]
    if path.is_file():
        return path
    if not request.download:
        raise InputError(
            f"detector {request.spec!r}: no checkpoint at {path}; put {weights.url} there, give "
            "torchvision:NAME:CHECKPOINT, or allow --download"
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        # The name ends in the first digits of the file's SHA-256, which torch checks.
        torch.hub.download_url_to_file(weights.url, str(path), path.stem.rsplit("-", 1)[1], progress=False)
    except (OSError, RuntimeError) as error:
        raise InputError(f"detector {request.spec!r}: {weights.url} cannot be fetched ({error})") from error
    return path
