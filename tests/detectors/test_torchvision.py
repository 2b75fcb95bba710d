"""Every torchvision detection model against the model's own post-processed output."""

from pathlib import Path

import pytest
import torch
from torch import Tensor, nn
from torchvision import models
from torchvision.models.detection.generalized_rcnn import GeneralizedRCNN
from torchvision.models.detection.ssd import SSD
from torchvision.ops import FrozenBatchNorm2d

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.detector.scoring import max_person_score, person_boxes
from cloak_core.detectors import torchvision_family
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.torchvision_family import model_names
from cloak_core.files.errors import InputError
from tests.detectors.helpers import images, lowers_score, others_are_the_rest

PERSON = 1
PROPOSALS = 12
SIDE = 64
"""Short side the models work at; SSD keeps its own."""


def lively(model: nn.Module) -> nn.Module:
    """Random weights that answer: batch statistics that are not trivial, and class scores spread over (0, 1)."""
    generator = torch.Generator().manual_seed(5)
    with torch.no_grad():
        for module in model.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.running_mean.copy_(0.2 * torch.randn(module.running_mean.shape, generator=generator))
                module.running_var.copy_(torch.rand(module.running_var.shape, generator=generator) + 0.5)
                module.weight.copy_(torch.rand(module.weight.shape, generator=generator) * 0.4 + 0.8)
        _settle(model)
    return model.eval()


def _settle(model: nn.Module) -> None:
    """Scale every convolution and linear layer so that its outputs are of order one on a sample."""

    def scale(module: nn.Module, inputs: tuple, output: Tensor) -> Tensor:
        factor = output.std() if output.numel() > 1 else torch.tensor(1.0)
        if factor > 0 and not hasattr(module, "settled"):
            module.settled = True
            module.weight.div_(factor)
            if module.bias is not None:
                module.bias.div_(factor)
            return output / factor
        return output

    layers = [m for m in model.modules() if isinstance(m, (nn.Conv2d, nn.Linear))]
    hooks = [layer.register_forward_hook(scale) for layer in layers]
    model.eval()
    model(list(images(1, SIDE, SIDE)))
    for hook in hooks:
        hook.remove()


def small(model: nn.Module) -> nn.Module:
    """Few proposals, hardly a score threshold, no limit on detections; small inputs."""
    if isinstance(model, GeneralizedRCNN):
        model.roi_heads.mask_roi_pool = model.roi_heads.keypoint_roi_pool = None  # of every detection: gigabytes
        model.rpn._post_nms_top_n = {"training": PROPOSALS, "testing": PROPOSALS}
        model.roi_heads.score_thresh = 0.0
        model.roi_heads.detections_per_img = 10**6
    else:
        model.score_thresh = threshold_of(model)
        model.topk_candidates = model.detections_per_img = 10**6
    if model.transform.fixed_size is None:
        model.transform.min_size, model.transform.max_size = (SIDE,), SIDE * 2
    return model


def threshold_of(model: nn.Module) -> float:
    """0, but for SSD, whose thousands of boxes take long to suppress."""
    return 0.5 if isinstance(model, SSD) else 0.0


def nms_of(model: nn.Module) -> float:
    return model.roi_heads.nms_thresh if isinstance(model, GeneralizedRCNN) else model.nms_thresh


