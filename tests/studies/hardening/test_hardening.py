"""A detector learns to see through cloaks, goes on where it was stopped, and is written as what it was."""

from __future__ import annotations

import json
import logging
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from cloak_core.commands.assess import Assess
from cloak_core.commands.harden import Harden
from cloak_core.core.detector.protocol import Detections, Detector, state_hash
from cloak_core.core.loop import StopRequest
from cloak_core.detectors.darknet.layers import BatchNorm
from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.studies.hardening.pictures import check_places
from cloak_core.studies.hardening.planning import measure_pace, plan
from cloak_core.studies.hardening.settings import HardenSettings
from cloak_core.studies.hardening.student import NAME, Student
from cloak_core.studies.hardening.students import open_student
from tests.core.fakes import box_bodies
from tests.detectors.helpers import images, write_tiny
from tests.schemas import validate
from tests.studies.hardening.made_students import FEW, hardened


def test_writes_what_loads_as_the_same_kind_and_another_network(student: Student, tmp_path: Path) -> None:
    result = hardened(student, tmp_path / "out")
    assert result.spec == f"darknet:{tmp_path}/out/{NAME}.cfg:{tmp_path}/out/{NAME}.weights"
    before, after = load_detector(student.spec), load_detector(result.spec)
    assert not torch.equal(before(images(2)).scores, after(images(2)).scores)
    torch.testing.assert_close(before(images(2)).scores, after(images(2)).scores, atol=0.2, rtol=0)
    licence = (tmp_path / "out" / f"{NAME}.licence.txt").read_text()
    assert student.spec in licence and "their authors'" in licence
    assert (tmp_path / "out" / f"{NAME}.names").read_text().split() == ["person"]


@pytest.mark.slow
def test_the_teacher_stays_what_it_was_and_batch_norm_keeps_its_statistics(student: Student, tmp_path: Path) -> None:
    teacher = state_hash(student.teacher)
    statistics = [m.running_mean.clone() for m in student.network.modules() if isinstance(m, BatchNorm)]
    hardened(student, tmp_path / "out")
    assert state_hash(student.teacher) == teacher
    after = [m.running_mean for m in student.network.modules() if isinstance(m, BatchNorm)]
    assert statistics and all(torch.equal(*pair) for pair in zip(statistics, after, strict=True))


@pytest.mark.slow
def test_a_stopped_hardening_goes_on_to_the_same_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = write_tiny(tmp_path)
    whole = hardened(open_student(spec), tmp_path / "whole")
    asked = []
    monkeypatch.setattr(
        StopRequest, "reason", lambda *_: (asked.append(1), "cancel file" if len(asked) == 3 else "")[1]
    )
    part = hardened(open_student(spec), tmp_path / "part")
    assert (part.stopped, part.step) == ("cancel file", 3)
    left = tmp_path / "part" / ".hardened.onnx.1yv8pe0c"
    left.touch()
    rest = hardened(open_student(spec), tmp_path / "part", resume=True)
    assert (rest.stopped, rest.step) == ("", 4) and not left.exists(), "what killed writers left goes"
    assert state_hash(load_detector(rest.spec)) == state_hash(load_detector(whole.spec))
    types = [json.loads(line)["type"] for line in (tmp_path / "part" / "events.jsonl").read_text().splitlines()]
    assert types == ["start", *["step"] * 3, "checkpoint", "resume", "step", "checkpoint", "end"]


def test_a_cancel_file_and_a_time_budget_end_it_in_order(student: Student, tmp_path: Path) -> None:
    started = time.monotonic()
    result = hardened(student, tmp_path / "out", steps=1000, max_seconds=0.01)
    assert (result.stopped, result.step) == ("time budget", 1)
    assert time.monotonic() - started < 60
    assert load_detector(result.spec)


def test_a_folder_goes_on_with_what_it_was_begun_with_alone(student: Student, tmp_path: Path) -> None:
    out = tmp_path / "out"
    hardened(student, out, steps=1)
    assert hardened(student, out, resume=True, steps=1).step == 1
    with pytest.raises(InputError, match="exists already"):
        hardened(student, out, steps=1)
    for changes, words in (({"lr": 0.1}, "--lr = 0.001, not 0.1"), ({"cloths": 0.5}, "--cloths")):
        with pytest.raises(InputError, match=f"begun with other {words}"):
            hardened(student, out, resume=True, **({"steps": 1} | changes))
    config = json.loads((out / "config.json").read_text())
    (out / "config.json").write_text(json.dumps(config | {"format": "cloak hardening 3"}))
    with pytest.raises(InputError, match="earlier version, which drew other cloaks; begin in another --out"):
        hardened(student, out, resume=True, steps=1)


def test_cloaked_images_count_as_much_as_asked_in_the_last_fifth(student: Student, tmp_path: Path) -> None:
    hardened(student, tmp_path / "out", steps=5, cloaked_weight=3.0)
    told = [json.loads(line) for line in (tmp_path / "out" / "events.jsonl").read_text().splitlines()]
    steps = [event for event in told if event["type"] == "step"]
    for weight, step in ((1, steps[3]), (3, steps[4])):
        wanted = weight * 2 * step["cloaked"] + 2 * step["clean"] + step["pictures"] + step["decoys"]
        assert step["cloaked"] != step["clean"]
        assert step["loss"] == pytest.approx(wanted / (weight * 2 + 2 + 1 + 1), rel=1e-5)


def test_what_cannot_be_trained_is_refused_in_one_line() -> None:
    words = (
        r"cannot train 'openvino', only builtin, darknet, onnx, python, torchvision and ultralytics; harden the weights"
    )
    with pytest.raises(InputError, match=words):
        open_student("openvino:net.xml")
    with pytest.raises(InputError, match=r"net.onnx: no such file"):
        open_student("net.onnx")
    with pytest.raises(InputError, match="cannot train 'jpeg=75', only builtin"):
        open_student("jpeg=75:builtin")


