"""Dressing made people: what is worn where, what is counted, and what is written."""

import csv
import json
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from PIL import Image

from cloak_core import evaluate, film, wear
from cloak_core.commands.wear import expanded, show_worn
from cloak_core.core.evaluation.results import CORNERS
from cloak_core.core.evaluation.settings import FilmSettings, WearSettings
from cloak_core.core.linear import SparseMap
from cloak_core.core.logo import Cover
from cloak_core.files.errors import InputError
from cloak_core.patterns.cloth import ClothPattern, Grid
from cloak_core.sources.bodies.people.clothed import clothed_bodies
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.fits import Fits, fit_people
from cloak_core.sources.photographs.people import People, load_people
from cloak_core.sources.photographs.rig import faces_on_rig
from cloak_core.sources.photographs.source import PeopleSource
from cloak_core.sources.photographs.views import logo_positions
from cloak_core.studies.opening import open_pattern
from cloak_core.studies.wearing.wearing import CAPTION, FOUND, HEAD, HIDDEN, TILE, TITLE, WIDTHS, Album
from cloak_core.zoo.entry import entry
from tests.core.fakes import RedDetector, Says
from tests.schemas import validate
from tests.sources.photographs.made_people import write_people

pytestmark = pytest.mark.slow
SMALL = WearSettings(size=96, bare=2)


