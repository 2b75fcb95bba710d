"""The robustness card on tiny images: a fake detector under a tiny budget, its pages, its figures, what people wear."""

import itertools
import json
import math
import re
import shutil
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.commands.assess import Assess
from cloak_core.commands.wear import expanded
from cloak_core.core.logo import area_share
from cloak_core.core.source import NOBODY
from cloak_core.core.visibility.threads import torch_threads
from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.studies import store, training_store
from cloak_core.studies.card import words
from cloak_core.studies.card.assess import Assessment
from cloak_core.studies.card.leaderboard import gather, write_leaderboard
from cloak_core.studies.card.page import leaderboard_row, write_card, write_comparison
from cloak_core.studies.card.protocol import AREAS, GREY_HEAD, HEADS, QUICK, Part, nested_areas
from cloak_core.studies.card.words import worn_rows
from cloak_core.studies.opening import open_pattern
from cloak_core.studies.pace import DetectorPace
from cloak_core.studies.report.words import duration, percent
from cloak_core.studies.wearing.patterns import pattern_specs, read_patterns
from tests.schemas import validate
from tests.studies.made_split import TINY, Bulb, make_store


@pytest.mark.slow
def test_the_card_has_what_the_protocol_asks_for(made: tuple[Path, dict, list]) -> None:
    out, card, told = made
    assert validate("card", (out / "glow/card.json").read_text()) == json.loads(json.dumps(card, allow_nan=False))
    assert (card["protocol"], card["size"], card["spec"], card["operating_point"]) == ("2", "tiny", "glow", 0.25)
    assert card["clean"]["n"] == 6 and card["clean"]["backgrounds"] == 4
    assert card["recall_by"].keys() == {"distance", "azimuth", "elevation", "body", "pose"}
    assert not any(character.isdigit() for pose in card["recall_by"]["pose"] for character in pose)
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
    for module, name in ((training_store, "train"), (store, "measure_frozen")):
        monkeypatch.setattr(module, name, lambda *_, **__: pytest.fail("made again"))
    left = out / "glow" / ".spent.json.1yv8pe0c"  # of a writer that was killed
    left.touch()
    again = Assessment(make_store(out, Bulb("glow")), TINY, out / "glow", ["builtin-sample"]).run()
    assert again == card  # its seconds, too: of what was done before, no more
    assert not left.exists()


@pytest.mark.slow
def test_of_a_black_box_only_what_needs_no_gradients(made: tuple[Path, dict, list]) -> None:
    card = validate("card", (made[0] / "dark/card.json").read_text())
    assert card["white_box"] == [] and card["circle"] is None and card["clean"]["n"] == 6
    said = words.not_tested(card)
    assert "gives no gradients" in said[0] and "No cloak made against other detectors" in said[1]
    assert "gives no gradients" in words.headline(card) and words.judge(card)[0] == "unknown"
    assert card["state"] == card["black_box"]["state"] == "not measured"
    assert "white box not measured" in (made[0] / "dark/card.html").read_text()


@pytest.mark.slow
def test_the_page_needs_nothing_but_itself(made: tuple[Path, dict, list]) -> None:
    page = (made[0] / "glow/card.html").read_text("utf-8")
    assert "<script" not in page and not re.search(r"(src|href)=\"(?!data:|#)", page)
    heads = ("What was not tested", "By the cloak", "All around", "By the detection threshold")
    assert all(head in page for head in heads)
    assert all(line["said"] in page for line in words.lines(made[1])) and words.relation(made[1]) in page
    assert (made[0] / "glow/card.md").read_text().startswith("| detector |")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "front"), [("x", "{}/secret"), ("x", "../../../secret"), ("..", "../secret"), ("{}", "secret")]
)
def test_pictures_of_a_card_lie_in_its_folder(
    made: tuple[Path, dict, list], tmp_path: Path, part: str, front: str
) -> None:
    folder = shutil.copytree(made[0] / "glow", tmp_path / "card")
    (tmp_path / "secret").write_text("mine")
    cloak = {"part": part.format(tmp_path), "front": front.format(tmp_path)}
    (folder / "pictures.json").write_text(json.dumps({"cloaks": [cloak]}))
    with pytest.raises(InputError, match="no such file"):
        write_card(folder)


