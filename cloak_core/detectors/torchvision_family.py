"""torchvision's detection models by its own names: Faster, Mask and Keypoint R-CNN, RetinaNet, FCOS, SSD and SSDlite.

Scores are of every proposal or of the best anchors, before threshold and suppression. A checkpoint comes from a file or
from the torch cache.
"""

from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn.utils.rnn import pad_sequence
from torchvision import models
from torchvision.models import detection
from torchvision.models.detection.image_list import ImageList
from torchvision.models.detection.rpn import concat_box_prediction_layers
from torchvision.models.detection.ssd import SSD
from torchvision.ops import clip_boxes_to_image

from cloak_core.core.detector.outcomes import best_other
from cloak_core.core.detector.protocol import Detections, Detector, at_least_float32
from cloak_core.detectors.checkpoints import fold_batch_norm, load_state, read_state_dict
from cloak_core.detectors.classes import person_index
from cloak_core.detectors.pixels import Placement
from cloak_core.detectors.specs import Request
from cloak_core.files.errors import InputError
from cloak_core.files.writing import replace_file

CANDIDATES = 1000
"""Anchors kept per feature level, the ones with the best person score."""
MIN_SIDE = 1e-2
"""The model drops boxes with a smaller side, in pixels of its input."""
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


class TorchvisionDetector(Detector):
    """A torchvision model that scores class `person`; `channels_last` is the layout of its images and weights."""

    first_class = 1
    """Where classes begin that are something; before it stands the background, if any."""

    def __init__(self, model: nn.Module, person: int, name: str, spec: str, channels_last: bool = True) -> None:
        super().__init__(name, spec)
        self.person = person
        self.memory_format = torch.channels_last if channels_last else torch.contiguous_format
        self.model = model.to(memory_format=self.memory_format)

    def prepare(self, images: Float[Tensor, "B 3 H W"]) -> tuple[ImageList, Placement]:
        """Resize and normalise by the model's own transform; say where the images lie in its input."""
        batch, _ = self.model.transform(list(images))
        batch.tensors = batch.tensors.contiguous(memory_format=self.memory_format)
        height, width = batch.image_sizes[0]
        return batch, Placement(scale_x=width / images.shape[3], scale_y=height / images.shape[2])


def _with_others(
    persons: Detections, boxes: Float[Tensor, "B m 4"], scores: Float[Tensor, "B m"], number: Int[Tensor, "B m"]
) -> Detections:
    """Add rows of other classes, which have boxes of their own: each row is of a person or of another class alone."""
    count = persons.scores.shape[1]
    return Detections(
        boxes=torch.cat([persons.boxes, boxes], dim=1),
        scores=F.pad(persons.scores, (0, scores.shape[1])),
        other=F.pad(scores, (count, 0)),
        other_class=F.pad(number, (count, 0)),
    )


class DenseDetector(TorchvisionDetector):
    """A torchvision RetinaNet, FCOS or SSD."""

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        batch, placement = self.prepare(images)
        outputs, levels = self.raw(batch)
        anchors, coder = self.model.anchor_generator(batch, levels)[0], self.model.box_coder
        decode = coder.decode if isinstance(self.model, detection.FCOS) else coder.decode_single
        cells = [level.shape[2] * level.shape[3] for level in levels]
        per_cell, rest = divmod(len(anchors), sum(cells))
        # SSD's levels differ in anchors per cell: all of its anchors are one level here.
        counts = [len(anchors)] if rest else [count * per_cell for count in cells]

        def best(ranks: Float[Tensor, "B A"]) -> tuple[Tensor, Tensor, Tensor]:
            """Find boxes and scores of one class where it scores best, and the anchors that these are."""
            scores = self._scores(ranks, outputs)
            kept = _best_per_level(scores, counts)
            deltas = outputs["bbox_regression"].gather(1, kept[..., None].expand(-1, -1, 4)).reshape(-1, 4)
            boxes = clip_boxes_to_image(decode(deltas, anchors[kept.reshape(-1)]), batch.image_sizes[0])
            return placement.restore(boxes).view(*kept.shape, 4), scores.gather(1, kept), kept

        # What ranks an anchor's classes: probabilities where they exclude each other, else logits.
        classes = outputs["cls_logits"]
        classes = classes.softmax(dim=-1) if isinstance(self.model, SSD) else classes
        boxes, scores, _ = best(classes[..., self.person])
        other = best_other(classes, self.person, self.first_class)
        if other.scores is None:
            return Detections(boxes, scores)
        # Among the best persons there may be none of the anchors that show something else.
        other_boxes, other_scores, kept = best(other.scores)
        return _with_others(Detections(boxes, scores), other_boxes, other_scores, other.number.gather(1, kept))

    def raw(self, batch: ImageList) -> tuple[dict[str, Float[Tensor, "B A _"]], list[Tensor]]:
        """Run the heads: every anchor's values before any activation, at least float32, and the feature maps."""
        features = self.model.backbone(batch.tensors)
        levels = [features] if isinstance(features, Tensor) else list(features.values())
        return {key: at_least_float32(value) for key, value in self.model.head(levels).items()}, levels

    def _scores(self, ranks: Float[Tensor, "B A"], outputs: dict[str, Tensor]) -> Float[Tensor, "B A"]:
        """Turn what ranks one class into its scores, as the model thresholds them."""
        if isinstance(self.model, SSD):
            return ranks
        if isinstance(self.model, detection.FCOS):
            # The model's sqrt(p * q), written so that its gradient stays finite where p * q underflows.
            return (0.5 * (F.logsigmoid(ranks) + F.logsigmoid(outputs["bbox_ctrness"][..., 0]))).exp()
        return ranks.sigmoid()


