"""Experiments on tiny images: shared trainings, honest records, every experiment from end to end (slow)."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from made_evaluation import CONTROLS, make_measurement
from PIL import Image
from torch import Tensor

from cloak_core.cli import main
from cloak_core.detectors.protocol import Detections, Detector
from cloak_core.evaluation.experiments import lab as lab_module
from cloak_core.evaluation.experiments import materials as materials_module
from cloak_core.evaluation.experiments.index_page import make_page
from cloak_core.evaluation.experiments.lab import Interrupted, Lab
from cloak_core.evaluation.experiments.logos import PAPER_SHARES, chest_thighs, paper_logos, shapes, trimmed
from cloak_core.evaluation.experiments.markdown import publish
from cloak_core.evaluation.experiments.materials import Materials, open_materials
from cloak_core.evaluation.experiments.numbers import threshold_rows
from cloak_core.evaluation.experiments.options import Options
from cloak_core.evaluation.experiments.registry import EXPERIMENTS, draw_again, run_experiment
from cloak_core.evaluation.experiments.repeats import Repeats
from cloak_core.evaluation.experiments.tv import PICTURES, SIDE, preview_sheet
from cloak_core.files.errors import InputError
from cloak_core.files.identity import TRAINING
from cloak_core.scene.backdrops.backgrounds import load_backgrounds
from cloak_core.scene.logos.logo import area_share
from cloak_core.scene.people.samples import sample_bodies

QUICK = {"tv"}
"""Of the experiments; the others run with the tests that are slow by nature."""


class Glow(Detector):
    """A person is what is bright in the middle, in one colour channel."""

    def __init__(self, name: str, channel: int) -> None:
        super().__init__(name, name)
        self.register_buffer("channel", torch.tensor(channel))  # detectors are known by their tensors and source
        self.gain = torch.nn.Parameter(torch.tensor(30.0))
        self.freeze()

    def forward(self, images: Tensor) -> Detections:
        count, _, height, width = images.shape
        middle = images[:, int(self.channel), height // 5 : 4 * height // 5, 2 * width // 5 : 3 * width // 5]
        score = torch.sigmoid((middle.flatten(1).mean(1) - 0.4) * self.gain)[:, None]
        box = torch.tensor([0.3 * width, 0.1 * height, 0.7 * width, 0.9 * height])
        return Detections(box.expand(count, 1, 4), score, score, torch.ones(count, 1, dtype=torch.bool))


@pytest.fixture(scope="module")
def materials() -> Materials:
    return Materials(
        sample_bodies("train").select_poses([0, 9]),
        sample_bodies("unseen").select_poses([0, 3]),
        load_backgrounds("procedural:train:4"),
        load_backgrounds("procedural:test:4"),
        {"red:a.cfg": Glow("red", 0), "blue:b.cfg": Glow("blue", 2)},
    )


def options(out: Path, **changes: object) -> Options:
    return replace(
        Options(out=out, quick=True, steps=(2,), batch=2, images_per_view=1, size=48, samples=1, seeds=2), **changes
    )


@pytest.mark.slow
def test_trainings_and_evaluations_are_made_once(
    materials: Materials, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    faces = chest_thighs(materials.bodies)
    first = Lab(materials, options(tmp_path))
    trained = first.repeat(faces, ["red:a.cfg"])
    rates = first.evaluate(trained, (0.0, 5.0))
    assert len({t.folder for t in trained}) == 2  # one per seed
    for name in ("train", "measure"):
        monkeypatch.setattr(lab_module, name, lambda *_, **__: pytest.fail("made again"))
    again = Lab(materials, options(tmp_path))
    found = again.repeat(faces, ["red:a.cfg"])
    assert [t.folder for t in found] == [t.folder for t in trained]
    assert np.array_equal(again.evaluate(found, (0.0, 5.0)).measurements[1].score, rates.measurements[1].score)
    # Whatever decides the result names another run.
    for spec, changes in (("blue:b.cfg", {}), ("red:a.cfg", {"tv_weight": 1.0})):
        with pytest.raises(pytest.fail.Exception, match="made again"):
            again.train(faces, [spec], **changes)


def test_whatever_computes_a_result_is_in_its_key(
    materials: Materials, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The renderer, a loss, a wrapper of detectors, a package: each names other trainings and evaluations."""
    lab = Lab(materials, options(tmp_path))
    key = lambda rooms: lab._key({"settings": 1}, rooms)
    training, measuring = key(TRAINING), key(lab_module.MEASURING)
    assert training != measuring
    for room in lab_module.MEASURING:
        code = lambda *parts, room=room: "edited" if room in parts else "as ever"
        monkeypatch.setattr(lab_module, "code_hash", lambda *parts: "as ever")
        before = key(TRAINING), key(lab_module.MEASURING)
        monkeypatch.setattr(lab_module, "code_hash", code)
        assert (key(TRAINING) != before[0]) == (room in TRAINING) and key(lab_module.MEASURING) != before[1]
    assert {"render", "attack", "detectors", "scene"} <= set(TRAINING)
    monkeypatch.undo()
    assert (key(TRAINING), key(lab_module.MEASURING)) == (training, measuring)
    monkeypatch.setattr(lab_module, "package_versions", lambda *names: {"torch": "1.0"})
    assert key(TRAINING) != training


