"""Cloaks judged by a detector that training left out: who is kin, what is trained, how cells become a table."""

from pathlib import Path

import numpy as np
import pytest
from test_experiments import Glow

from cloak_core.attack.settings import make_settings, merge
from cloak_core.cli import load
from cloak_core.commands import parsing
from cloak_core.evaluation.experiments import lab as lab_module
from cloak_core.evaluation.experiments.lab import Interrupted
from cloak_core.evaluation.experiments.logos import chest_thighs
from cloak_core.evaluation.experiments.materials import Materials
from cloak_core.evaluation.experiments.options import Options
from cloak_core.evaluation.leave_one_out import rungs
from cloak_core.evaluation.leave_one_out.kin import families, family_of, kin
from cloak_core.evaluation.leave_one_out.matrix import CIRCLE, FRONT, LastingLab, Matrix, gather, summary
from cloak_core.evaluation.leave_one_out.showing import show
from cloak_core.files.errors import InputError
from cloak_core.scene.backdrops.backgrounds import load_backgrounds
from cloak_core.scene.people.samples import sample_bodies


@pytest.mark.parametrize(
    ("spec", "family"),
    [
        ("onnx:/a/yolov8n.onnx", "yolo"),
        ("darknet:x/yolo-fastest-1.1-xl.cfg:y.weights@320", "yolo"),
        ("darknet:MobileNetV2-YOLOv3-Nano-coco.cfg:y.weights", "yolo"),
        ("onnx:nanodet_m.onnx@416,conf=0.4", "nanodet"),
        ("onnx:ssd_mobilenet_v1.onnx", "ssd"),
        ("torchvision:fasterrcnn_resnet50_fpn", "rcnn"),
        ("python:detectors/d2go.py:load", "rcnn"),
        ("torchvision:ssdlite320_mobilenet_v3_large", "ssdlite"),
        ("transformers:/models/rtdetr_r18vd", "detr"),
    ],
)
def test_families_by_name(spec, family):
    assert family_of(spec) == family


def test_siblings_and_strangers_and_what_the_user_knows_better():
    specs = ("onnx:yolov8n.onnx", "onnx:ssd_mobilenet_v1.onnx", "torchvision:ssdlite320_mobilenet_v3_large")
    family = families(specs)
    assert kin(specs[0], specs[1:], family) == "stranger"
    assert kin(specs[1], specs[2:], family) == "stranger"
    assert kin(specs[1], specs[2:], families(specs, ["ssdlite320=ssd"])) == "sibling"
    for words in ("ssd", "=x", "none=x", "ssd="):
        with pytest.raises(InputError, match="--kin"):
            families(specs, [words])


def test_rungs_are_alone_or_in_order_and_their_settings_exist():
    assert rungs.changes("best") == {"preset": "best"}
    assert rungs.changes("shake") == {"preset": "best", "shake": 0.3}
    window = {"smooth": 8, "initial": "animal", "crop": 0.15, "pad": 0.3}
    assert rungs.changes("+window") == {"preset": "best", **window}
    recipe, upon = merge(rungs.changes("recipe")), merge(rungs.changes("+cutout"))
    assert {name for name in upon if recipe[name] != upon[name]} == {"preset", "steps"}
    assert rungs.changes("recipe") == {"preset": "transfer"}
    every = rungs.names(("ladder", "best"))
    assert len(every) == len(set(every)) == 2 * len(rungs.LADDER) + 2
    for name in every:
        make_settings(**(dict(FRONT.training) | rungs.changes(name)))
    with pytest.raises(InputError, match="--rungs: 'nothing' is not one of"):
        rungs.names(("best", "nothing"))


