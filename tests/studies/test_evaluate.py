"""Evaluation end to end on small images: real bodies, real renders, detectors that look for something simple."""

import json
import logging
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from cloak_core.commands.evaluate import show_success
from cloak_core.core.detector.outcomes import on_body
from cloak_core.core.detector.protocol import Detections, Detector, state_hash
from cloak_core.core.evaluation.controls import random_colors
from cloak_core.core.evaluation.renderer import BodyRenderer, EvaluationRenderer, render_images
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.logo import Logo, make_logo, select_region
from cloak_core.core.paint import compose
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.products.run_report import make_report
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.studies.cloaked import Cloaked
from cloak_core.studies.evaluate import evaluate, make_renderer, read_evaluation

SMALL = EvaluateSettings(images_per_view=2, size=64, shift=6, samples=1, resamples=100, batch=4, bare=5)
ANGLES = (-10.0, 10.0)


class GreenBlind(Detector):
    """Reports a person (one box over the middle) in every image, unless some of it is pure green."""

    def __init__(self) -> None:
        super().__init__("green-blind", "green-blind")
        self.weight = torch.nn.Parameter(torch.ones(1))
        self.seen: list[Tensor] = []
        self.freeze()

    def forward(self, images: Tensor) -> Detections:
        self.seen.append(images)
        count, _, height, width = images.shape
        green = (images[:, 1] - torch.maximum(images[:, 0], images[:, 2])).flatten(1).amax(1)
        box = torch.tensor([0.25 * width, 0.1 * height, 0.75 * width, 0.9 * height])
        return Detections(box.expand(count, 1, 4), (0.95 - 0.9 * (green > 0.35).float())[:, None])


@pytest.fixture(scope="module")
def bodies() -> Bodies:
    return sample_bodies("unseen").select_poses([0, 2])


@pytest.fixture(scope="module")
def logo(bodies: Bodies) -> Logo:
    return make_logo(bodies, select_region(bodies, "chest+thighs"))


def grey_rooms(count: int) -> Backgrounds:
    """Flat backgrounds, each another grey."""
    draw = lambda index, height, width: np.full((height, width, 3), 60 + 10 * index, np.uint8)
    return Backgrounds([f"room {i}" for i in range(count)], draw)


def green(logo: Logo) -> np.ndarray:
    return np.tile(np.array([0, 1, 0], np.float32), (len(logo), 1))


def in_green(logo: Logo, bodies: Bodies, rooms: int = 5) -> Cloaked:
    return Cloaked(green(logo), logo, bodies, grey_rooms(rooms))


def test_contract_and_controls(bodies: Bodies, logo: Logo) -> None:
    detector = GreenBlind()
    told = []
    worn = in_green(logo, bodies)
    result = evaluate(worn, {"spec": detector}, ANGLES, SMALL, on_progress=lambda *p: told.append(p))
    json.dumps(result, allow_nan=False)
    rates = result["detectors"]["spec"]
    assert set(rates) >= {"logo", "clothing", "grey", "random", "by_angle", "by_body"}
    for name, expected in (("logo", 1.0), ("clothing", 0.0), ("grey", 0.0)):
        assert rates[name]["success"] == expected and rates[name]["n"] == 8
        assert rates[name]["conditional"] == expected
        assert rates[name]["ci95"][0] <= expected <= rates[name]["ci95"][1]
    assert set(rates["by_angle"]) == {"-10", "10"} and set(rates["by_body"]) == set(bodies.names)
    assert result["false_alarms"] == {"spec": 1.0}
    assert told[-1] == (8 * 4 + 5, 8 * 4 + 5)
    assert result["unseen"] == {"bodies": None, "backgrounds": None}