def test_a_detector_run_by_another_source_is_measured_anew(materials: Materials, tmp_path: Path) -> None:
    before = Lab(materials, options(tmp_path))._detector_records["red:a.cfg"]
    other = Glow("red", 0)
    other.source = {"cfg": "edited"}
    edited = replace(materials, detectors={"red:a.cfg": other})
    after = Lab(edited, options(tmp_path))._detector_records["red:a.cfg"]
    assert after["sha256"] == before["sha256"] and after != before


@pytest.mark.slow
def test_an_interrupted_set_goes_on(materials: Materials, tmp_path: Path) -> None:
    faces = chest_thighs(materials.bodies)
    lab = Lab(materials, options(tmp_path, steps=(3,)))
    whole = lab.train(faces, ["red:a.cfg"]).colors
    other = Lab(materials, options(tmp_path / "other", steps=(3,)))
    with pytest.raises(Interrupted, match="stopped at step 1"):
        other.train(faces, ["red:a.cfg"], max_seconds=1e-6)
    assert np.array_equal(other.train(faces, ["red:a.cfg"]).colors, whole)


@pytest.mark.slow
def test_each_detector_may_have_its_own_number_of_steps(materials: Materials, tmp_path: Path) -> None:
    lab = Lab(materials, options(tmp_path, steps=(2, 3)))
    faces = chest_thighs(materials.bodies)
    length = lambda *specs: lab.train(faces, specs).settings.run.steps
    assert (length("red:a.cfg"), length("blue:b.cfg"), length("red:a.cfg", "blue:b.cfg")) == (2, 3, 3)
    assert lab.steps() == 2 and lab.options.counts()["steps"] == "2 / 3 by detector"
    with pytest.raises(InputError, match="--steps: 3 numbers for 2 detectors"):
        Lab(materials, options(tmp_path, steps=(1, 2, 3)))