def test_a_hardened_built_in_detector_is_a_built_in_one(tmp_path: Path) -> None:
    student = open_student("builtin@96")
    spec = student.write(student.network.state_dict(), tmp_path, 0)
    assert spec == f"builtin:{tmp_path}/{NAME}.weights@96"
    again, first = load_detector(spec), load_detector("builtin@96")
    torch.testing.assert_close(again(images(1)).scores, first(images(1)).scores)
    assert (again.operating_point, again.operating_point_assumed) == (0.5, False)
    assert "Apache-2.0" in (tmp_path / f"{NAME}.licence.txt").read_text()


@pytest.mark.slow
def test_the_epsilon_of_the_original_darknet_moves_into_the_scale(tmp_path: Path) -> None:
    spec = write_tiny(tmp_path)
    weights = tmp_path / "tiny.weights"
    data = bytearray(weights.read_bytes())
    data[8:12] = (0).to_bytes(4, "little")  # the original's revision
    weights.write_bytes(bytes(data))
    student = open_student(spec)
    again = student.write(student.network.state_dict(), tmp_path, 0)
    torch.testing.assert_close(load_detector(again)(images(2)).scores, load_detector(spec)(images(2)).scores)


@pytest.mark.parametrize("asked", [True, False])
def test_the_command_gives_the_cards_before_and_after_or_says_why_not(
    asked: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = write_tiny(tmp_path)
    monkeypatch.setattr("cloak_core.commands.harden.load_scene", lambda _: box_bodies())
    made: list[tuple[str, ...]] = []

    def assess(command: Assess) -> dict:
        made.append(command.specs)
        return {"cards": {one: {"spec": one} for one in command.specs}, "files": []}

    monkeypatch.setattr(Assess, "run", assess)
    few = HardenSettings(**(FEW | {"steps": 1}))
    told = Harden(spec=spec, out=tmp_path / "out", backgrounds="procedural:train:2", assess=asked, settings=few).run()
    if asked:
        assert made == [(spec, told["spec"])]
        assert (told["before"], told["after"]) == ({"spec": spec}, {"spec": told["spec"]})
    else:
        assert not made and (told["before"], told["after"]) == (None, None)
        assert "--no-assess" in told["no_cards"]
        validate("harden", json.dumps(told))


def test_a_plan_fills_its_hours() -> None:
    pace = 2.0
    for hours in (0.2, 1.0, 8.0):
        planned, words, warning = plan(HardenSettings(), pace, hours)
        assert 0.95 * 3600 * hours - 2 < planned.steps * pace <= 0.95 * 3600 * hours
        assert bool(warning) == (hours == 0.2) and ("480 take 0.28 hours" in warning) == bool(warning)
    assert words.startswith("--hours 8: 13680 updates of 2 s (456 min); ") and "480 to 2800" in words
    with pytest.raises(
        InputError, match=r"--hours 0.01: 17 updates of 2 s fit, which hardens nothing; 50 take 0.029 h"
    ):
        plan(HardenSettings(), pace, 0.01)


def test_hours_become_counts_in_the_record_and_a_resumed_hardening_keeps_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr("cloak_core.commands.harden.load_scene", lambda _: box_bodies())
    monkeypatch.setattr("cloak_core.studies.hardening.planning.LEAST_STEPS", 1)
    slow = lambda *tried: max(100.0, measure_pace(*tried))
    monkeypatch.setattr("cloak_core.studies.hardening.planning.measure_pace", slow)
    command = Harden(
        spec=write_tiny(tmp_path),
        out=tmp_path / "out",
        backgrounds="procedural:train:2",
        assess=False,
        settings=HardenSettings(**FEW),
        hours=0.1,
    )
    told = command.run()
    assert (told["step"], told["steps"]) == (3, 3)
    printed = capsys.readouterr()
    assert "--hours 0.1: 3 updates of 1e+02 s (5 min)" in printed.out
    assert "timing updates: 4 updates\n" in printed.err, "nobody waits for the plan in silence"
    assert "3 updates are fewer than any" in printed.err
    assert json.loads((tmp_path / "out" / "config.json").read_text())["settings"]["steps"] == 3
    command.resume, command.hours = True, 5.0
    assert command.run()["steps"] == 3


class Brightness(Detector):
    """Takes every bright picture for a person."""

    def detect(self, images: torch.Tensor) -> Detections:
        return Detections(torch.zeros(len(images), 1, 4), images.mean((1, 2, 3))[:, None])


def pictures(folder: Path, bright: int, dark: int) -> Path:
    folder.mkdir()
    for number in range(bright + dark):
        shade = np.full((40, 40, 3), 230 if number < bright else 20, np.uint8)
        Image.fromarray(shade).save(folder / f"p{number:02d}.png")
    return folder


def test_a_folder_of_people_among_backgrounds_is_refused_and_a_few_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    detector = Brightness("brightness", "brightness")
    few = load_backgrounds(pictures(tmp_path / "few", 1, 10))
    with caplog.at_level(logging.WARNING):
        check_places(few, detector, 64, "few")
    assert [r.getMessage() for r in caplog.records] == [
        "few: somebody is in 1 of 11 backgrounds (p00.png), the detector says; remove the pictures that show people"
    ]
    many = load_backgrounds(pictures(tmp_path / "many", 7, 3))
    words = r"many: somebody is in 7 of 10 backgrounds \(p00.png, p01.png, p02.png, p03.png, p04.png, ...\); back"
    with pytest.raises(InputError, match=words):
        check_places(many, detector, 64, "many")