@pytest.mark.slow
def test_several_are_compared_on_one_page_and_in_a_leaderboard(made: tuple[Path, dict, list], tmp_path: Path) -> None:
    shutil.copytree(made[0], tmp_path / "cards")
    out = tmp_path / "cards"
    page = write_comparison({"glow": out / "glow", "dark": out / "dark"}, out / "card.html").read_text("utf-8")
    assert 'href="glow/card.html"' in page and "<script" not in page and page.count('class="compared"') == 2
    Assess(out=out).run()
    assert "<h1>dark net · glow</h1>" in (out / "card.html").read_text("utf-8"), "detectors by name, not by folder"
    write_leaderboard(gather(out).values(), tmp_path / "board.md")
    rows = [line for line in (tmp_path / "board.md").read_text().splitlines() if line.startswith("| ")]
    assert [row.split(" | ")[0] for row in rows[2:]] == ["| glow", "| dark net"]  # no white-box figures: last
    assert len({row.count("|") for row in rows}) == 1
    row = leaderboard_row(made[1])
    assert list(row)[:5] == ["detector", "photographs ↓", "76 % ↓", "5 % ↓", "all around ↓"]
    assert row["photographs ↓"] == "–" and row["76 % ↓"].startswith("≥ ") and row["size"] == "tiny"
    record = json.loads((out / "glow/card.json").read_text()) | {"protocol": "0"}
    (out / "glow/card.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match=r"card.json: protocol is '0'; this version has '2'"):
        gather(out)


def test_areas_are_nested_and_as_large_as_asked() -> None:
    bodies = sample_bodies("train")
    areas = nested_areas(bodies, AREAS)
    for small, large in itertools.pairwise(areas):
        assert set(small) < set(large)
    assert [area_share(bodies, ids) for ids in areas] == pytest.approx(AREAS, abs=0.01)
    assert bodies.regions["front"][areas[1]].all() and not bodies.regions["front"][areas[3]].all()


@pytest.mark.slow
def test_cloaks_do_not_depend_on_the_number_of_threads(tmp_path: Path) -> None:
    """A network's sums do: cloaks trained on as many threads as there are would differ, and with them the figures."""
    colors = {}
    for threads in (1, 3):
        assessment = Assessment(make_store(tmp_path / str(threads), load_detector("builtin")), TINY, tmp_path, [])
        with torch_threads(threads):
            colors[threads] = assessment._train(Part("circle", steps=4))[0].pattern.colors
    assert np.array_equal(colors[1], colors[3])


@pytest.mark.slow
def test_minutes_take_the_largest_size_that_fits_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command = Assess(specs=("glow",), out=tmp_path, minutes=30.0)
    monkeypatch.setattr(Assess, "split", lambda *_, **__: None)
    monkeypatch.setattr(store, "RunStore", lambda *_: make_store(tmp_path, Bulb("glow")))
    paces = {"full": 9000.0, "standard": 4000.0, "quick": 600.0}
    told = lambda self, pace: (paces[self.size.name], DetectorPace(0.03, 0.096))
    monkeypatch.setattr(Assessment, "seconds_left", told)
    chosen = command._choose("glow", Bulb("glow"), tmp_path / "glow", NOBODY, ())
    assert chosen.size is QUICK
    said = r"--minutes 5: glow: size quick, the smallest, takes about 10 min .*96 ms a forward and backward"
    with pytest.raises(InputError, match=said):
        replace(command, minutes=5.0)._choose("glow", Bulb("glow"), tmp_path / "glow", NOBODY, ())


@pytest.mark.parametrize("size", [["--quick", "--full"], ["--size", "full", "--minutes", "3"], []])
def test_bad_options_are_one_line(size: list[str], tmp_path: Path, cloak) -> None:
    code, _, err = cloak("assess", *["builtin"] * bool(size), *size, "--out", tmp_path)
    assert code == 2 and ("--size, --quick, --full, --minutes: one of them" if size else "holds no card") in err


def short_card(**changes: object) -> dict:
    """A card by hand: one cloak on 76 % of the body, the zoo, photographs; all measured, nobody hidden."""
    row = S | {"asked": 0.76, "area": 0.76, "steps": 300, "success_own": 0.02, "ci95_own": [0.0, 0.1]}
    zoo = row | {"name": "others", "trained_against_it": False}
    clean = {"recall_own": 0.99, "false_alarms_own": 0.01, "ci95_own": [0.9, 1.0], "ci95_false_alarms_own": [0.0, 0.1]}
    card = {"spec": "builtin", "size": "quick", "partial_gradient": "", "clean": clean | {"state": "measured"}}
    card |= {"white_box": [row], "around": None, "black_box": {"zoo": [zoo]}}
    return card | {"patterns": [], "photographs": None} | changes


def hiding(row: dict, share: float, state: str = "measured") -> dict:
    return row | {"success_own": share, "ci95_own": [share, share], "state": state}


S = {"success": 0.3, "renamed_own": None, "gone_own": None, "named_own": None, "state": "measured"}


def test_one_rule_says_how_sure_a_figure_is_everywhere() -> None:
    """A cloak of 25 updates: no page, badge, table or gate takes its share for the detector's."""
    card = short_card()
    assert words.judge(card)[:2] == ("good", "no attack hid half") and words.tiles(card)[1]["kind"] == "good"
    cases = ((25, 0.76, "at least"), (300, 0.2, "at least"), (300, 0.76, "measured"), (600, None, "measured"))
    assert all(Part("x", steps=n, area=area).state("") == sure for n, area, sure in cases)
    assert Part("circle", steps=600).state("the second stage is held") == "at least"
    assert Part("zoo x").state("held") == "measured"
    card["white_box"] = [hiding(card["white_box"][0], 0.02, "at least") | {"steps": 25}]
    (line,) = words.lines(card)
    assert "at least 2 %" in words.headline(card) and line["value"] == "≥ 2 %"
    assert line["kind"] == words.judge(card)[0] == "unknown"
    (tile,) = [tile for tile in words.tiles(card) if "76 %" in tile["what"]]
    assert (tile["value"], tile["state"], tile["kind"]) == ("≥ 2 %", "at least", "unknown") and "25 upd" in tile["what"]
    (missing,) = [tile for tile in words.tiles(card) if "all around" in tile["what"]]
    assert (missing["value"], missing["state"]) == ("–", "not measured")
    assert "short of the protocol" in words.judge(card)[2]


def test_advice_names_hardening_only_where_it_is() -> None:
    bad = short_card()
    bad["white_box"] = [hiding(bad["white_box"][0], 0.9)]
    assert "harden it (cloak harden builtin)" in words.judge(bad)[2]
    assert "cloak harden" not in words.judge(bad | {"spec": "tflite:net.tflite"})[2]
    assert "cloak harden" not in words.judge(bad | {"spec": "jpeg=75:builtin"})[2]
    assert "without any attack" in words.judge(bad | {"clean": bad["clean"] | {"recall_own": 0.5}})[2]
    unsure = short_card(white_box=[bad["white_box"][0] | {"success_own": 0.2, "ci95_own": [0.1, 0.6]}])
    assert words.judge(unsure)[0] == "unknown" and "the intervals of its attacks reach half" in words.judge(unsure)[2]


def test_the_card_says_what_renders_are_worth_in_photographs() -> None:
    """Photographs first, one number each, and a sentence on what the renders say of them."""
    card = short_card()
    card["white_box"] = [hiding(card["white_box"][0], 0.99)]
    row = card["white_box"][0] | {"success_own": 0.0, "ci95_own": [0.0, 0.09]}
    card["photographs"] = {"people": 40, "rows": {"made against it": row}}
    photographed, rendered = words.lines(card)
    assert (photographed["value"], rendered["value"]) == ("0 %", "99 %")
    said = "hides 0 % (95 % interval 0 – 9 %): what hides on renders does not hide there."
    assert said in words.headline(card)


@pytest.mark.slow
def test_patterns_are_worn_on_renders_and_beside_the_largest_cloak_by_people(worn: Path) -> None:
    card = json.loads((worn / "glow/card.json").read_text())
    assert card["left_patterns"] == ["white@tile=0.2"], "the size has two"
    (row,) = card["patterns"]
    assert row["name"] == "white@tile=0.5", "a patch is worn in photographs alone"
    assert row["n"] == 6 and row["success"] < row["clothing"] <= 1, "white glows"
    rows = card["photographs"]["rows"]
    shown = ["made against it", "zoo:builtin-sample", "white@tile=0.5", "white@patch=0.3"]
    assert list(rows)[:4] == shown and card["photographs"]["people"] == 2
    assert [rows[name]["state"] for name in shown] == ["at least", "measured", "measured", "measured"]
    assert rows["clothing"]["success_05"] is not None and rows["clothing"]["masr"] is not None
    assert list(rows)[4:7] == [*HEADS, GREY_HEAD] and list(worn_rows(card)) == shown, "no headline of covered heads"


CLOTH = """
[tcega]
file = "white.png"
put_on = "cloth"
metres = 0.25
trained_on = "YOLOv2"
source = "somewhere"
licence = "MIT"
"""
TABLE = CLOTH + CLOTH.replace("tcega", "other").replace("cloth", "patch").replace("0.25", "0.3")


def test_a_pattern_folder_says_how_each_picture_is_put_on(tmp_path: Path) -> None:
    Image.fromarray(np.full((8, 8, 3), 255, np.uint8)).save(tmp_path / "white.png")
    with pytest.raises(InputError, match=r"lacks patterns\.toml .*put_on, metres"):
        pattern_specs(str(tmp_path))
    (tmp_path / "patterns.toml").write_text(TABLE)
    specs = [f"{tmp_path}/white.png@tile=0.25", f"{tmp_path}/white.png@patch=0.3"]
    assert (
        pattern_specs(str(tmp_path)) == pattern_specs(f"{tmp_path}/patterns.toml") == expanded(str(tmp_path)) == specs
    )
    assert pattern_specs("white.png@tile=0.5") == ["white.png@tile=0.5"]
    assert [open_pattern(spec)[0].period for spec in specs] == [0.25, None]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('file = "white.png"\nput_on = "cloth"', 'file = "gone.png"\nput_on = "cloth"', "file 'gone.png' is missing"),
        ('file = "white.png"\nput_on = "cloth"', 'file = "../x.png"\nput_on = "cloth"', "lies outside its folder"),
        ('put_on = "cloth"', 'put_on = "hat"', "put_on is 'hat', neither cloth nor patch"),
        ("metres = 0.25", "metres = 9", "metres is 9, not between 0.01 and 5"),
        ("metres = 0.25", "metres = true", "metres is True"),
        ('licence = "MIT"', "", r"\[tcega\] lacks licence"),
        ('licence = "MIT"', 'licence = "MIT"\nsize = 3', r"\[tcega\] has size, which is none of"),
        ('source = "somewhere"', "source = 3", "source is 3, not text"),
    ],
)
def test_what_is_wrong_with_a_pattern_folder_is_named(old: str, new: str, said: str, tmp_path: Path) -> None:
    Image.fromarray(np.full((8, 8, 3), 255, np.uint8)).save(tmp_path / "white.png")
    (tmp_path / "patterns.toml").write_text(TABLE.replace(old, new, 1))
    with pytest.raises(InputError, match=rf"patterns.toml: .*{said}"):
        read_patterns(tmp_path)


