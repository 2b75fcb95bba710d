"""Detectors by their real files, checked by the project's own trainer: what can be trained against, and what judges.

CLOAK_SHARED is the folder of real detectors; the whole takes minutes (`long` in test_in_blender.py).
"""

import os
from pathlib import Path

import bpy
import pytest
from cloak.properties import train_options
from cloak.session import session
from cloak.trainer.program import preferences
from cloak.training import detectors
from conftest import ROOT, make_launcher, run_job
from test_detectors import add

FILES = Path(os.environ["CLOAK_SHARED"], "data", "detectors")
WHITE, TORCH = FILES / "nanodet_m.onnx", FILES / "yolov5n.pt"
BLACK = (FILES / "original/person-detection-retail-0013.xml", FILES / "original/pose_detection.tflite")


@pytest.fixture
def trainer(real_trainer):
    preferences().program = str(real_trainer)
    yield
    preferences().program = ""


def checked(*files: Path) -> list:
    """The entries that the browser's operator makes, once they are checked."""
    add(*map(str, files))
    run_job(500)
    return bpy.context.scene.cloak.detectors[-len(files) :]


def test_real_files_of_four_families(ready, trainer):
    white = checked(WHITE)[0]
    assert white.works and not white.only_judges and 0 < white.threshold < 1, white.answer
    for judge in checked(*BLACK):
        assert judge.works and judge.only_judges and judge.threshold == 0.5, judge.answer
        assert "(assumed)" in judge.answer
    settings = bpy.context.scene.cloak
    assert detectors.judges(settings) == tuple(d.full for d in settings.detectors)
    assert [word for word in train_options(settings) if "detector" in word] == [f"--detector={white.full}"]


def test_ultralytics_works_or_says_in_one_line_what_is_missing(ready, trainer, tmp_path):
    torch = checked(TORCH)[0]
    assert (torch.works and not torch.only_judges) or "pip install" in torch.answer, torch.answer
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.modules['ultralytics'] = None\n")
    preferences().program = str(make_launcher(tmp_path / "without", [tmp_path, ROOT], os.environ["CLOAK_TRAINER"]))
    bpy.ops.cloak.detector_check()
    run_job(500)
    assert session.job.state == "failed" and not torch.works and "\n" not in torch.answer
    assert "needs the package ultralytics" in torch.answer and "pip install 'cloak-core[ultralytics]'" in torch.answer