@pytest.fixture(scope="module")
def finished(materials: Materials, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """A folder in which `transfer` was run, and its record."""
    out = tmp_path_factory.mktemp("out")
    return out, run_experiment("transfer", Lab(materials, options(out)))


def test_transfer_writes_everything(materials: Materials, finished: tuple[Path, dict], tmp_path: Path) -> None:
    out, record = finished
    folder = out / "transfer"
    assert {p.name for p in folder.iterdir()} == {
        "config.json", "numbers.json", "numbers.csv", "words.md", "matrix.png", "matrix.svg",
        "thresholds.csv", "thresholds.png", "thresholds.svg",
    }  # fmt: skip
    assert json.loads((folder / "numbers.json").read_text()) == json.loads(json.dumps(record))
    with (folder / "numbers.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["trained_on"], row["tested_on"]) for row in rows] == [
        (a, b) for a in materials.detectors for b in materials.detectors
    ]
    for row in record["rows"]:
        assert 0 <= row["low"] <= row["success"] <= row["high"] <= 1
        assert row["n"] == 2 * 11 * 2 and row["seeds"] == 2  # bodies x angles x seeds
        assert {"clothing", "grey", "random", "stripes", "checks", "clean_detection", "average_precision"} <= row.keys()
    config = json.loads((folder / "config.json").read_text())
    assert config["quick"] and config["detectors"].keys() == materials.detectors.keys()
    page = make_page(out).read_text("utf-8")
    assert "Transfer between detectors" in page and "Not run yet: table1" in page
    assert 'src="http' not in page and "<script" not in page
    config_path = folder / "config.json"
    command = "cloak reproduce transfer --scene '/a/b-c/bodies.npz[0:4]' --detector onnx:/a/n.onnx@conf=0.4"
    config_path.write_text(json.dumps(config | {"command": command}))
    text = publish(out, tmp_path / "docs").read_text("utf-8")
    assert "--scene 'bodies.npz[0:4]' --detector onnx:n.onnx@conf=0.4" in text
    assert "## transfer: Transfer between detectors" in text and "![" in text and str(out) not in text
    assert {p.name for p in (tmp_path / "docs").iterdir()} == {
        "tables.md", "transfer-matrix.png", "transfer-thresholds.png"
    }  # fmt: skip


@pytest.mark.slow
def test_figures_and_words_come_from_the_numbers_alone(
    finished: tuple[Path, dict], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    shutil.copytree(finished[0] / "transfer", tmp_path / "transfer")
    drawn_again("transfer", tmp_path)
    # By the command, too, which opens no detector for it. What an earlier version wrote is left as it is.
    monkeypatch.setattr(materials_module, "load_detector", lambda *_, **__: pytest.fail("opened"))
    (tmp_path / "cost").mkdir()
    record = json.loads((tmp_path / "transfer/numbers.json").read_text())
    earlier = json.dumps({key: value for key, value in record.items() if key not in ("format", "facts", "pictures")})
    (tmp_path / "cost/numbers.json").write_text(earlier.replace('"transfer-', '"cost-'))
    for file in record["figures"]:
        (tmp_path / "cost" / file).write_bytes((tmp_path / "transfer" / file).read_bytes())
    with pytest.raises(SystemExit, match="0"):
        main(["reproduce", "all", "--redraw", "--out", str(tmp_path), "--json"])
    result = json.loads(capsys.readouterr().out)
    assert result["experiments"].keys() == {"transfer"}
    assert result["skipped"].keys() == {"cost"} and (tmp_path / "cost/numbers.json").read_text() == earlier
    with pytest.raises(SystemExit, match="2"):
        main(["reproduce", "cost", "--redraw", "--out", str(tmp_path)])
    assert "not a cloak experiment" in capsys.readouterr().err


def test_thresholds_of_every_control_are_a_table_of_their_own() -> None:
    row = {"logo": "G"} | Repeats([make_measurement()]).row("builtin")
    rows = threshold_rows([row, {"logo": "none", "success": 0.0}])
    assert [r["control"] for r in rows] == list(CONTROLS)
    mine = rows[0]
    assert mine["logo"] == "G" and mine["detector"] == "builtin" and mine["at_0.6"] == row["success"]
    curve = [mine[f"at_{k / 10:g}"] for k in range(1, 10)]
    assert curve == sorted(curve) and curve[0] < curve[-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in EXPERIMENTS]
)
def test_every_experiment_runs(name: str, materials: Materials, tmp_path_factory: pytest.TempPathFactory) -> None:
    out = tmp_path_factory.getbasetemp() / "experiments"  # one folder, so that they share as they do for users
    if name == "render-gap":  # every frame is a render of Blender's
        materials = replace(
            materials, unseen=materials.unseen.select_poses([0]), detectors={"red:a.cfg": Glow("red", 0)}
        )
    record = run_experiment(name, Lab(materials, options(out, seeds=1)))
    assert record["rows"] and record["words"] and record["figures"]
    json.dumps(record, allow_nan=False)
    assert record["title"] in make_page(out).read_text("utf-8")
    drawn_again(name, out)


def drawn_again(name: str, out: Path) -> None:
    """Figures and words come back, byte by byte, from numbers.json alone; pictures are no figures, and stay."""
    folder = out / name
    record = (folder / "numbers.json").read_bytes()
    made = ["words.md", *(file for file in json.loads(record)["figures"] if not file.endswith(".jpg"))]
    before = {file: (folder / file).read_bytes() for file in made}
    assert len(made) >= 3
    for file in (*made, "numbers.csv", "config.json"):
        (folder / file).rename(folder / f"{file}.away")
    draw_again(name, out)
    assert {file: (folder / file).read_bytes() for file in made} == before
    assert (folder / "numbers.json").read_bytes() == record
    for file in ("numbers.csv", "config.json"):
        (folder / f"{file}.away").rename(folder / file)


def test_unknown_experiment(materials: Materials, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="experiment 'table2': not one of table1"):
        run_experiment("table2", Lab(materials, options(tmp_path)))
    with pytest.raises(InputError, match="no finished experiment"):
        make_page(tmp_path)


@pytest.mark.long
def test_logos_have_the_paper_s_shares(materials: Materials, tmp_path: Path) -> None:
    logos = paper_logos(materials.bodies, tmp_path)
    share = lambda name: area_share(materials.bodies, logos[name])
    assert share("letter G") == pytest.approx(PAPER_SHARES["letter G"], rel=0.05)
    assert share("smiley") == pytest.approx(PAPER_SHARES["smiley"], rel=0.05)
    assert share("chest + thighs, small") == pytest.approx(PAPER_SHARES["chest + thighs"], rel=0.05)
    assert set(logos["chest + thighs, small"]) < set(logos["chest + thighs"])
    whole = logos["chest + thighs"]
    assert np.array_equal(trimmed(materials.bodies, whole, 0.5), whole)
    named = shapes(materials.bodies, tmp_path, quick=True)
    assert next(iter(named)) == "disc 1.0%" and len(named) == 5


def test_materials_keep_every_second_one(tmp_path: Path) -> None:
    opened = open_materials(("builtin",), backgrounds="procedural:train:5")
    assert len(opened.backgrounds) == 3 and len(opened.unseen_backgrounds) == 2
    assert not set(opened.backgrounds.identities()) & set(opened.unseen_backgrounds.identities())
    assert not set(opened.bodies.names) & set(opened.unseen.names)
    worn = [{outfit.tobytes() for outfit in bodies.face_colors} for bodies in (opened.bodies, opened.unseen)]
    assert worn[0] and worn[1] and not worn[0] & worn[1]


def test_repetitions_are_pooled_and_their_spread_is_shown() -> None:
    one = make_measurement()
    score = one.score.copy()
    score[0, 0] = 0.9
    other = replace(one, score=score)
    repeats = Repeats([one, other])
    alone = Repeats([one]).rate("builtin")
    assert repeats.rate("builtin").value == pytest.approx(alone.value / 2)
    assert repeats.rate("builtin").n == 2 * alone.n
    assert repeats.spread("builtin") == [pytest.approx(alone.value, abs=1e-6), 0.0]
    # One training hides, the other does not: how a third will do is not known.
    pooled = repeats.rate("builtin")
    assert pooled.high - pooled.low > 1.5 * (alone.high - alone.low)
    assert repeats.rate("builtin", "clothing") == Repeats([one]).rate("builtin", "clothing")
    row = repeats.row("builtin")
    assert (row["worst_seed"], row["seeds"]) == (0.0, 2)
    assert row["clean_detection"] == pytest.approx(1 - row["clothing"], abs=1e-4)
    at = repeats.rate("builtin", angle=-10.0, pose=1)
    assert at.n == 2 * 4


def test_previews_of_every_weight_stand_in_rows(tmp_path: Path) -> None:
    settings = SimpleNamespace(views=SimpleNamespace(size=100))
    trained = {}
    for weight, color in ((0.0, "red"), (2.5, "blue")):
        folder = tmp_path / f"{weight}"
        (folder / "previews").mkdir(parents=True)
        for step in range(0, 90, 10):
            Image.new("RGB", (200, 200), color).save(folder / "previews" / f"step-{step:06d}.png")
        trained[weight] = SimpleNamespace(folder=folder, settings=settings)
    (sheet,) = preview_sheet(trained).values()
    area = {color: count for count, color in sheet.getcolors(1 << 16)}
    assert area[(255, 0, 0)] == area[(0, 0, 255)] == PICTURES * SIDE * SIDE
    assert preview_sheet({0.0: SimpleNamespace(folder=tmp_path / "none", settings=settings)}) == {}