def less_red(images: torch.Tensor) -> torch.Tensor:
    """The surer the less red it is in the middle."""
    side = images.shape[-1]
    middle = images[..., side // 4 : side * 3 // 4, side * 2 // 5 : side * 3 // 5]
    return torch.sigmoid(4 - 40 * (middle[:, 0].mean((1, 2)) - middle[:, 2].mean((1, 2))))


@pytest.fixture(scope="module")
def people(tmp_path_factory):
    return load_people(write_people(tmp_path_factory.mktemp("people"), 3))


@pytest.fixture(scope="module")
def red(tmp_path_factory):
    path = tmp_path_factory.mktemp("cloth") / "red.png"
    Image.new("RGB", (32, 32), (230, 10, 10)).save(path)
    return path


def test_a_red_cloth_hides_and_controls_do_not(people, red, tmp_path):
    out = tmp_path / "out"
    result = wear([f"{red}@tile=0.5"], people, {"body": Says(less_red)}, out=out, settings=SMALL)
    told = result["detectors"]["body"]
    assert told["red@tile=0.5"]["success"] == 1.0 and told["red@tile=0.5"]["n"] == 3
    assert {name: told[name]["success"] for name in ("clothing", "grey", "resampled")} == {
        "clothing": 0.0,
        "grey": 0.0,
        "resampled": 0.0,
    }
    low, high = told["grey"]["ci95"]
    assert low == 0.0 and high > 0.3
    seen_from = told["red@tile=0.5"]["seen_from"]
    assert sum(side["n"] for side in seen_from.values()) == 3 and seen_from["front"]["success_own"] == 1.0
    assert result["people"] == 3 and set(result["false_alarms"]) == {"body"}
    validate("wear", (out / "wear.json").read_text())
    assert json.loads((out / "wear.json").read_text())["detectors"]["body"]["grey"]["n"] == 3
    rows = list(csv.DictReader((out / "scores.csv").open()))
    assert len(rows) == 5 * 3 and {row["clothes"] for row in rows} == set(told)
    assert (
        sorted(p.name for p in (out / "pictures").glob("made0*/*")) == ["after red-tile=0.5.jpg", "before.jpg"]
        and (out / "sheet.jpg").exists()
    )


def worn(spec, fit):
    """Which colours each pixel of a photograph wears, and the colours that it shows."""
    pattern = open_pattern(str(spec))[0]
    places = PeopleSource(Fits([fit.person], lambda _: fit), 96).view({"person": 0}, None, pattern).places
    shown: SparseMap = pattern.map(places)
    return shown, shown.apply(torch.from_numpy(pattern.colors)).numpy()


def test_a_patch_lies_on_the_chest_alone(people, red):
    fit = fit_people(people)[0]
    patch, cloth = (worn(f"{red}@{kind}", fit)[0].row_sums().sum() for kind in ("patch=0.3", "tile=0.3"))
    assert 0.3 * (0.3 * fit.scale) ** 2 < patch < 1.1 * (0.3 * fit.scale) ** 2 and patch < 0.4 * cloth


def test_a_cloth_repeats_every_so_many_metres(people, tmp_path):
    stripes = np.zeros((64, 64, 3), np.uint8)
    stripes[:32] = 255
    Image.fromarray(stripes).save(tmp_path / "stripes.png")
    fit = fit_people(people)[0]
    shown, colors = worn(f"{tmp_path / 'stripes.png'}@tile=0.4", fit)
    # On the body at rest a stripe is 0.2 m high, wherever it lies.
    height = np.floor(-fit.rest[:, 1] / 0.2).astype(int) % 2 == 0
    assert ((colors[:, 0] > 0.5) == height)[shown.row_sums().numpy() > 0.5].mean() > 0.93


def test_zoo_entries_of_every_known_topology_are_worn():
    for name in ("transfer-anny", "builtin-sample", "builtin-clothed"):
        pattern = open_pattern(f"zoo:{name}")[0]
        position = logo_positions(pattern.cover.topology, pattern.cover.face_ids)
        assert (position >= 0).sum() > 1000 and position.max() < len(pattern.colors)


def test_a_run_of_cloth_is_worn_as_the_cloth_where_its_logo_is(people, tmp_path):
    run = entry("transfer-people").write_run(tmp_path / "run")
    assert open_pattern(str(run))[0].period == 0.25
    fit = fit_people(people)[0]
    (shown, colors), (same, other) = worn(run, fit), worn(f"{run / 'cloth.png'}@tile=0.25", fit)
    assert np.array_equal(colors, other) and (shown.to_scipy() - same.to_scipy()).nnz == 0 and len(shown) > 100
    config = json.loads((run / "config.json").read_text())
    del config["settings"]["tile_cm"]
    (run / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match="does not say how wide"):
        open_pattern(str(run))


def test_prints_are_worn_and_anything_of_cloth_upside_down(people, tmp_path):
    named = ("print:ellipses@tile=0.3", "print:ellipses@tile=0.3@flipped")
    named += ("zoo:transfer-people@flipped", "zoo:transfer-people@tile=0.5")
    opened = [open_pattern(spec) for spec in named]
    assert [name for *_, name in opened] == list(named)
    assert [pattern.period for pattern, *_ in opened] == [0.3, 0.3, 0.25, 0.5]
    upright, flipped, whole, wider = (pattern.picture(pattern.colors) for pattern, *_ in opened)
    assert np.array_equal(upright[::-1], flipped) and np.array_equal(whole[::-1], wider)
    fit = fit_people(people)[0]
    assert not np.array_equal(worn(named[0], fit)[1], worn(named[1], fit)[1])


def test_a_width_is_chosen_on_those_who_do_not_judge(people, tmp_path):
    bars = np.zeros((100, 100, 3), np.uint8)
    bars[:, :40, 2] = 255
    bars[:, 40:, 0] = 255
    Image.fromarray(bars).save(tmp_path / "bars.png")
    spec, other = f"{tmp_path / 'bars.png'}@tile=auto", Says(less_red, name="other")
    other.weight.data += 1  # another network
    judges, chosen_on = people.halves()
    judged = partial(wear, [spec, "print:dots@tile=0.2"], judges, {"body": Says(less_red)}, settings=SMALL)
    result = judged(width_people=chosen_on, width_detectors={"other": other}, out=tmp_path / "out")
    curve = result["widths"][spec]
    rates = {metres: s["success"] + s["success_own"] for metres, s in curve["detectors"]["other"].items()}
    assert list(map(float, rates)) == list(WIDTHS) and len(set(rates.values())) > 1
    assert curve["chosen"] == float(max(rates, key=rates.get)) and curve["people"] == len(chosen_on)
    assert f"bars@tile={curve['chosen']:g}" in result["detectors"]["body"]
    assert json.loads((tmp_path / "out" / "wear.json").read_text())["widths"] == result["widths"]
    validate("wear", (tmp_path / "out" / "wear.json").read_text())
    show_worn(result, 0.6)
    for words, asked, detectors in (
        ("needs --width-people", None, {"other": other}),
        ("needs --width-detector", chosen_on, {}),
        (f"--width-people: {judges.photographs[0]} judges as well", people, {"other": other}),
        ("--width-detector: again judges as well", chosen_on, {"other": other, "again": Says(less_red)}),
    ):
        with pytest.raises(InputError, match=words):
            judged(width_people=asked, width_detectors=detectors)


BAD = {
    "no such entry": "zoo:nothing",
    "say how wide": "{red}",
    "99 metres are not between 0.01 and 5": "{red}@tile=99",
    "nan metres are not between": "{red}@tile=nan",
    "1e3 metres are not between": "{red}@patch=1e3",
    "-0.5 metres are not between": "{red}@patch=-0.5",
    "no such file": "{red}x.png@tile=0.5",
    "the width auto is not": "{red}@tile=auto",
    "print:dots: say how wide": "print:dots",
    "no such print": "print:zigzag@tile=0.3",
    "has no cloth that repeats": "zoo:transfer-anny@tile=0.3",
    "colours of faces": "zoo:transfer-anny@flipped",
}


@pytest.mark.parametrize("words", BAD)
def test_colours_that_cannot_be_worn_are_named(red, words):
    with pytest.raises(InputError, match=words):
        open_pattern(BAD[words].format(red=red))


def test_a_pattern_of_names_is_every_picture_with_one(tmp_path):
    for name in ("b.png", "a.png", "c.jpg"):
        (tmp_path / name).touch()
    assert expanded(f"{tmp_path}/*.png@tile=0.5") == [f"{tmp_path}/{name}@tile=0.5" for name in ("a.png", "b.png")]
    as_they_are = ("zoo:transfer-people", "runs/first", f"{tmp_path}/none*.png@patch=0.3", f"{tmp_path}/a.png")
    assert [expanded(color) for color in as_they_are] == [[color] for color in as_they_are]


def near(pixel: tuple[int, ...], color: tuple[int, ...]) -> bool:
    return max(abs(a - b) for a, b in zip(pixel, color, strict=True)) < 30


def test_the_sheet_marks_who_is_hidden(tmp_path: Path) -> None:
    image = Image.new("RGB", (96, 96), (90, 90, 90))
    box = {"detector": 0, "score": 0.9, **dict(zip(CORNERS, (10.0, 10.0, 60.0, 90.0), strict=True))}
    found = pd.DataFrame([box])
    album = Album(tmp_path, ["a.jpg#1", "b.jpg#2"], {"onnx:models/net.onnx": 0.5})
    for clothes, boxes in {"clothing": (found, found), "red@tile=0.5": (found, found.assign(score=0.4))}.items():
        for person in (0, 1):
            album.add(clothes, person, image, boxes[person])
    album.write()
    sheet = Image.open(tmp_path / "sheet.jpg")
    height = TILE + CAPTION + TITLE
    assert sheet.size == (720, HEAD + 2 * height)
    strip = HEAD + TITLE + TILE + CAPTION - 4
    assert near(sheet.getpixel((TILE - 8, strip)), FOUND) and near(sheet.getpixel((2 * TILE - 8, strip)), FOUND)
    assert near(sheet.getpixel((TILE - 8, strip + height)), FOUND)
    assert near(sheet.getpixel((2 * TILE - 8, strip + height)), HIDDEN)
    assert (tmp_path / "pictures").is_dir()
    assert HIDDEN[0] > HIDDEN[1] and FOUND[1] > FOUND[0]  # as on a card: red is hidden, green is found


HOOD, CLOTHES = "shirt+trousers+hood", "shirt+trousers"


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> People:
    return load_people(write_people(tmp_path_factory.mktemp("two"), 2))


@pytest.mark.parametrize("where", ["people", "bodies"])
def test_evaluate_judges_a_cloth_where_it_is_told(two: People, tmp_path: Path, where: str) -> None:
    run = entry("transfer-people").write_run(tmp_path / "run")
    shown = {"people": two} if where == "people" else {"scene": "sample:unseen[0]", "angles": "0"}
    judge = partial(
        evaluate,
        run,
        detectors={"red": Says(lambda images: images.mean((1, 2, 3)))},
        controls=("grey",),
        size=64,
        shift=4,
        bare=1,
    )
    judge = partial(judge, images_per_view=1, resamples=100, **shown)
    said = [judge(), judge(logo=CLOTHES), judge(logo=HOOD)]
    assert [one["cover"] for one in said] == [CLOTHES, CLOTHES, HOOD]
    scores = [one["detectors"]["red"]["grey"]["mean_score"] for one in said]
    assert scores[0] == scores[1] != scores[2]
    folder = run / f"evaluation{'-people' * (where == 'people')}-{HOOD}"
    validate("evaluate", (folder / "summary.json").read_text())


def test_wear_and_film_say_what_is_covered(two: People, tmp_path: Path) -> None:
    how = {"settings": WearSettings(size=64, bare=1), "out": tmp_path / "out", "logo": HOOD}
    said = wear(["zoo:transfer-people", "print:balls@patch=0.3"], two, {"red": RedDetector()}, **how)
    rows = said["detectors"]["red"]
    assert json.loads((tmp_path / "out" / "wear.json").read_text())["cover"] == said["cover"] == HOOD
    covers = {name: row["cover"] for name, row in rows.items()}
    assert covers == dict.fromkeys(rows, HOOD) | {"print:balls@patch=0.3": "chest", "grey headwear": "headwear"}
    plain = wear("zoo:transfer-people", two, {"red": RedDetector()}, settings=how["settings"])
    assert plain["cover"] == plain["detectors"]["red"]["zoo:transfer-people"]["cover"] == CLOTHES
    shown = {"detectors": {"red": RedDetector()}, "settings": FilmSettings(size=64, seconds=0.1)}
    took = film("zoo:transfer-people", tmp_path / "film", "sample:unseen[0]", logo=HOOD, **shown)
    assert took["cover"] == HOOD


def test_who_shows_nothing_of_a_cloth_is_left_out_and_counted(two: People) -> None:
    topology = sample_bodies().topology
    first, second = (set(faces_on_rig(topology)[np.unique(fit.main)].tolist()) for fit in fit_people(two))
    unseen = set(range(sample_bodies().face_count)) - first - second

    def dressed(faces: set[int]) -> Crowd:
        cover = Cover(np.array(sorted(faces)[:1]), topology, name="one face")
        return Crowd(two).wearers([ClothPattern(cover, Grid.of(0.25, 0.01))])

    shown = dressed(first - second)
    assert len(shown) == len(shown.fits) == 1 and shown.people.left_out == {"nothing is covered": 1}
    with pytest.raises(InputError, match="one face shows on nobody"):
        dressed(unseen)


UNCOVERED = {
    "region 'hoodie' is unknown; scene 'samples' has: .*hood": {"logo": "shirt+hoodie"},
    "colours of faces": {"logo": HOOD, "colors": "zoo:transfer-anny"},
    "scene 'sample-clothed' has: .*scarf": {"logo": "beard", "scene": clothed_bodies},
}


@pytest.mark.parametrize("words", UNCOVERED)
def test_what_cannot_be_covered_is_refused(two: People, words: str) -> None:
    asked = {"colors": "zoo:transfer-people"} | UNCOVERED[words]
    judges = {"red": RedDetector()}
    with pytest.raises(InputError, match=words):
        if scene := asked.pop("scene", None):
            evaluate("zoo:builtin-clothed", scene("unseen"), detectors=judges, **asked)
        else:
            wear(people=two, detectors=judges, **asked)
