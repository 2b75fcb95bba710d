"""Cloaks judged by a detector that training left out: families, ablations, and how cells become a table."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cloak_core.core.evaluation.settings import StoreOptions
from cloak_core.core.logo import chest_thighs
from cloak_core.core.run_config import read_config
from cloak_core.core.settings import make_settings, merge
from cloak_core.files.errors import InputError, Stopped
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.people import load_people
from cloak_core.studies import training_store
from cloak_core.studies.store import DataSplit, RunStore
from cloak_core.studies.transfer import (
    FRONT,
    LADDER,
    PHOTOGRAPHS,
    TransferMatrix,
    ablation_names,
    ablation_settings,
    families,
    gather,
    kinship,
    publish,
    show,
    summary,
)
from tests.sources.photographs.made_people import write_people
from tests.studies.made_split import Glow


def test_siblings_and_strangers_and_what_the_user_knows_better():
    specs = ("onnx:yolov8n.onnx", "onnx:ssd_mobilenet_v1.onnx", "torchvision:ssdlite320_mobilenet_v3_large")
    family = families(specs)
    assert kinship(specs[0], specs[1:], family) == "stranger"
    assert kinship(specs[1], specs[2:], family) == "stranger"
    assert kinship(specs[1], specs[2:], families(specs, ["ssdlite320=ssd"])) == "sibling"
    for words in ("ssd", "=x", "none=x", "ssd="):
        with pytest.raises(InputError, match="--kin"):
            families(specs, [words])


def matrix(out: Path, people: tuple[Crowd, ...] = (), **changes: object) -> TransferMatrix:
    detectors = {"onnx:red.onnx": Glow("red", 0), "yolo:a": Glow("green", 1), "yolo:b": Glow("blue", 2)}
    split = DataSplit(
        sample_bodies("train").select_poses([0]),
        sample_bodies("unseen").select_poses([0]),
        load_backgrounds("procedural:train:2"),
        load_backgrounds("procedural:test:2"),
        detectors,
        *people,
    )
    options = StoreOptions(out=out, steps=(1,), seeds=1, batch=1, images_per_view=1, size=32, samples=1)
    specs = tuple(detectors)
    base = {"family": families(specs), "surrogates": specs, "judges": specs, "cameras": FRONT, "logo": "chest"}
    return TransferMatrix(store=RunStore(split, options), faces=chest_thighs(split.bodies), **(base | changes))


def test_surrogates_are_all_but_the_judged_network_and_if_asked_its_siblings(tmp_path):
    whole = matrix(tmp_path)
    assert whole.surrogates_for("yolo:a") == ("onnx:red.onnx", "yolo:b")
    assert matrix(tmp_path, cross_family_only=True).surrogates_for("yolo:a") == ("onnx:red.onnx",)
    detectors = whole.store.split.detectors
    detectors["onnx:red.onnx@64"] = Glow("red too", 0)  # the same network by another name
    assert whole.surrogates_for("onnx:red.onnx@64") == ("yolo:a", "yolo:b")
    with pytest.raises(InputError, match="none is left to train on without yolo:a"):
        matrix(tmp_path, surrogates=("yolo:a", "yolo:b"), cross_family_only=True).surrogates_for("yolo:a")


@pytest.mark.long
def test_people_in_photographs_are_trained_on_and_others_judge(tmp_path):
    people = Crowd(load_people(write_people(tmp_path / "people", 4)))
    seen, kept = people.halves()
    assert not set(seen.pictures()) & set(kept.pictures()) and len(seen) + len(kept) == 4
    of_people = matrix(tmp_path / "m", (seen, kept), judges=("yolo:a",), cameras=PHOTOGRAPHS)
    of_people.fill(["recipe"])
    (cell,) = gather(tmp_path / "m")
    assert cell["n"] == len(kept) and cell["settings"] == {"preset": "photographs"} and cell["clothing"] is not None
    (run,) = (tmp_path / "m" / "runs").iterdir()
    assert set(read_config(run)["people"]["photographs"]) == set(seen.pictures())
    # Other people are another training, and other images.
    matrix(tmp_path / "m", (kept, seen), judges=("yolo:a",), cameras=PHOTOGRAPHS).fill(["recipe"])
    assert len(list((tmp_path / "m" / "evaluations").iterdir())) == 2


@pytest.mark.slow
def test_cells_are_made_once_and_shared(tmp_path, monkeypatch):
    out = tmp_path / "m"
    matrix(out, judges=("yolo:a",)).fill(["best"])
    # A detector that is judged alone has the same surrogates, so the training is there already.
    matrix(out, judges=("onnx:red.onnx",)).fill(["best"])
    assert len(list((out / "runs").iterdir())) == 2
    monkeypatch.setattr(training_store, "train", lambda *_, **__: pytest.fail("trained again"))
    matrix(out, judges=("yolo:a", "onnx:red.onnx")).fill(["best"])
    cells = gather(out)
    assert [cell["judged"] for cell in cells] == ["onnx:red.onnx", "yolo:a"]
    assert cells[1]["surrogates"] == ["onnx:red.onnx", "yolo:b"] and cells[1]["kin"] == "sibling"
    assert cells[0]["n"] == 6 and cells[0]["settings"]["angles"] == "-10:10:5"
    told = summary(cells)
    assert set(told["matrix"]) == {"onnx:red.onnx", "yolo:a"}
    values = [cell["success"] for cell in cells]
    assert told["mean"] == pytest.approx(np.mean(values), abs=1e-4) and told["worst"] == min(values)
    with pytest.raises(Stopped, match="time budget"):
        matrix(out, deadline=0.0).fill(["adaptive"])
    assert all(path.stat().st_size > 1000 for path in show(cells, tmp_path / "docs", "table"))
    told = [{key: value for key, value in cells[0].items() if key != "gone"}, cells[1] | {"gone": 0.456}]
    table = pd.read_csv(publish(told, tmp_path / "docs", "table", "m", "cloak transfer"))
    assert table["judged"].tolist() == ["onnx red", "yolo a"] and table["kin"].tolist() == ["stranger", "sibling"]
    assert table["success"].tolist() == values and table["gone"].isna().tolist() == [True, False]
    assert table["surrogates"][1] == "onnx red; yolo b"


def test_rungs_are_alone_or_in_order_and_their_settings_exist():
    assert ablation_settings("best") == {"preset": "best"}
    assert ablation_settings("shake") == {"preset": "best", "shake": 0.3}
    window = {"smooth": 8, "initial": "animal", "crop": 0.15, "pad": 0.3}
    assert ablation_settings("+window") == {"preset": "best", **window}
    recipe, upon = merge(ablation_settings("recipe")), merge(ablation_settings("+cutout"))
    assert {name for name in upon if recipe[name] != upon[name]} == {"preset", "steps"}
    assert ablation_settings("recipe") == {"preset": "transfer"}
    every = ablation_names(("ladder", "best"))
    assert len(every) == len(set(every)) == 2 * len(LADDER) + 2
    for name in every:
        make_settings(**(dict(FRONT.training) | ablation_settings(name)))
    with pytest.raises(InputError, match="--rungs: 'nothing' is not one of"):
        ablation_names(("best", "nothing"))
