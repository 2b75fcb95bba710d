"""Hours become counts before a hardening begins, and backgrounds that show people are told before it."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from cloak_core.commands.harden import Harden
from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.studies.hardening.pictures import check_places
from cloak_core.studies.hardening.planning import measure_pace, plan
from cloak_core.studies.hardening.settings import HardenSettings
from tests.core.fakes import box_bodies
from tests.detectors.helpers import write_tiny

FEW = {"batch": 2, "pictures": 1, "decoys": 1, "attack_steps": 1, "size": 64}


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
        "few: somebody is in 1 of 11 backgrounds (p00.png), says the detector; take out those that show people"
    ]
    many = load_backgrounds(pictures(tmp_path / "many", 7, 3))
    words = r"many: somebody is in 7 of 10 backgrounds \(p00.png, p01.png, p02.png, p03.png, p04.png, ...\); back"
    with pytest.raises(InputError, match=words):
        check_places(many, detector, 64, "many")
