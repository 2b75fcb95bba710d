"""The robustness card on tiny images: a fake detector under a tiny budget, its page, and several side by side."""

import itertools
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jsonschema
import numpy as np
import pytest
import torch
from torch import Tensor

from cloak_core.cli import main
from cloak_core.commands import progress as progress_module
from cloak_core.commands.assess import Assess
from cloak_core.commands.progress import WorkProgress
from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.core.evaluation.settings import StoreOptions
from cloak_core.core.logo import area_share
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.studies import store as store_module
from cloak_core.studies.card import words
from cloak_core.studies.card import work as work_module
from cloak_core.studies.card.assess import Assessment
from cloak_core.studies.card.leaderboard import (
    folder_names,
    gather,
    is_too_short,
    leaderboard_row,
    write_leaderboard,
)
from cloak_core.studies.card.page import write_card, write_comparison
from cloak_core.studies.card.protocol import AREAS, DEFAULT, FULL, QUICK, Budget, nested_areas
from cloak_core.studies.card.work import Work
from cloak_core.studies.data_split import DataSplit
from cloak_core.studies.report import page as page_module
from cloak_core.studies.statistics_card import stance_of
from cloak_core.studies.store import RunStore
from tests.schemas import validate

TINY = Budget("tiny", 2, 1, 10, 180, 1, 6, areas=(0.05, 0.76))


class Glow(Detector):
    """A person is what is bright in the middle."""

    def __init__(self, name: str, differentiable: bool = True) -> None:
        super().__init__(name, name)
        self.gain = torch.nn.Parameter(torch.tensor(30.0))
        self.differentiable, self.operating_point = differentiable, 0.25
        self.freeze()

    def forward(self, images: Tensor) -> Detections:
        count, _, height, width = images.shape
        middle = images[:, 0, height // 5 : 4 * height // 5, 2 * width // 5 : 3 * width // 5]
        score = torch.sigmoid((middle.flatten(1).mean(1) - 0.4) * self.gain)[:, None]
        box = torch.tensor([0.3 * width, 0.1 * height, 0.7 * width, 0.9 * height])
        return Detections(box.expand(count, 1, 4), score, score, torch.ones(count, 1, dtype=torch.bool))


def make_store(out: Path, detector: Detector) -> RunStore:
    split = DataSplit(
        sample_bodies("train").select_poses([0, 9]),
        sample_bodies("unseen").select_poses([0, 3]),
        load_backgrounds("procedural:train:4"),
        load_backgrounds("procedural:test:4"),
        {detector.spec: detector},
    )
    return RunStore(split, StoreOptions(out=out, batch=2, size=48, samples=1, seeds=1), lambda _: None)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict, list]:
    """A folder with the card of a white box and of a black box, the first card, and the progress told."""
    out, told = tmp_path_factory.mktemp("cards"), []
    card = Assessment(
        make_store(out, Glow("glow")), TINY, out / "glow", ["builtin-sample"], lambda *x: told.append(x)
    ).run()
    Assessment(make_store(out, Glow("dark:net.onnx", False)), TINY, out / "dark", []).run()
    for name in ("glow", "dark"):
        write_card(out / name)
    return out, card, told


@pytest.mark.slow
def test_the_card_is_what_the_schema_says(made: tuple[Path, dict, list]) -> None:
    for name in ("glow", "dark"):
        validate("card", (made[0] / name / "card.json").read_text("utf-8"))
    with pytest.raises(jsonschema.ValidationError, match="required"):
        validate("assess", '{"format": "cloak card 1", "files": []}')


@pytest.mark.slow
def test_the_card_has_what_the_protocol_asks_for(made: tuple[Path, dict, list]) -> None:
    out, card, told = made
    assert json.loads((out / "glow/card.json").read_text()) == json.loads(json.dumps(card, allow_nan=False))
    assert card["protocol"] == "1" and card["spec"] == "glow" and card["operating_point"] == 0.25
    assert {"recall", "recall_own", "ap50", "ap50_95", "false_alarms", "n", "ci95"} <= card["clean"].keys()
    assert card["clean"]["n"] == 6 and card["clean"]["backgrounds"] == 4
    assert card["recall_by"].keys() == {"distance", "azimuth", "elevation", "body", "pose"}
    for rows in card["recall_by"].values():
        assert sum(row["n"] for row in rows.values()) == 6
    assert card["controls"].keys() == {"noise", "clothing", "grey", "random", "stripes", "checks"}
    assert [row["asked"] for row in card["white_box"]] == [0.05, 0.76]
    for row in card["white_box"]:
        low, high = row["ci95_own"]
        assert 0 <= low <= row["success_own"] <= high <= 1 and row["n"] == 2 * 3
        assert row["masr"] == pytest.approx(np.mean(list(row["by_threshold"].values())), abs=1e-3)
    assert card["circle"] == card["around"]["success"] and card["around"]["by_angle"].keys() == {"0", "180"}
    (entry,) = card["black_box"]["zoo"]
    assert entry["name"] == "builtin-sample" and entry["trained_against_it"] is False
    assert card["black_box"]["success_own"] == entry["success_own"]
    done = [d for _, d, _ in told]
    assert done == sorted(done) and done[-1] == told[-1][2] > 0


