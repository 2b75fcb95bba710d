"""The DETR family, and whatever else transformers' AutoModelForObjectDetection loads; local files only."""

import copy
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode

from cloak_core.core.detector.protocol import Detections, Detector, at_least_float32
from cloak_core.detectors.checkpoints import fold_batch_norm
from cloak_core.detectors.classes import person_index
from cloak_core.detectors.decoding import queries
from cloak_core.detectors.pixels import IMAGENET, Placement
from cloak_core.detectors.specs import MAX_SIDE, Request, check_size
from cloak_core.files.errors import InputError, first_line
from cloak_core.files.identity import sha256_record
from cloak_core.files.reading import read_json


@dataclass(frozen=True)
class Preprocessing:
    """What a model's image processor does, differentiably: resize (antialiased, as PIL does), then normalise."""

    size: tuple[int, int] | None
    """(height, width) exactly; None for the short side below."""
    short_side: int = 800
    long_side: int = 1333
    """Upper bound where the short side rules."""
    mean: tuple[float, ...] = (0.0, 0.0, 0.0)
    std: tuple[float, ...] = (1.0, 1.0, 1.0)

    def __call__(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 h w"]:
        height, width = images.shape[2:]
        short, long = sorted((height, width))
        target = min(self.short_side, round(self.long_side * short / long))
        scaled = int(target * long / short)
        size = self.size or ((target, scaled) if height <= width else (scaled, target))
        if size != tuple(images.shape[-2:]):
            images = F.interpolate(images, size=size, mode="bilinear", align_corners=False, antialias=True)
        mean, std = (torch.tensor(v, device=images.device, dtype=images.dtype) for v in (self.mean, self.std))
        return (images - mean[:, None, None]) / std[:, None, None]


class Undetached(TorchFunctionMode):
    """Inside this mode `Tensor.detach` does nothing.

    RT-DETR and D-FINE cut the graph between decoder layers, and where they choose their queries, to steady their own
    training. Frozen, that leaves a gradient of the images that may not even point downhill; this is the exact one.
    """

    def __torch_function__(self, function, types, args=(), kwargs=None):
        return args[0] if function is torch.Tensor.detach else function(*args, **(kwargs or {}))


class TransformersDetector(Detector):
    """A transformers object-detection model: one box per query, its class probability for person as the score.

    Models whose logits have a class more than they have labels (DETR, YOLOS) mean "no object" by the last and take a
    softmax; the others (focal loss) a sigmoid.
    """

    def __init__(self, model: nn.Module, preprocessing: Preprocessing, person: int, name: str, spec: str) -> None:
        super().__init__(name, spec)
        self.model, self.preprocessing, self.person = model, preprocessing, person
        self.labels: int = model.config.num_labels

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        with Undetached() if images.requires_grad else nullcontext():
            output = self.model(pixel_values=self.preprocessing(images))
        logits, boxes = at_least_float32(output.logits), at_least_float32(output.pred_boxes)
        detections = queries(logits, boxes, images.shape[2:], exclusive=logits.shape[-1] == self.labels + 1)
        return detections.of_person(self.person, Placement())


def load_transformers(request: Request) -> TransformersDetector:
    """Load a model from a directory, or by name from the local cache, fetched there where that is allowed.

    No remote code is run; batch norm is folded where that changes nothing, unless told not to.
    InputError when the package is missing, the files are, weights are incomplete, or no label is the person.
    """
    folder = Path(request.what).expanduser()
    where = str(folder) if folder.is_dir() else request.what
    with nullcontext() if request.download else _offline():
        model = _read(where, request)
        preprocessing = _preprocessing(where, model.config.model_type, request)
    labels = model.config.id2label
    names = tuple(str(labels.get(index, "")) for index in range(model.config.num_labels))
    person = person_index(names, request.person, len(names), f"detector {request.spec!r}")
    model = _folded(model.eval(), preprocessing) if request.fold else model
    detector = TransformersDetector(model, preprocessing, person, folder.name, request.spec)
    detector.class_names = names
    # The configuration as the library understood it; where it was found says nothing about the model.
    config = {key: str(value) for key, value in model.config.to_dict().items() if key != "_name_or_path"}
    detector.source = {"config": sha256_record(config), "preprocessing": str(preprocessing), "person": person}
    detector.packages = ("transformers",)
    return detector.freeze()


def _read(where: str, request: Request) -> nn.Module:
    import transformers

    loud = transformers.logging.get_verbosity()  # how loud it is belongs to whoever else uses it in this process
    transformers.logging.set_verbosity_error()
    try:
        model, info = transformers.AutoModelForObjectDetection.from_pretrained(
            where, local_files_only=not request.download, output_loading_info=True, trust_remote_code=False
        )
    except Exception as error:  # transformers raises many kinds; each means that these files are not such a model
        why = f"cannot be loaded: {first_line(error)[:200]}"
        if not Path(request.what).expanduser().is_dir() and isinstance(error, OSError):
            why = "no such folder, and not in the local cache (allow --download, or fetch it with: hf download "
            why += f"{request.what})"
        raise InputError(f"detector {request.spec!r}: {why}") from error
    finally:
        transformers.logging.set_verbosity(loud)
    if info["missing_keys"] or info["mismatched_keys"]:
        keys = sorted(map(str, [*info["missing_keys"], *info["mismatched_keys"]]))
        raise InputError(
            f"detector {request.spec!r}: its files lack {len(keys)} of the model's tensors ({keys[0]} ...)"
        )
    broken = [name for name, p in model.named_parameters() if not bool(p.isfinite().all())]
    if broken:
        raise InputError(f"detector {request.spec!r}: {broken[0]} holds numbers that are not finite")
    return model


@contextmanager
def _offline() -> Iterator[None]:
    """Keep the library from the network inside; `local_files_only` alone does not stop all of its look-ups."""
    from huggingface_hub import constants

    before, constants.HF_HUB_OFFLINE = constants.HF_HUB_OFFLINE, True
    try:
        yield
    finally:
        constants.HF_HUB_OFFLINE = before


@torch.no_grad()
def _folded(model: nn.Module, preprocessing: Preprocessing) -> nn.Module:
    """Fold the model's batch norm, if it then still says the same."""
    folded = copy.deepcopy(model)
    if not fold_batch_norm(folded):
        return model
    pixels = preprocessing(torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(0)))
    before, after = (m(pixel_values=pixels).logits for m in (model, folded))
    return folded if torch.allclose(after, before, rtol=1e-3, atol=1e-3) else model


