"""Defences before a detector: what they do to pictures, to gradients, to boxes, and to a detector's identity.

The theorem of `masked=SIDE:SPEC` is tried by brute force over every place of a patch; one pixel blinds that detector.
"""

import itertools
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
import torch.nn.functional as F

from cloak_core import cli
from cloak_core.core.detector.outcomes import share_within
from cloak_core.core.detector.protocol import Detections, Detector, detector_record, state_hash
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.core.images import ImageSet
from cloak_core.core.logo import Cover
from cloak_core.detectors.defended.detector import Bits, Blur, Jpeg, Median, ResizePad, defend
from cloak_core.detectors.defended.masking import EntropyMask, SegmenterMask, local_entropy
from cloak_core.detectors.defended.masks import EXPLAINED, spans
from cloak_core.detectors.defended.table import DEFENCES, list_defences
from cloak_core.detectors.families import list_families
from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from cloak_core.patterns.controls import OwnClothing
from cloak_core.studies.clean import certified_recall
from cloak_core.studies.trained_run import trained_against
from tests.core.fakes import MadeViews, Says, around, noise_backgrounds, photograph_view
from tests.detectors.helpers import TINY_CFG, images, write_tiny
from tests.sources.photographs.made_people import write_people

HEADS = ("jpeg=75", "blur=1", "median=3", "bits=4", "resize-pad", "entropy-mask", "segment")


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> str:
    return write_tiny(tmp_path_factory.mktemp("tiny"))


def test_tells_what_else_the_inner_detector_sees(tmp_path) -> None:
    cfg = TINY_CFG.replace("filters=12", "filters=14").replace("classes=1", "classes=2")
    spec = write_tiny(tmp_path, cfg, names=("cat", "person"))
    inner, defended = load_detector(spec), load_detector(f"blur=0.5:{spec}")
    found = defended(images(2))
    assert defended.class_names == ("cat", "person") and found.other.shape == found.scores.shape
    torch.testing.assert_close(found.other, inner(Blur(0.5)(images(2))).other)


def square(size: int = 96) -> torch.Tensor:
    """A white square on mid-grey: x in 24..56, y in 40..72."""
    picture = torch.full((1, 3, size, size), 0.5)
    picture[:, :, 40:72, 24:56] = 1
    return picture


@pytest.mark.parametrize("head", HEADS)
def test_keeps_what_the_inner_detector_says_of_itself_and_carries_a_gradient(tiny: str, head: str) -> None:
    inner, defended = load_detector(f"{tiny}@96,conf=0.3"), load_detector(f"{head}:{tiny}@96,conf=0.3")
    assert defended.spec == f"{head}:{inner.spec}"
    assert (defended.operating_point, defended.operating_point_assumed) == (0.3, False)
    assert defended.person == inner.person
    assert defended.source["input_size"] == [96, 96]
    pixels = images(2).requires_grad_()
    found = defended(pixels)
    assert found.boxes.shape == inner(images(2)).boxes.shape
    max_person_score(found).sum().backward()
    assert (pixels.grad.flatten(1).abs().sum(1) > 0).all()
    assert not any(parameter.requires_grad for parameter in defended.parameters())


@pytest.mark.slow
@pytest.mark.parametrize("head", HEADS)
def test_an_image_is_answered_alike_alone_and_in_a_batch(tiny: str, head: str) -> None:
    defended = load_detector(f"{head}:{tiny}")
    batch = images(3)
    together = defended(batch).scores
    alone = torch.cat([defended(batch[i : i + 1]).scores for i in range(3)])
    torch.testing.assert_close(together, alone, atol=1e-5, rtol=1e-4)