class Case:
    """torchvision's own model, and the checkpoint of its weights."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name = name
        # Few classes, so that torchvision's suppression per class stays quick; keypoint models have two anyway.
        self.classes = 2 if name.startswith("keypoint") else 3
        with torch.random.fork_rng():
            torch.manual_seed(1)
            model = models.get_model(name, weights=None, weights_backbone=None, num_classes=self.classes)
        self.model = lively(small(model))
        self.path = folder / f"{name}.pth"
        torch.save(self.model.state_dict(), self.path)

    def load(self, **more) -> Detector:
        detector = load_detector(f"torchvision:{self.name}:{self.path}@person={PERSON}", **more)
        small(detector.model)
        return detector


KINDS = (
    "fasterrcnn_mobilenet_v3_large_320_fpn",
    "retinanet_resnet50_fpn",
    "fcos_resnet50_fpn",
    "ssd300_vgg16",
    "ssdlite320_mobilenet_v3_large",
)


@pytest.mark.long
@pytest.mark.parametrize("name", model_names())
def test_equals_the_models_own(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Detections to 1e-5 and 1e-2 px on several images, and the gradient of the best score."""
    monkeypatch.setattr(torchvision_family, "CANDIDATES", 10**6)
    case = Case(name, tmp_path)
    detector = case.load()
    assert not [m for m in detector.modules() if isinstance(m, (nn.BatchNorm2d, FrozenBatchNorm2d))]
    # Double precision, so that folding shows as rounding alone, however deep the random network (SSD's VGG has none).
    dtype = torch.float32 if name == "ssd300_vgg16" else torch.float64
    model, detector = case.model.to(dtype), detector.to(dtype)
    count = 2 if isinstance(model, SSD) else 5  # SSD enlarges them to 300 pixels and more
    batch = images(count, 60, 90, seed=9).to(dtype)
    with torch.no_grad():
        drawn = person_boxes(detector(batch), threshold=threshold_of(model), nms=nms_of(model))
        for own, their in zip(drawn, model(list(batch)), strict=True):
            person = their["labels"] == PERSON
            scores, boxes = their["scores"][person].float(), their["boxes"][person].float()
            assert len(scores) > 0
            torch.testing.assert_close(own[:, 4], scores, rtol=0, atol=1e-5)
            # As sets: equal scores come in any order.
            apart = torch.cdist(own[:, :4], boxes, compute_mode="donot_use_mm_for_euclid_dist")
            assert max(apart.amin(dim=0).max(), apart.amin(dim=1).max()) < 1e-2
    if dtype == torch.float32:
        return  # its best anchors tie within rounding, so their gradients are not comparable; SSDlite's are
    image = batch[:1].requires_grad_()
    their = model(list(image))[0]
    (expected,) = torch.autograd.grad(their["scores"][their["labels"] == PERSON].max(), image)
    (gradient,) = torch.autograd.grad(max_person_score(detector(image)).sum(), image)
    assert expected.abs().max() > 0
    torch.testing.assert_close(gradient, expected, rtol=1e-3, atol=float(1e-4 * expected.abs().max()))


@pytest.mark.long
@pytest.mark.parametrize("name", [KINDS[0], KINDS[1], KINDS[2], KINDS[4]])
def test_tells_the_best_other_class(name: str, tmp_path: Path) -> None:
    case = Case(name, tmp_path)
    first = 0 if name.startswith(("retinanet", "fcos")) else 1  # these two score each class by itself

    def load(number: int) -> Detector:
        detector = load_detector(f"torchvision:{name}:{case.path}@person={number + first}")
        assert detector.class_names is None and detector.first_class == first
        small(detector.model)
        return detector

    batch = images(2, 60, 90, seed=9)
    if first:  # classes are told by the network's own numbers, the background being 0
        found = load(0)(batch)
        assert int(found.other_class.max()) == 2
        with torch.no_grad():
            torch.testing.assert_close(found.other.amax(1), max_person_score(load(1)(batch)), rtol=1e-4, atol=1e-6)
        return
    others_are_the_rest(load, 3, 1, batch)


@pytest.mark.long
@pytest.mark.parametrize("name", KINDS)
def test_a_gradient_step_lowers_the_score(name: str, tmp_path: Path) -> None:
    """As the model is, and fully fooled: with its scores for persons pushed to nothing."""
    case = Case(name, tmp_path)
    detector, batch = case.load().double(), images(1, 60, 90).double()
    before, after = lowers_score(detector, batch)
    assert bool((after < before).all())
    for parameter, values in detector.model.named_parameters():
        if values.dim() == 1 and ("cls" in parameter or "classification" in parameter) and not len(values) % 3:
            values.view(-1, 3)[:, PERSON] -= 25
    before, after = lowers_score(detector, batch)
    assert before.max() < 1e-3 and bool((after < before).all())