def _preprocessing(where: str, model_type: str, request: Request) -> Preprocessing:
    """Read the model's preprocessor_config.json; without one, take what the family was trained with."""
    from transformers.utils import cached_file

    path = cached_file(
        where, "preprocessor_config.json", local_files_only=not request.download,
        _raise_exceptions_for_missing_entries=False, _raise_exceptions_for_connection_errors=False,
    )  # fmt: skip
    if path is None:
        square = model_type.startswith(("rt_detr", "d_fine"))
        config = {"size": {"height": 640, "width": 640}, "do_normalize": False} if square else {}
    else:
        config = read_json(path)
    size = config.get("size") or {}
    size = {"shortest_edge": size} if isinstance(size, int) else size
    exact = (int(size["height"]), int(size["width"])) if "height" in size else None
    mean, std = (config.get("image_mean") or IMAGENET[0], config.get("image_std") or IMAGENET[1])
    plain = config.get("do_normalize") is False
    return Preprocessing(
        size=request.input_size or (exact and check_size(exact, where)),
        short_side=min(int(size.get("shortest_edge") or 800), MAX_SIDE),
        long_side=min(int(size.get("longest_edge") or config.get("max_size") or 1333), MAX_SIDE),
        mean=(0.0, 0.0, 0.0) if plain else tuple(map(float, mean)),
        std=(1.0, 1.0, 1.0) if plain else tuple(map(float, std)),
    )
