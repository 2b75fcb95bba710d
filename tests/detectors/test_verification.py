"""Checking a detector: every family passes the kit, and what is wrong is named; how its network wants pixels."""

import json
from pathlib import Path

import pytest
import torch
from PIL import Image
from torch import Tensor, nn

from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.detectors.check import check_image, plausibility
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.verification import verify
from cloak_core.detectors.verification.comparing import apart
from cloak_core.detectors.verification.kit import CHECKS
from tests.detectors.helpers import images, write_tiny

KEYS = dict.fromkeys(("parity_scores", "parity_boxes_px", "gradient_error", "forward_ratio", "operating_point"), float)
KEYS |= {"spec": str, "layout": str, "white_box": bool, "batch_invariant": bool, "person_class": int, "failed": list}


class Fake(Detector):
    """Says how bright each quarter of an image is; `wrong` bends one of its promises."""

    def __init__(self, wrong: str = "") -> None:
        super().__init__("fake", "fake")
        self.wrong, self.calls = wrong, 0
        self.register_buffer("state", torch.zeros(1))

    def detect(self, images: Tensor) -> Detections:
        count, _, height, width = images.shape
        scores = nn.functional.adaptive_avg_pool2d(images, 2).mean(1).flatten(1)
        x, y = torch.meshgrid(torch.arange(2.0) * width / 2, torch.arange(2.0) * height / 2, indexing="xy")
        corner = torch.stack([x, y], -1).view(1, 4, 2).expand(count, -1, -1)
        boxes = torch.cat([corner, corner + torch.tensor([width / 2, height / 2])], -1)
        self.calls += 1
        return self.bent(images, boxes, scores)

    def bent(self, images: Tensor, boxes: Tensor, scores: Tensor) -> Detections:
        match self.wrong:
            case "shapes":
                scores = scores[:, :3]
            case "scores in [0, 1]":
                scores = scores * 3
            case "boxes":
                boxes = boxes.flip(-1)
            case "repeatable":
                scores = scores + 1e-6 * self.calls
            case "batch invariance":
                scores = (scores + scores.flip(0)) / 2
            case "black, white, noise":
                scores = scores / (images.amax() > images.amin())
            case "gradient":
                scores = scores.detach() + 0 * scores
            case "state":
                self.state += 1
            case "another size":
                boxes = boxes * 32 / images.shape[3]
            case "raises":
                raise KeyError("weights")
        return Detections(boxes, scores)


def test_nothing_is_wrong_with_a_sound_wrapper() -> None:
    report = verify(Fake())
    assert report["failed"] == [] and set(report["checks"]) == {*CHECKS, "state"}
    assert report["parity_scores"] is None and report["forward_ratio"] is None and report["person_class"] is None
    assert report["gradient_error"] < 0.03 and report["batch_invariant"] is True


@pytest.mark.parametrize("wrong", [name for name in CHECKS if name not in ("descent", "parity", "speed")] + ["state"])
def test_a_broken_promise_is_found(wrong: str) -> None:
    failed = verify(Fake(wrong), images(4))["failed"]
    assert wrong in failed and ("descent" in failed or wrong != "gradient")


def test_another_answer_than_the_originals_is_found() -> None:
    report = verify(Fake(), images(4), original=Fake("batch invariance"))
    assert report["failed"] == [] and report["parity_scores"] < 1e-6  # alone it answers alike
    report = verify(Fake(), images(4), original=Fake("scores in [0, 1]"))
    assert report["failed"] == ["parity"] and report["parity_scores"] > 0.1 and report["forward_ratio"] > 0


def test_rows_in_another_order_are_the_same_answer() -> None:
    boxes = torch.rand(1, 6, 4, generator=torch.Generator().manual_seed(0)) * 50
    scores = torch.tensor([[0.9, 0.5, 0.2, 0.0, 0.1, 0.3]])
    turned = Detections(boxes.flip(1), scores.flip(1))
    padded = Detections(torch.cat([boxes, 0 * boxes], 1), torch.cat([scores, 0 * scores], 1))
    for other in (turned, padded):
        assert apart(Detections(boxes, scores), other, (64, 64)) == (0, 0)
    moved = boxes.clone()
    moved[0, 1] += 0.5
    assert apart(Detections(boxes, scores), Detections(moved.flip(1), scores.flip(1)), (64, 64)).boxes_px == 0.5
    missing = apart(Detections(boxes, scores), Detections(boxes[:, 1:], scores[:, 1:]), (64, 64))
    assert not missing.same
    nothing = Detections(boxes[:, :0], scores[:, :0])
    assert apart(nothing, nothing, (64, 64)).same and not apart(Detections(boxes, scores), nothing, (64, 64)).same


@pytest.mark.slow
@pytest.mark.parametrize("family", ["builtin", "darknet"])
def test_our_own_families(family: str, tmp_path: Path) -> None:
    spec = "builtin@64" if family == "builtin" else write_tiny(tmp_path)
    report = verify(load_detector(spec), images(4, 64, 64))
    assert report["failed"] == [] and report["layout"] == family
    assert {key: type(report[key]) for key in KEYS} == KEYS


EXAMPLE = Path(__file__).parents[2] / "examples" / "my_detector.py"


@pytest.mark.slow
def test_the_worked_example() -> None:
    report = verify(load_detector(f"python:{EXAMPLE}:load"), images(4, 90, 120))
    assert report["failed"] == [] and report["white_box"] and report["layout"] == "python"