def test_controls_are_shown_on_identical_images(bodies: Bodies, logo: Logo) -> None:
    """Between two patterns only the logo's pixels change; images repeat exactly; own clothing is the plain body."""
    renderer = make_renderer(in_green(logo, bodies), ANGLES, SMALL)
    assert isinstance(renderer, EvaluationRenderer)
    every = list(range(len(renderer.trials)))
    views = renderer.views(every)
    controls = ("logo", "clothing", "grey", "random")
    images = {c: shown.clone() for c, shown in zip(controls, renderer.compose(views, every, controls), strict=True)}
    assert torch.equal(images["random"], render_images(renderer, every, "random"))
    assert torch.equal(images["random"][3:5], render_images(renderer, every[3:5], "random"))
    for i, view in enumerate(views):
        dx, dy = renderer.shifts([i])[0].tolist()
        touched = view.pixels[view.logo_rows]
        may_differ = torch.zeros(64, 64, dtype=torch.bool)
        x, y = touched % 64 + dx, touched // 64 + dy
        inside = (x >= 0) & (x < 64) & (y >= 0) & (y < 64)
        may_differ[y[inside], x[inside]] = True
        for control in ("clothing", "grey", "random"):
            differs = (images[control][i] != images["logo"][i]).any(0)
            assert differs.any() and not (differs & ~may_differ).any()
    # Dressing no logo at all shows the body as it is.
    one = make_logo(bodies, logo.face_ids[:1])
    plain = make_renderer(in_green(one, bodies), ANGLES, SMALL)
    assert torch.allclose(render_images(plain, every, "clothing"), images["clothing"], atol=1e-5)


def test_controls_are_painted_onto_one_canvas(bodies: Bodies, logo: Logo, monkeypatch: pytest.MonkeyPatch) -> None:
    """A batch's bodies and backgrounds are composed once for all controls; the pixels are those composed anew."""
    renderer = make_renderer(in_green(logo, bodies), ANGLES, SMALL)
    every, controls = list(range(len(renderer.trials))), ("logo", "clothing", "grey", "random")
    views = renderer.views(every)
    outfit, count = renderer.trials["outfit"].to_numpy(), len(logo)
    for control, images in zip(controls, renderer.compose(views, every, controls), strict=True):
        each = {
            "logo": np.stack([green(logo)] * len(every)),
            "clothing": bodies.face_colors[outfit][:, logo.face_ids],
            "grey": np.full((len(every), count, 3), 0.5, np.float32),
            "random": np.stack([random_colors(SMALL.seed, i, count) for i in every]),
        }[control]
        anew = compose(views, torch.from_numpy(each), renderer.backgrounds(every), renderer.shifts(every))
        assert (images - anew).abs().max() <= 1e-6
    drawn = []
    monkeypatch.setattr(
        BodyRenderer, "backgrounds", lambda self, indices: drawn.append(len(indices)) or self.bare(indices)
    )
    evaluate(in_green(logo, bodies, 8), {"spec": GreenBlind()}, ANGLES, SMALL)
    assert drawn == [4, 4]  # of 8 images in batches of 4: once each, not once for each of 4 controls


@pytest.mark.slow
def test_same_seed_same_result_whatever_the_batch(bodies: Bodies, logo: Logo) -> None:
    run = lambda **changes: evaluate(in_green(logo, bodies), {"spec": GreenBlind()}, ANGLES, replace(SMALL, **changes))[
        "detectors"
    ]
    assert run() == run(batch=3)


def test_true_boxes_decide_success_iou() -> None:
    best = lambda detections, boxes: on_body(detections, boxes, within=math.inf).person.tolist()
    detections = Detections(
        torch.tensor([[[0.0, 0, 10, 20], [50, 50, 60, 70]]]).repeat(2, 1, 1), torch.tensor([[0.9, 0.7], [0.9, 0.7]])
    )
    true = torch.tensor([[50.0, 50, 60, 70], [0, 0, 10, 39]])
    assert best(detections, true) == pytest.approx([0.7, 0.9])
    assert best(detections, torch.zeros(2, 4)) == [0, 0]
    nothing = Detections(torch.zeros(2, 0, 4), torch.zeros(2, 0))
    assert best(nothing, true) == [0, 0]