def matrix(out: Path, **changes: object) -> Matrix:
    detectors = {"onnx:red.onnx": Glow("red", 0), "yolo:a": Glow("green", 1), "yolo:b": Glow("blue", 2)}
    materials = Materials(
        sample_bodies("train").select_poses([0]),
        sample_bodies("unseen").select_poses([0]),
        load_backgrounds("procedural:train:2"),
        load_backgrounds("procedural:test:2"),
        detectors,
    )
    amount = Options(out=out, steps=(1,), seeds=1, batch=1, images_per_view=1, size=32, samples=1)
    specs = tuple(detectors)
    base = {"family": families(specs), "surrogates": specs, "judges": specs, "places": FRONT, "logo": "chest"}
    lab = LastingLab(materials, amount)
    return Matrix(lab=lab, faces=chest_thighs(materials.bodies), **(base | changes))


def test_surrogates_are_all_but_the_judged_network_and_if_asked_its_siblings(tmp_path):
    whole = matrix(tmp_path)
    assert whole.surrogates_for("yolo:a") == ("onnx:red.onnx", "yolo:b")
    assert matrix(tmp_path, strangers_only=True).surrogates_for("yolo:a") == ("onnx:red.onnx",)
    detectors = whole.lab.materials.detectors
    detectors["onnx:red.onnx@64"] = Glow("red too", 0)  # the same network by another name
    assert whole.surrogates_for("onnx:red.onnx@64") == ("yolo:a", "yolo:b")
    with pytest.raises(InputError, match="none is left to train on without yolo:a"):
        matrix(tmp_path, surrogates=("yolo:a", "yolo:b"), strangers_only=True).surrogates_for("yolo:a")


@pytest.mark.slow
def test_cells_are_made_once_shared_and_survive_changed_code(tmp_path, monkeypatch):
    out = tmp_path / "m"
    matrix(out, judges=("yolo:a",)).fill(["best"])
    # A detector that is judged alone has the same surrogates, so the training is there already.
    matrix(out, judges=("onnx:red.onnx",)).fill(["best"])
    assert len(list((out / "runs").iterdir())) == 2
    monkeypatch.setattr(lab_module, "code_hash", lambda *parts: "other")
    monkeypatch.setattr(lab_module, "train", lambda *_, **__: pytest.fail("trained again"))
    matrix(out, judges=("yolo:a", "onnx:red.onnx")).fill(["best"])
    cells = gather(out)
    assert [cell["judged"] for cell in cells] == ["onnx:red.onnx", "yolo:a"]
    assert cells[1]["surrogates"] == ["onnx:red.onnx", "yolo:b"] and cells[1]["kin"] == "sibling"
    assert cells[0]["n"] == 6 and cells[0]["settings"]["angles"] == "-10:10:5"
    told = summary(cells)
    assert set(told["matrix"]) == {"onnx:red.onnx", "yolo:a"}
    values = [cell["success"] for cell in cells]
    assert told["mean"] == pytest.approx(np.mean(values), abs=1e-4) and told["worst"] == min(values)
    with pytest.raises(Interrupted, match="time budget"):
        matrix(out, deadline=0.0).fill(["adaptive"])
    files = show(cells, tmp_path / "docs", "table", "cloak transfer --detector onnx:/secret/place/a.onnx --out /x/y")
    text = files[-1].read_text()
    assert "a.onnx" in text and "secret" not in text and "| onnx red | stranger |" in text
    assert "- yolo a: trained on onnx red, yolo b" in text
    assert all(path.stat().st_size > 1000 for path in files[:2])


def test_the_circle_has_its_places():
    assert len(CIRCLE.angles) == 36 and CIRCLE.angles[0] == 0
    training = CIRCLE.with_training(detectors_per_step=3).training
    assert training == dict(CIRCLE.training) | {"detectors_per_step": 3}
    assert CIRCLE.with_test(most_images=7).test["most_images"] == 7 and "most_images" not in CIRCLE.test


def test_the_command_reads_its_options():
    words = ["--detector", "a", "--detector", "b", "--judge", "c", "--out", "x", "--rungs", "best", "+shake"]
    command = parsing.parse(load("transfer"), "transfer", words)
    assert (command.detector, command.judge, command.rungs) == (("a", "b"), ("c",), ("best", "+shake"))