def test_what_rounds_passes_its_gradient_straight_through() -> None:
    assert set(Bits(1.0)(images(1)).flatten().tolist()) == {0.0, 1.0}
    pixels = images(1, 16, 16).requires_grad_()
    upstream = torch.randn(1, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    for defence in (Bits(2.0), Jpeg(20.0)):
        (gradient,) = torch.autograd.grad(defence(pixels), pixels, upstream)
        torch.testing.assert_close(gradient, upstream)


@pytest.mark.parametrize("levels", [None, 8])
def test_the_median_of_nine_by_minima_and_maxima_is_the_median(levels: int | None) -> None:
    pixels = torch.rand(2, 3, 17, 13, generator=torch.Generator().manual_seed(0))
    pixels = pixels if levels is None else (pixels * levels).round() / levels  # many ties
    pixels.requires_grad_()
    height, width = pixels.shape[2:]
    around = F.pad(pixels, (1,) * 4, mode="replicate")
    nine = [around[:, :, y : y + height, x : x + width] for y in range(3) for x in range(3)]
    plain, ours = torch.stack(nine).median(dim=0).values, Median(3.0)(pixels)
    assert torch.equal(ours, plain)
    if levels is None:  # where pixels tie, the gradient is shared; at the border, replicated pixels do
        inner = (slice(None), slice(None), slice(1, -1), slice(1, -1))
        gradients = [torch.autograd.grad(found[inner].sum(), pixels, retain_graph=True)[0] for found in (ours, plain)]
        assert torch.equal(gradients[0][:, :, 2:-2, 2:-2], gradients[1][:, :, 2:-2, 2:-2])


def test_boxes_come_back_from_the_random_place() -> None:
    bright = Says(lambda images: images.mean((1, 2, 3)), lambda images: around(images.mean(1) > 0.75))
    found = defend(bright, "resize-pad=0.4")(square())
    torch.testing.assert_close(found.boxes[0, 0], torch.tensor([24.0, 40, 56, 72]), atol=1.5, rtol=0)


def test_the_random_place_follows_from_the_image_and_changes_with_it() -> None:
    pad = ResizePad(0.3)
    assert torch.equal(pad.placed(square())[1], pad.placed(square())[1])
    other = square()
    other[0, 0, 0, 0] = 0
    assert not torch.equal(pad.placed(square())[1], pad.placed(other)[1])
    windows = pad.placed(torch.rand(64, 3, 8, 8, generator=torch.Generator().manual_seed(1)))[1]
    assert float(windows[:, 0].min()) >= 1
    assert float(windows[:, 0].max()) <= 1 / 0.7
    assert bool((windows[:, 1:].abs().amax(1) <= windows[:, 0] - 1 + 1e-6).all())


def noisy_square() -> torch.Tensor:
    """A square of noise on mid-grey: x and y in 48..112."""
    picture = torch.full((1, 3, 160, 160), 0.4)
    picture[:, :, 48:112, 48:112] = torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    return picture


def test_an_entropy_mask_paints_over_noise_alone() -> None:
    picture = noisy_square()
    bits = local_entropy(picture)[0, 0]
    assert float(bits[0, 0]) < 1.01 and float(bits[9, 9]) > 3.5  # a level between two bins; noise
    seen = EntropyMask(2.9)(picture)
    assert float((seen[:, :, 56:104, 56:104] - 0.4).abs().mean()) < 0.12
    assert torch.equal(seen[:, :, :24], picture[:, :, :24])


def test_a_mask_is_attacked_through_the_picture_and_through_its_own_decision() -> None:
    picture = noisy_square().requires_grad_()
    mask = EntropyMask(2.9)
    (through_all,) = torch.autograd.grad(mask(picture)[:, :, 70:80, 70:80].sum(), picture)
    assert bool((through_all[:, :, 70:80, 70:80] != 0).all())
    (decision,) = torch.autograd.grad(mask.evidence(picture).sum(), picture)
    assert float(decision.abs().sum()) > 0


def test_a_defended_detector_is_another_detector(tiny: str) -> None:
    plain, strong, weak = (load_detector(spec) for spec in (tiny, f"bits=2:{tiny}", f"bits=7:{tiny}"))
    assert len({state_hash(detector) for detector in (plain, strong, weak, load_detector(f"blur=2:{tiny}"))}) == 4
    assert detector_record(strong)["source"]["inner"] == detector_record(plain)["source"]
    config = {"detectors": [detector_record(strong)]}
    asked = {"same": load_detector(f"bits=2:{tiny}"), "weak": weak, "plain": plain}
    assert trained_against(config, asked) == {"same": True, "weak": False, "plain": False}


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("jpeg=0:builtin", "jpeg=0 must give its quality, a whole number in 1..100, as jpeg=QUALITY:SPEC"),
        ("jpeg=75.5:builtin", "must give its quality"),
        ("jpeg:builtin", "must give its quality"),
        ("jpeg=much:builtin", "must give its quality"),
        ("blur=nan:builtin", "must give its standard deviation"),
        ("median=4:builtin", "an odd number in 3..9"),
        ("masked=0:builtin", "masked=0 must give its side of the patch in pixels"),
        ("blur=1:jpeg=75", "names no detector behind it; expected jpeg=QUALITY:SPEC"),
        ("jpg=75:builtin", "unknown family 'jpg=75'.*or a defence before one: jpeg=QUALITY:SPEC"),
        ("blur=1:nothing", "unknown family 'nothing'"),
    ],
)
def test_bad_defences_are_refused_in_one_line(spec: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        load_detector(spec)
    assert "\n" not in str(caught.value)


def test_the_segmenter_masks_a_patch_of_noise_and_leaves_a_plain_wall() -> None:
    picture = torch.full((1, 3, 208, 208), 0.6)
    cells = torch.rand(1, 3, 10, 10, generator=torch.Generator().manual_seed(2))
    picture[:, :, 70:130, 60:120] = torch.nn.functional.interpolate(cells, (60, 60))
    evidence = SegmenterMask(0.5).evidence(picture)[0, 0]
    assert float(evidence[75:125, 65:115].mean()) > 0.5
    evidence[62:138, 52:128] = 0
    assert float(evidence.mean()) < 0.05
    lenient, strict = (SegmenterMask(p).evidence(picture).mean() for p in (0.1, 0.9))
    assert float(lenient) > float(strict)


def test_the_table_is_told_with_the_families() -> None:
    assert [row["defence"] for row in list_families()["defences"]] == list(DEFENCES)
    assert {row["spec"] for row in list_defences()} >= {"jpeg=QUALITY:SPEC", "resize-pad[=LARGEST]:SPEC"}


SIZE, WINDOW, PATCH = 20, 4, 3
BODY = (4.0, 4.0, 16.0, 16.0)
BLIND, DECOY = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


class Fragile(Detector):
    """Windows are people as far as they are bright. A red pixel anywhere blinds it, a blue one is a person all over."""

    def __init__(self) -> None:
        super().__init__("fragile", "fragile")
        self.freeze()

    def detect(self, images: torch.Tensor) -> Detections:
        bright = images.amin(1).unfold(1, WINDOW, 2).unfold(2, WINDOW, 2).mean((3, 4))
        places = torch.arange(0, SIZE - WINDOW + 1, 2.0)
        y, x = torch.meshgrid(places, places, indexing="ij")
        boxes = torch.stack([x, y, x + WINDOW, y + WINDOW], -1).flatten(0, 1)
        boxes = torch.cat([boxes, torch.tensor([[0.0, 0.0, SIZE, SIZE]])]).expand(len(images), -1, 4)
        sees = lambda color: (images == torch.tensor(color)[:, None, None]).all(1).flatten(1).any(1).float()[:, None]
        scores = torch.cat([bright.flatten(1) * (1 - sees(BLIND)), sees(DECOY)], 1)
        return Detections(boxes, scores)


def person() -> torch.Tensor:
    image = torch.full((3, SIZE, SIZE), 0.1)
    image[:, 4:16, 4:16] = 0.9
    return image


@pytest.mark.parametrize("length", [1, 5, 20, 33, 416])
@pytest.mark.parametrize("patch", [1, 3, 7, 32])
def test_a_mask_covers_every_place_of_the_patch(length: int, patch: int) -> None:
    placed, patch = spans(length, patch), min(length, patch)
    assert len(placed) <= 6 and all(0 <= begin < end <= length for begin, end in placed)
    for at in range(length - patch + 1):
        assert any(begin <= at and at + patch <= end for begin, end in placed)


@pytest.mark.long
def test_what_is_certified_holds_for_every_place_and_content_of_the_patch() -> None:
    inner = Fragile()
    defended, body = defend(inner, f"masked={PATCH}"), torch.tensor([BODY])
    on_body = lambda found: torch.where(share_within(found.boxes, body) >= 0.5, found.scores, 0.0).amax(1)
    floor = torch.stack([on_body(found) for found in defended.defence.answers(inner, person()[None])]).amin()
    assert floor > 0.8, "some window of the person is under no mask"
    windows = [
        torch.tensor([x, y, x + WINDOW, y + WINDOW])
        for y, x in itertools.product(range(4, 13, 2), repeat=2)  # windows on the body alone
    ]
    attacked = []
    for y, x in itertools.product(range(SIZE - PATCH + 1), repeat=2):
        for colors in ((BLIND,), (DECOY,), (BLIND, DECOY), ((0.0, 0.0, 0.0),)):
            image = person()
            for k, color in enumerate(colors):
                image[:, y : y + PATCH, x + k : x + PATCH] = torch.tensor(color)[:, None, None]
            attacked.append(image)
    attacked = torch.stack(attacked)
    assert (inner(attacked).scores[:, :-1].amax(1) == 0).any(), "the patch works on the detector alone"
    found = defended(attacked)
    inside = torch.stack([_held(window, found.boxes) for window in windows], -1).amax(-1)
    kept = ((found.scores >= floor) & (inside >= EXPLAINED)).any(1)
    assert kept.all(), f"{(~kept).sum()} patches hide the certified person"


def _held(window: torch.Tensor, boxes: torch.Tensor) -> torch.Tensor:
    """The share of a window that lies in each box."""
    sides = (torch.minimum(boxes[..., 2:], window[2:]) - torch.maximum(boxes[..., :2], window[:2])).clamp(min=0)
    return sides.prod(-1) / WINDOW**2


def test_boxes_under_masks_that_the_whole_image_explains_are_dropped() -> None:
    defended = defend(Fragile(), f"masked={PATCH}")
    found, alone = defended(person()[None]), Fragile()(person()[None])
    clean = int((alone.scores > 0.8).sum())
    assert int((found.scores > 0.8).sum()) == clean > 0, "nothing is reported twice"
    assert found.boxes.shape[1] == alone.boxes.shape[1] + 36 * alone.boxes.shape[1]


def stills() -> ImageSet:
    """One person in clear view and one of whom a mask hides more than half."""
    small = torch.full((3, SIZE, SIZE), 0.1)
    small[:, 8:12, 8:12] = 0.9
    views = [photograph_view(image, image[0] > 0.5) for image in (person(), small)]
    return ImageSet(MadeViews(*views), noise_backgrounds(), (SIZE, SIZE), trials=pd.DataFrame({"pose": [0, 1]}))


def test_certified_recall_is_the_share_found_under_every_mask() -> None:
    own = OwnClothing(Cover(np.zeros(1, np.int64), "stills"))
    recall = certified_recall(defend(Fragile(), f"masked={PATCH}"), stills(), own, 0.7)
    assert recall == {"certified_recall": 0.5, "certified_recall_own": 1.0, "patch": PATCH}
    assert certified_recall(Fragile(), stills(), own, 0.7) == {}, "without masks nothing is certified"


@pytest.mark.slow
def test_the_command_certifies_people_in_photographs(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    people = write_people(tmp_path / "people", 2)
    with pytest.raises(SystemExit) as caught:
        cli.main(["detectors", "check", f"masked=16:{write_tiny(tmp_path)}", "--people", str(people), "--json"])
    result = json.loads(capfd.readouterr().out)
    assert caught.value.code == 0 and (result["n"], result["patch"]) == (2, 16)
    assert result["certified_recall_own"] <= result["clean_recall_own"]