@pytest.mark.slow
def test_it_is_made_once_and_the_same_again(made: tuple[Path, dict, list], monkeypatch: pytest.MonkeyPatch) -> None:
    out, card, _ = made
    for name in ("train", "measure_frozen"):
        monkeypatch.setattr(store_module, name, lambda *_, **__: pytest.fail("made again"))
    again = Assessment(make_store(out, Glow("glow")), TINY, out / "glow", ["builtin-sample"]).run()
    assert again == card  # its seconds, too: of what was done before, no more


@pytest.mark.slow
def test_of_a_black_box_only_what_needs_no_gradients(made: tuple[Path, dict, list]) -> None:
    card = json.loads((made[0] / "dark/card.json").read_text())
    assert card["white_box"] == [] and card["circle"] is None and card["clean"]["n"] == 6
    said = words.not_tested(card)
    assert "gives no gradients" in said[0] and "No cloak made against other detectors" in said[1]
    assert "gives no gradients" in words.headline(card) and words.verdict(card)[0] == "unknown"
    assert "white box not tested" in (made[0] / "dark/card.html").read_text()


@pytest.mark.slow
def test_the_page_needs_nothing_but_itself(made: tuple[Path, dict, list]) -> None:
    page = (made[0] / "glow/card.html").read_text("utf-8")
    assert "<script" not in page and not re.search(r"(src|href)=\"(?!data:|#)", page)
    for words_of in ("What was not tested", "By the cloak", "All around", "By the detection threshold"):
        assert words_of in page
    assert words.headline(made[1]) in page
    assert (made[0] / "glow/card.md").read_text().startswith("| detector |")