def test_a_forgotten_conversion_of_boxes_is_found_at_another_size(tmp_path: Path) -> None:
    text = EXAMPLE.read_text("utf-8")
    forgotten = text.replace("return boxes * boxes.new_tensor([width / SIDE, height / SIDE] * 2)", "return boxes")
    assert forgotten != text
    (tmp_path / "forgotten.py").write_text(forgotten)
    report = verify(load_detector(f"python:{tmp_path / 'forgotten.py'}:load"), images(4, 256, 256))
    assert report["failed"] == ["another size"] and "4 stay as they were" in report["checks"]["another size"]["words"]


@pytest.mark.slow
def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    from cloak_core.cli import main

    spec = write_tiny(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(["detectors", "verify", spec, "--renders", "2", "--json", "--events", str(tmp_path / "events.jsonl")])
    report = json.loads(capsys.readouterr().out)
    events = [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()]
    assert [event["step"] for event in events] == [*range(events[0]["steps"] + 1)] == [*range(len(CHECKS) + 3)]
    assert end.value.code == 0 and report["spec"] == spec and {*KEYS} <= set(report)
    (tmp_path / "bad.py").write_text(
        "import torch\n\nclass Bad(torch.nn.Module):\n    def forward(self, images):\n"
        "        return torch.ones(len(images), 1, 4), images.mean((1, 2, 3))[:, None] - 0.5\n\nload = Bad\n"
    )
    bad = f"python:{tmp_path / 'bad.py'}:load"
    with pytest.raises(SystemExit) as end:
        main(["detectors", "verify", spec, bad, "--renders", "1"])
    printed = capsys.readouterr()
    assert end.value.code == 1 and "failed: shapes" in printed.err and bad in printed.err and spec not in printed.err
    assert "FAILED" in printed.out and "unchanged, bit by bit" in printed.out
    for arguments, words in (("--images nowhere", "no such folder"), ("--renders 0", "some images are needed")):
        with pytest.raises(SystemExit) as end:
            main(["detectors", "verify", "builtin", *arguments.split()])
        assert end.value.code == 2 and words in capsys.readouterr().err


def test_what_else_is_told_is_checked_too() -> None:
    class Telling(Fake):
        def __init__(self, number: int = 1, wrong: bool = False) -> None:
            super().__init__()
            self.class_names, self.number, self.wrong = ("person", "dog"), number, wrong

        def detect(self, images: torch.Tensor) -> Detections:
            found = super().detect(images)
            other = (1 - found.scores) / (len(images) if self.wrong else 1)
            return found._replace(other=other, other_class=torch.full_like(other, self.number, dtype=torch.int64))

    assert verify(Telling(), images(4))["failed"] == []
    assert verify(Telling(number=2), images(4))["failed"] == ["scores in [0, 1]"]
    assert "batch invariance" in verify(Telling(wrong=True), images(4))["failed"]
    assert "parity" in verify(Telling(), images(4), original=Fake())["failed"]


def save(tensor: torch.Tensor, path: Path) -> Path:
    Image.fromarray((tensor.permute(1, 2, 0) * 255).to(torch.uint8).numpy()).save(path)
    return path


def test_check_gives_score_boxes_and_picture(tmp_path: Path) -> None:
    detector = load_detector(write_tiny(tmp_path))
    file = save(images(1, 48, 80)[0], tmp_path / "in.png")
    result = check_image(detector, file, threshold=0.1, out=tmp_path / "out.png")
    assert set(result) == {"max_person", "boxes", "operating_point", "operating_point_assumed", "reported"}
    assert result["boxes"] and result["boxes"][0][4] == pytest.approx(result["max_person"])
    picture = Image.open(tmp_path / "out.png")
    assert picture.size == (80, 48) and picture.tobytes() != Image.open(file).tobytes()
    high = check_image(detector, file, threshold=0.9999)
    assert high == result | {"boxes": []}


def test_what_the_detector_itself_reports(tmp_path: Path) -> None:
    spec, file = write_tiny(tmp_path), save(images(1, 48, 80)[0], tmp_path / "in.png")
    usual = check_image(load_detector(spec), file)
    assert usual["operating_point_assumed"] and usual["operating_point"] == 0.25
    low, high = (check_image(load_detector(f"{spec}@conf={point}"), file) for point in (0.01, 0.99))
    assert low["reported"] > high["reported"] == 0 and not low["operating_point_assumed"]


BOXES = torch.tensor([[10.0, 10, 30, 50, 0.9], [60, 20, 80, 40, 0.5]])


def mirrored(boxes: torch.Tensor, width: int = 100) -> torch.Tensor:
    return torch.stack([width - boxes[:, 2], boxes[:, 1], width - boxes[:, 0], boxes[:, 3], boxes[:, 4]], dim=1)


def test_boxes_that_a_mirror_image_shows_too_are_plausible() -> None:
    assert plausibility(BOXES, mirrored(BOXES), 100) == 1.0
    assert plausibility(BOXES, BOXES, 100) == plausibility(BOXES[:0], BOXES, 100) == 0.0
    crowd = torch.cat([BOXES, BOXES + torch.tensor([3.0, 40, 3, 40, 0])])
    assert 0 < plausibility(crowd, mirrored(BOXES), 100) < plausibility(BOXES, mirrored(BOXES), 100)