@pytest.mark.long
def test_input_size_and_cut_candidates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    detector = Case("retinanet_resnet50_fpn", tmp_path).load()
    batch = images(1, 120, 150)
    with torch.no_grad():
        full = detector(batch)
        monkeypatch.setattr(torchvision_family, "CANDIDATES", 10)
        cut = detector(batch)
    assert cut.scores.shape[1] < full.scores.shape[1]
    assert torch.equal(max_person_score(cut), max_person_score(full))
    path = tmp_path / "retinanet_resnet50_fpn.pth"
    sized = load_detector(f"torchvision:retinanet_resnet50_fpn:{path}@64,person=1")
    assert sized.model.transform.min_size == (64,) and sized.model.transform.max_size == 107
    fixed = load_detector("torchvision:ssdlite320_mobilenet_v3_large:random@256")
    assert fixed.model.transform.fixed_size == (256, 256)
    assert fixed(batch).boxes.shape[0] == 1


@pytest.mark.long
def test_frozen_batch_norm_of_official_checkpoints(tmp_path: Path) -> None:
    """Files without step counts are frozen batch norm; torchvision runs these with epsilon 0."""
    name = "retinanet_resnet50_fpn"
    case = Case(name, tmp_path)
    for module in case.model.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.eps = 0.0
    case.model.backbone.body.bn1.running_var.mul_(1e-4)  # where an epsilon shows
    state = {key: value for key, value in case.model.state_dict().items() if not key.endswith("num_batches_tracked")}
    torch.save(state, case.path)
    folded, plain = case.load(), case.load(fold=False)
    assert not [m for m in plain.modules() if isinstance(m, nn.BatchNorm2d) and m.eps != 0]
    batch = images(1, 64, 64)
    for detector in (folded, plain):
        body = detector.model.backbone.body(batch)["0"]
        torch.testing.assert_close(body, case.model.backbone.body(batch)["0"], rtol=1e-3, atol=1e-3)


def test_missing_official_checkpoint_says_where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    with pytest.raises(InputError, match=r"no checkpoint at .*ssd300_vgg16_coco-.*pth; put https://.* there"):
        load_detector("torchvision:ssd300_vgg16")


class Malicious:
    def __reduce__(self):
        return (Path("/tmp/cloak-was-here").touch, ())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"a": Malicious()}, r"x.pth: refused, it holds pickled objects"),
        ({"a": 3}, r"x.pth: not a plain state dict"),
        ({"a": torch.tensor([float("nan")])}, r"x.pth: a holds numbers that are not finite"),
        ({"a": torch.zeros(2)}, r"x.pth: not a checkpoint of this model, it lacks the classification layer"),
        (b"garbage", r"x.pth: (cannot be read|refused)"),
    ],
)
def test_bad_checkpoints(content: object, message: str, tmp_path: Path) -> None:
    path = tmp_path / "x.pth"
    path.write_bytes(content) if isinstance(content, bytes) else torch.save(content, path)
    with pytest.raises(InputError, match=message) as caught:
        load_detector(f"torchvision:ssdlite320_mobilenet_v3_large:{path}")
    assert "\n" not in str(caught.value) and not Path("/tmp/cloak-was-here").exists()


@pytest.mark.slow
def test_checkpoint_of_another_model(tmp_path: Path) -> None:
    case = Case("ssdlite320_mobilenet_v3_large", tmp_path)
    with pytest.raises(InputError, match=r"names of its 3 classes are unknown; give @person="):
        load_detector(f"torchvision:{case.name}:{case.path}")
    state = case.model.state_dict()
    removed = next(iter(state))
    del state[removed]
    torch.save({"model": state, "epoch": 3}, case.path)
    with pytest.raises(InputError, match=rf"does not fit the model: 1 tensors missing \({removed}"):
        case.load()