@pytest.mark.slow
def test_several_are_compared_on_one_page_and_in_a_leaderboard(made: tuple[Path, dict, list], tmp_path: Path) -> None:
    shutil.copytree(made[0], tmp_path / "cards")
    out = tmp_path / "cards"
    page = write_comparison({"glow": out / "glow", "dark": out / "dark"}, out / "card.html").read_text("utf-8")
    assert 'href="glow/card.html"' in page and "<script" not in page and page.count('class="compared"') == 2
    Assess(out=out).run()
    assert "<h1>dark net · glow</h1>" in (out / "card.html").read_text("utf-8"), "detectors by name, not by folder"
    write_leaderboard(gather(out), tmp_path / "board.md")
    rows = [line for line in (tmp_path / "board.md").read_text().splitlines() if line.startswith("| ")]
    assert [row.split(" | ")[0] for row in rows[2:]] == ["| glow", "| dark net"]  # no white-box figures: last
    assert len({row.count("|") for row in rows}) == 1
    record = json.loads((out / "glow/card.json").read_text()) | {"protocol": "0"}
    (out / "glow/card.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match=r"card.json: a card of protocol '0'; this version has '1'"):
        gather(out)


def test_areas_are_nested_and_as_large_as_asked() -> None:
    bodies = sample_bodies("train")
    areas = nested_areas(bodies, AREAS)
    for small, large in itertools.pairwise(areas):
        assert set(small) < set(large)
    assert [area_share(bodies, ids) for ids in areas] == pytest.approx(AREAS, abs=0.01)
    assert bodies.regions["front"][areas[1]].all() and not bodies.regions["front"][areas[3]].all()


@pytest.mark.slow
def test_the_headline_names_the_least_area_that_hides_half(made: tuple[Path, dict, list]) -> None:
    card = made[1]
    row = card["white_box"][0]
    told = lambda *shares: replaced(card, [row | {"area": a, "asked": a, "success_own": s} for a, s in shares])
    weak = told((0.05, 0.1), (0.2, 0.5), (0.76, 0.9))
    assert "on 20 % of the body" in words.headline(weak) and words.verdict(weak) == (
        "bad",
        "hidden by 20 % of the body",
    )
    strong = told((0.05, 0.1), (0.76, 0.3))
    assert "No cloak" in words.headline(strong) and words.verdict(strong)[0] == "unknown"  # of six images
    sure = replaced(strong, [row | {"ci95_own": [0.1, 0.4]} for row in strong["white_box"]])
    assert words.verdict(sure)[0] == "good"


def replaced(card: dict, rows: list[dict]) -> dict:
    return card | {"white_box": rows}


@pytest.mark.slow
def test_another_budget_takes_its_own_time(made: tuple[Path, dict, list], tmp_path: Path) -> None:
    shutil.copy(made[0] / "glow/spent.json", tmp_path)
    store = make_store(tmp_path, Glow("glow"))
    work = lambda budget: Work({}, tmp_path / "spent.json", asked(budget))
    asked = lambda budget: Assessment(store, budget, tmp_path, ["builtin-sample"])._asked()
    assert work(TINY).seconds > 0 == work(replace(TINY, steps=3)).seconds
    assert QUICK.steps < DEFAULT.steps < FULL.steps and QUICK.areas == DEFAULT.areas == FULL.areas == AREAS


def test_names() -> None:
    assert [stance_of(name) for name in ("walking-10", "standing", "12")] == ["walking", "standing", "12"]
    names = folder_names(("builtin", "builtin@conf=0.3", "onnx:a/net.onnx", "onnx:b/net.onnx"))
    assert names["builtin"] == "builtin" and len(set(names.values())) == 4


def test_bad_options_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    for asked, said in (
        (["builtin", "--quick", "--full"], "--quick, --full"),
        ([], "holds no card"),
    ):
        with pytest.raises(SystemExit, match="2"):
            main(["assess", *asked, "--out", str(tmp_path)])
        assert said in capsys.readouterr().err


def test_each_part_gets_its_share_of_the_time_that_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(work_module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    costs = {"a": (0.0, 60.0), "b": (60.0, 40.0), "c": (0.0, 100.0)}
    make = lambda: Work(costs, tmp_path / "spent.json", "x", minutes=1.0, rate=0.1)
    work, shares = make(), {}
    for name, trained, looked in (("a", 0.0, 12.0), ("b", 30.0, 10.0), ("c", 0.0, 1.0)):
        with work.part(name) as shares[name]:
            if trained:
                work.on_event({"type": "start", "steps": 2})
                now[0] += trained
                work.on_event({"type": "end"})
            now[0] += looked
    assert shares["a"] == 1.0, "26 seconds were expected"
    assert shares["b"] == 1.0, "6 s of training as before, 28 of looking at 0.2 s an image: 34 of the 42 that are left"
    assert shares["c"] == pytest.approx((54 - 52) / (100 * 22 / 100), abs=1e-3), "training says nothing of looking"
    again = make()
    with again.part("c") as share:
        assert share == shares["c"], "a stopped card goes on with the same numbers"
    assert again.total == pytest.approx(60 + 100 + 100 * shares["c"]), "what is left is told of what will be done"
    with Work({"a": (0.0, 60.0)}, tmp_path / "other.json", "x").part("a") as share:
        assert share == 1.0, "any time"
    late = Work(costs, tmp_path / "late.json", "x", minutes=1.0, rate=0.1, prepared=41.0)
    with late.part("a") as share:
        assert share == 0.5, "13 s are left of 54, and 26 expected"
    assert late.seconds == 41.0


def test_small_cloaks_are_dropped_where_the_time_is_short(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(work_module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    costs = {"clean": (0.0, 10.0)} | {name: (100.0, 100.0) for name in ("small", "middle", "large", "circle")}
    make = lambda: Work(costs, tmp_path / "spent.json", "x", minutes=1.0, rate=0.05, optional=("small", "middle"))
    work, shares = make(), {}
    with work.part("clean") as shares["clean"]:
        now[0] += 4.0
    assert set(work.shares) == {"clean"}, "what a moment's clock says drops nothing"
    for name in ("small", "middle", "large", "circle"):
        with work.part(name) as shares[name]:
            now[0] += 20 * shares[name]
    assert shares["small"] == shares["middle"] == 0, "all four would get 50 s of 180"
    assert shares["large"] == pytest.approx(50 / 90, abs=1e-3) and shares["circle"] == 1.0
    with make().part("small") as share:
        assert share == 0, "a stopped card drops the same"


PEOPLE = {
    "people": 9,
    "left_out": {},
    "rows": {
        name: {"success_own": own, "ci95_own": [own, own], "success": own, "renamed_own": None, "gone_own": None}
        for name, own in (("made against it", 0.4), ("texture@tile=0.5", 0.7), ("clothing", 0.1), ("grey", 0.9))
    },
}


@pytest.mark.slow
def test_photographs_come_before_renders(made: tuple[Path, dict, list], tmp_path: Path) -> None:
    shutil.copytree(made[0] / "glow", tmp_path / "glow")
    card = made[1] | {"photographs": PEOPLE, "patterns": [made[1]["white_box"][0] | {"name": "texture@tile=0.5"}]}
    assert words.headline(card).startswith("In photographs, 70 % of people who wear the pattern texture are hidden")
    assert words.worst(card)["value"] == "70 %" and "photographs" in words.worst(card)["what"]
    assert "second sensor" in words.advice(
        card | {"clean": card["clean"] | {"recall_own": 1.0, "false_alarms_own": 0.0}}
    )
    assert "without any attack" in words.advice(card | {"clean": card["clean"] | {"recall_own": 0.5}})
    (tmp_path / "glow/card.json").write_text(json.dumps(card))
    page = write_card(tmp_path / "glow").read_text("utf-8")
    assert page.index("What to do") < page.index("For engineers") < page.index("People in photographs")
    assert "Published patterns" in page and "Article 15(5)" in page
    head = (tmp_path / "glow/model_card.md").read_text().split("---\n")[1].splitlines()
    front = {key: json.loads(value) for key, _, value in (line.partition(": ") for line in head)}
    metrics = {metric["name"]: metric["value"] for metric in front["model-index"][0]["results"][0]["metrics"]}
    assert metrics["hidden in photographs, texture@tile=0.5"] == 0.7 and front["pipeline_tag"] == "object-detection"


@pytest.mark.slow
def test_the_leaderboard_has_robustness_first(made: tuple[Path, dict, list]) -> None:
    heads = list(leaderboard_row(made[1]))
    assert heads[:4] == ["detector", "76 % ↓", "5 % ↓", "all around ↓"] and heads.index("clean recall ↑") > 3


@pytest.mark.slow
def test_an_attack_that_was_too_short_shows_a_lower_bound(made: tuple[Path, dict, list]) -> None:
    card = made[1]
    assert not any(is_too_short(card, row) for row in (*card["white_box"], card["around"]))
    short = card | {"counts": card["counts"] | {"steps": 1000}}
    assert words.verdict(short)[0] == "unknown" or words.verdict(card)[0] == "bad"
    assert leaderboard_row(short)["5 % ↓"].startswith("≥ ") and not leaderboard_row(card)["5 % ↓"].startswith("≥ ")
    tile = next(tile for tile in words.tiles(short) if "all around" in tile["what"])
    photographs = dict(PEOPLE["rows"], **{"texture@tile=0.5": PEOPLE["rows"]["clothing"] | {"success_own": 0.02}})
    photographs["made against it"] = photographs["texture@tile=0.5"]
    worn = short | {"photographs": PEOPLE | {"rows": photographs}, "clean": card["clean"] | {"recall_own": 1.0}}
    worn["clean"]["false_alarms_own"] = 0.0
    assert words.headline(worn).startswith("In photographs, at least 2 %") and "more time" in words.advice(worn)
    assert words.worst(worn)["value"] == "≥ 2 %" and words.worst(worn)["kind"] == "unknown"
    assert tile["value"].startswith("≥ ") and "4 updates" in tile["what"] and tile["kind"] != "good"


def test_a_score_at_the_threshold_is_not_rounded_up_to_it() -> None:
    macro = page_module._environment().get_template("macros.html").module.verdict
    assert "no person (best 0.39)" in macro({"found": [(0, False, 0.3999)]}, ["glow"])


def test_progress_counts_what_was_done_and_what_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[float] = []
    work = Work({"a": (60.0, 40.0), "b": (0.0, 100.0)}, tmp_path / "spent.json", "x", lambda _, d, n: told.append(d), 2)
    with work.part("a"):
        for step in (1, 2):
            work.on_event({"type": "start", "steps": 2})
            work.on_event({"type": "step", "step": step})
            work.on_event({"type": "end"})
        work.on_images(1, 2)
    with pytest.raises(KeyboardInterrupt), work.part("b"):
        work.on_images(1, 4)
        raise KeyboardInterrupt
    assert told == [0, 15, 60, 80, 100, 100, 125] and work.total == 200
    spent = json.loads((tmp_path / "spent.json").read_text())
    assert spent["done"] == ["a"] and spent["seconds"].keys() == {"a", "b"}
    clock = iter([0.0, 0.0, 0.001, 10.0])
    monkeypatch.setattr(progress_module, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    progress = WorkProgress(silent=True)
    for done in (0.0, 100.0, 150.0):  # the first hundred were found done; fifty took ten seconds
        progress("a", done, 200.0)
    assert progress.left(200.0) == pytest.approx(10.0, rel=0.01)