FIGURE = re.compile(r"(?<![\w.#-])\d+(?:,\d{3})*(?:\.\d+)?(?: ?%)?(?![\w%])")
TEMPLATE = Path(words.__file__).parents[1] / "report" / "templates"
WORDED = "overlap of at least 0.5; at 0.6; 95 %; AP50 95; half; 0.05 0.95; 0 1"
"""Figures of sentences that the code has, not the template."""


def written(value: object) -> set[str]:
    """Every way in which the page may write a value, or what is in it."""
    if isinstance(value, (dict, list)):
        parts = [*value, *value.values()] if isinstance(value, dict) else value
        return set().union(*map(written, parts))
    if isinstance(value, str):
        return set(FIGURE.findall(value))
    if isinstance(value, bool) or value is None:
        return set()
    floor = f"{math.floor(100 * value) / 100:.2f}"  # a score below the threshold is not rounded up to it
    ways = {f"{value:g}", f"{value:,}", str(value), f"{100 * value:.1f}", f"{value:.2f}", floor}
    share = percent(float(value)) if 0 <= value <= 1 else ""
    return ways | {share, share.removesuffix(" %"), f"{value:.0%}", f"{100 * value:.0f}"}


def unknown(folder: Path, page: str) -> set[str]:
    """Figures in the page's text and plots that neither card nor pictures have, nor the template's own sentences."""
    card, pictures = (json.loads((folder / name).read_text("utf-8")) for name in ("card.json", "pictures.json"))
    templates = " ".join((TEMPLATE / name).read_text("utf-8") for name in ("card.html", "macros.html"))
    sentences = re.sub(r"{%(?!.*for head).*?%}|{{.*?}}", " ", templates)
    known = written(card) | written(pictures) | written([sentences, *words.ALWAYS, WORDED, duration(card["seconds"])])
    page = re.sub(r"<(style|pre|head)\b.*?</\1>|<text\b[^>]*>[^%]*</text>", "", page, flags=re.DOTALL)
    ticks = {f"{tick} %" for tick in range(0, 101, 10)}
    return set(FIGURE.findall(unescape(re.sub(r"<[^>]+>", " ", page)))) - known - ticks


@pytest.mark.slow
@pytest.mark.parametrize("name", ["glow", "dark"])
def test_every_figure_on_the_page_is_the_cards(name: str, made: tuple[Path, dict, list]) -> None:
    folder = made[0] / name
    page = (folder / "card.html").read_text("utf-8")
    assert not unknown(folder, page)
    assert unknown(folder, page.replace("</h1>", "</h1><p>hidden in 77 %, 1,234 images</p>")) == {"77 %", "1,234"}