def _best_per_level(scores: Float[Tensor, "B A"], counts: list[int]) -> Int[Tensor, "B n"]:
    """Choose the anchors with the best scores of each feature level; counts: its anchors."""
    best = []
    first = 0
    for level in scores.detach().split(counts, dim=1):
        best.append(level.topk(min(CANDIDATES, level.shape[1]), dim=1).indices + first)
        first += level.shape[1]
    return torch.cat(best, dim=1)


class TwoStageDetector(TorchvisionDetector):
    """A torchvision GeneralizedRCNN. Masks and keypoints are not computed."""

    partial_gradient = "the places of proposals are held fixed, as in the model's own training"

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        batch, placement = self.prepare(images)
        features = self.features(batch)
        proposals = self.propose(batch, features, *self.of_anchors(features))
        logits, deltas = self.of_proposals(batch, features, proposals)
        counts = [len(part) for part in proposals]

        def padded(rows: Tensor) -> Tensor:
            return pad_sequence(rows.split(counts), batch_first=True)

        def boxes_of(deltas: Float[Tensor, "n 4"], scores: Float[Tensor, " n"]) -> tuple[Tensor, Tensor]:
            """Place boxes in the images; their scores, 0 for boxes that the model drops."""
            boxes = self.model.roi_heads.box_coder.decode_single(deltas, torch.cat(proposals))
            boxes = clip_boxes_to_image(boxes, batch.image_sizes[0])
            scores = scores * ((boxes[:, 2:] - boxes[:, :2]) >= MIN_SIDE).all(dim=-1)
            return padded(placement.restore(boxes)), padded(scores)

        classes = logits.softmax(dim=-1)
        found = Detections(*boxes_of(deltas[:, self.person], classes[:, self.person]))
        other = best_other(classes[None], self.person, self.first_class)
        if other.scores is None:
            return found
        # A box for each class: what else a proposal may be has rows of its own.
        number = other.number[0]
        own = deltas.gather(1, number[:, None, None].expand(-1, 1, 4))[:, 0]
        return _with_others(found, *boxes_of(own, other.scores[0]), padded(number))

    def features(self, batch: ImageList) -> dict[str, Float[Tensor, "B C _ _"]]:
        """Compute the feature maps by level."""
        found = self.model.backbone(batch.tensors)
        return {"0": found} if isinstance(found, Tensor) else found

    def of_anchors(
        self, features: dict[str, Float[Tensor, "B C _ _"]]
    ) -> tuple[list[Float[Tensor, "B _ _ _"]], list[Float[Tensor, "B _ _ _"]]]:
        """Run the first stage on every anchor, by level: logits of an object, and offsets of its box."""
        return self.model.rpn.head(list(features.values()))

    def of_proposals(
        self, batch: ImageList, features: dict[str, Float[Tensor, "B C _ _"]], proposals: list[Float[Tensor, "_ 4"]]
    ) -> tuple[Float[Tensor, "n K"], Float[Tensor, "n K 4"]]:
        """Run the second stage on proposals, those of all images in a row.

        Logits of the classes, the background first, and for each class the offsets of its box.
        """
        head = self.model.roi_heads
        pooled = head.box_roi_pool(features, proposals, batch.image_sizes)
        logits, deltas = head.box_predictor(head.box_head(pooled))
        return at_least_float32(logits), at_least_float32(deltas.unflatten(1, (-1, 4)))

    @torch.no_grad()
    def propose(
        self,
        batch: ImageList,
        features: dict[str, Float[Tensor, "B C _ _"]],
        logits: list[Float[Tensor, "B _ _ _"]],
        deltas: list[Float[Tensor, "B _ _ _"]],
    ) -> list[Float[Tensor, "_ 4"]]:
        """Choose each image's proposals from `of_anchors`, best first; constants, as in the model."""
        rpn = self.model.rpn
        anchors = rpn.anchor_generator(batch, list(features.values()))
        flat_logits, flat_deltas = map(at_least_float32, concat_box_prediction_layers(logits, deltas))
        boxes = rpn.box_coder.decode(flat_deltas, anchors).view(len(anchors), -1, 4)
        return rpn.filter_proposals(boxes, flat_logits, batch.image_sizes, [level[0].numel() for level in logits])[0]


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