@pytest.mark.slow
def test_stored_evaluation_feeds_the_report(bodies: Bodies, logo: Logo, tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text("{}")
    detector = GreenBlind()
    for _ in range(2):  # the second replaces the first
        result = evaluate(in_green(logo, bodies), {"spec": detector}, ANGLES, SMALL, out=tmp_path / "evaluation")
    stored = read_evaluation(tmp_path / "evaluation")
    assert stored.summary == json.loads(json.dumps(result))
    assert stored.results.controls == ("logo", "clothing", "grey", "random") and len(stored.results.trials) == 8
    assert len(stored.pictures["gallery"]) == 4 and stored.pictures["failures"] == {"spec": []}
    assert "Attack success" in make_report(tmp_path).read_text("utf-8")
    assert not [*tmp_path.glob("*.new"), *tmp_path.glob("*.old")]


@pytest.mark.slow
def test_failures_are_kept_worst_first(bodies: Bodies, logo: Logo, tmp_path: Path) -> None:
    grey = np.full((len(logo), 3), 0.5, np.float32)
    evaluate(
        Cloaked(grey, logo, bodies, grey_rooms(5)), {"spec": GreenBlind()}, ANGLES, SMALL, out=tmp_path / "evaluation"
    )
    stored = read_evaluation(tmp_path / "evaluation")
    failures = stored.pictures["failures"]["spec"]
    assert len(failures) == 6
    assert all(shot["logo"]["boxes"]["spec"] for shot in failures)


def test_overlap_with_training_is_said(bodies: Bodies, logo: Logo, caplog: pytest.LogCaptureFixture) -> None:
    config = {"scene": {"pose_sha256": list(bodies.pose_hashes[:1])}, "backgrounds": {"identities": ["other"]}}
    with caplog.at_level(logging.WARNING, "cloak"):
        result = evaluate(in_green(logo, bodies), {"spec": GreenBlind()}, ANGLES, SMALL, training=config)
    assert result["unseen"] == {"bodies": False, "backgrounds": True}
    assert len(result["warnings"]) == 1 and bodies.names[0] in result["warnings"][0]
    assert bodies.names[0] in caplog.text


def test_what_does_not_fit_is_refused(bodies: Bodies, logo: Logo, tmp_path: Path) -> None:
    worn, detectors = in_green(logo, bodies), {"spec": GreenBlind()}
    other = replace(logo, topology="f" * 64)
    with pytest.raises(InputError) as error:
        replace(worn, logo=other)
    assert "f" * 64 in str(error.value) and bodies.topology in str(error.value)
    with pytest.raises(InputError, match="colours for 3 faces"):
        replace(worn, colors=worn.colors[:3])
    with pytest.raises(InputError, match="--angles"):
        evaluate(worn, detectors, (), SMALL)
    with pytest.raises(InputError, match="--detector"):
        evaluate(worn, {}, ANGLES, SMALL)
    (tmp_path / "precious.txt").write_text("")
    with pytest.raises(InputError, match="left alone"):
        evaluate(worn, detectors, ANGLES, SMALL, out=tmp_path)
    assert (tmp_path / "precious.txt").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"images_per_view": 0}, "--images-per-view: 0"),
        ({"threshold": 1.0}, "--threshold: 1.0"),
        ({"shift": 32}, "--shift: 32"),
        ({"distances": (0.0,)}, "--distances"),
    ],
)
def test_bad_settings_name_their_option(change: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(SMALL, **change)


def test_a_detector_that_changes_is_a_defect(bodies: Bodies, logo: Logo) -> None:
    class Drifting(GreenBlind):
        def forward(self, images: Tensor) -> Detections:
            self.weight += 1
            return super().forward(images)

    with pytest.raises(RuntimeError, match="changed while"):
        evaluate(in_green(logo, bodies), {"spec": Drifting()}, ANGLES, SMALL)


@pytest.mark.slow
def test_white_box_and_black_box(bodies: Bodies, logo: Logo, capsys: pytest.CaptureFixture) -> None:
    """Told by the detectors' weights, whatever they are called; several are shown side by side."""
    known, stranger = GreenBlind(), GreenBlind()
    with torch.no_grad():
        stranger.weight.mul_(2)
    training = {"detectors": [{"spec": "as it was called then", "sha256": state_hash(known)}]}
    detectors = {"far[bold]": stranger, "near": known}
    run = lambda training: evaluate(in_green(logo, bodies), detectors, ANGLES, SMALL, training=training)
    result = run(training)
    assert result["white_box"] == {"far[bold]": False, "near": True}
    assert run(None)["white_box"] == {"far[bold]": None, "near": None}
    show_success(result)
    rows = [line for line in capsys.readouterr().out.splitlines() if "│ white " in line or "│ black " in line]
    assert len(rows) == 2 and "near" in rows[0] and " white " in rows[0] and "1.00" in rows[0]
    assert "far[bold]" in rows[1] and " black " in rows[1]
