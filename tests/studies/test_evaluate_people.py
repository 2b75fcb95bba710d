"""A run judged on photographs, as on bodies: content decides what it was trained on, and the report shows it first."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core import evaluate, train
from cloak_core.core.run_folder import RunFolder
from cloak_core.exchange.face_lists import read_colors, write_colors
from cloak_core.exchange.profiles import Profile, write_profile
from cloak_core.files.errors import InputError
from cloak_core.products.run_report import make_report
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.people import load_people
from cloak_core.studies.opening import open_run, snapshot_pattern
from cloak_core.studies.report.stored import read_evaluation
from cloak_core.zoo.adding import write_entry
from cloak_core.zoo.entry import entry
from tests.core.fakes import RedDetector
from tests.detectors.helpers import write_tiny
from tests.schemas import validate
from tests.sources.photographs.made_people import write_people

pytestmark = pytest.mark.slow
HOW = {"size": 128, "bare": 2, "resamples": 100, "backgrounds": "procedural:test:2"}
CONTROLS = {"logo", "clothing", "grey", "random", "resampled"}


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return entry("builtin-sample").write_run(tmp_path / "run")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_people(tmp_path_factory.mktemp("people"), 3)


def trained_on(path: Path) -> dict:
    """A config.json as far as photographs go."""
    return json.loads(json.dumps({"people": Crowd(load_people(path)).record()}))


def test_a_run_is_judged_on_people_and_reported(run: Path, path: Path, caplog: pytest.LogCaptureFixture) -> None:
    spec = write_tiny(run)
    said = evaluate(run, people=path, detectors=["builtin", spec], **HOW)
    validate("evaluate", json.dumps(said))
    folder = run / "evaluation-people"
    assert said["out"] == str(folder) and said["people"] == said["photographs"] == 3 and said["left_out"] == {}
    assert said["white_box"] == {"builtin": True, spec: False} and said["unseen"] == {"photographs": True}
    rates = said["detectors"]["builtin"]
    assert {name for name, rate in rates.items() if "success" in rate} == CONTROLS
    assert rates["logo"]["n"] == 3 and sum(side["n"] for side in rates["logo"]["seen_from"].values()) == 3
    assert said["operating_points"].keys() == said["false_alarms"].keys() == {"builtin", spec}
    stored = read_evaluation(folder)
    assert len(stored.pictures["gallery"]) == 3 and stored.summary["inputs"]["detector_hashes"].keys() == {
        "builtin",
        spec,
    }
    text = make_report(run).read_text("utf-8")
    assert "not been evaluated" not in text and "On people in photographs" in text
    assert "unseen photographs" in text and "white box: builtin" in text and "black box: darknet tiny" in text
    assert text.count("data:image/jpeg") >= 2 * 3 + 5 and ">None<" not in text
    assert "On photographs: With the trained colours, darknet tiny (black box" in text  # it never saw this one
    # The same once more is not measured again; other colours are.
    caplog.clear()
    assert evaluate(run, people=load_people(path), detectors=["builtin", spec], **HOW) == said
    assert "nothing is measured again" in caplog.text
    caplog.clear()
    write_colors(run / "colors.npy", 1 - read_colors(run / "colors.npy"))
    again = evaluate(run, people=path, detectors=["builtin", spec], **HOW)
    assert "which this one replaces" in caplog.text
    assert again["detectors"]["builtin"]["logo"]["mean_score"] != rates["logo"]["mean_score"]


@pytest.mark.long
def test_other_colours_printers_and_snapshots_are_judged_on_people(run: Path, path: Path, tmp_path: Path) -> None:
    grey = np.full((len(read_colors(run / "colors.npy")), 3), 0.5, np.float32)
    write_colors(tmp_path / "plain.npy", grey)
    for step in (20, 10):
        RunFolder(run).write_snapshot(step, grey)
    own = evaluate(run, people=path, over_time=True, **HOW)["detectors"]["builtin"]["logo"]["mean_score"]
    rows = json.loads((run / "curve-people.json").read_text())["rows"]
    assert [row["step"] for row in rows] == [10, 20] and (run / "curve-people.png").exists()
    plain = evaluate(run, people=path, colors=tmp_path / "plain.npy", **HOW)
    assert plain["white_box"] == {"builtin": None} and plain["unseen"] == {"photographs": None}
    assert plain["out"] == str(run / "evaluation-people-plain")
    assert plain["detectors"]["builtin"]["logo"]["mean_score"] != own
    # A printer that knows grey alone.
    write_profile(tmp_path / "p.npz", Profile(np.full((2, 2, 2, 3), 0.5, np.float32)))
    printed = evaluate(run, people=path, profile=tmp_path / "p.npz", **HOW)
    assert printed["detectors"]["builtin"]["logo"]["mean_score"] == plain["detectors"]["builtin"]["logo"]["mean_score"]
    assert (run / "evaluation-people-printed").exists()
    cloth = evaluate(run, people=path, colors="zoo:transfer-people", **HOW)
    # Its record, of an earlier version, has no copies of the photographs by which parts of them are found again.
    assert cloth["unseen"] == {"photographs": None} and "parts of trained ones is not known" in cloth["warnings"][0]
    Image.new("RGB", (8, 8), (128, 128, 128)).save(tmp_path / "grey.png")
    worn = evaluate(run, people=path, colors=f"{tmp_path / 'grey.png'}@tile=0.5", **HOW)
    assert worn["detectors"]["builtin"]["logo"]["mean_score"] == pytest.approx(
        plain["detectors"]["builtin"]["logo"]["mean_score"], abs=0.02
    )


REFUSED = {
    "--controls: 'stripes': there are clothing, grey, random, resampled": {"controls": ("stripes",)},
    "without --scene and --cycles": {"scene": "sample:unseen"},
    "without --profile and --cycles": {"over_time": True, "profile": "p.npz"},
    "say how wide it is worn": {"colors": "{picture}"},
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_photographs_do_not_have_is_refused(run: Path, path: Path, words: str) -> None:
    picture = str(path.with_name("made0.png"))
    given = {
        key: value.format(picture=picture) if value == "{picture}" else value for key, value in REFUSED[words].items()
    }
    with pytest.raises(InputError, match=words):
        evaluate(run, people=path, **(HOW | given))
    assert not (run / "evaluation-people").exists()


def test_an_evaluation_of_an_earlier_version_is_replaced_and_not_believed(run: Path, path: Path) -> None:
    folder = run / "evaluation-people"
    folder.mkdir()
    (folder / "wear.json").write_text('{"white_box": {"builtin": false}, "unseen": {"photographs": true}}')
    assert "evaluate --people</span> again" in make_report(run).read_text("utf-8")
    evaluate(run, people=path, **HOW)
    assert not (folder / "wear.json").exists() and read_evaluation(folder).summary["white_box"] == {"builtin": True}
    worn = run / "worn"
    worn.mkdir()
    (worn / "wear.json").write_text('{"detectors": {}}')
    with pytest.raises(InputError, match="left alone"):  # what `cloak wear` wrote is no evaluation
        evaluate(run, people=path, out=worn, **HOW)


@pytest.mark.long
def test_a_run_on_photographs_is_trained_and_judged(tmp_path: Path) -> None:
    path = write_people(tmp_path / "people", 4)
    given = {"steps": 2, "batch": 2, "size": 64, "translation": 5}
    train(None, "shirt", [RedDetector()], "procedural:train:4", out=tmp_path / "run", people=f"{path}[0::2]", **given)
    judge = {"red": RedDetector()}
    unseen = evaluate(tmp_path / "run", people=f"{path}[1::2]", detectors=judge, **HOW)
    assert unseen["people"] == 2 and unseen["unseen"] == {"photographs": True} and unseen["white_box"] == {"red": True}
    seen = evaluate(tmp_path / "run", people=load_people(path), detectors=judge, out=tmp_path / "all", **HOW)
    assert seen["unseen"] == {"photographs": False} and seen["people"] == 4


def test_snapshots_of_a_cloth_are_judged_as_fine_as_the_cloth(path: Path, tmp_path: Path) -> None:
    # What was trained last is what the run wears, so the curve ends at the evaluation's own figures.
    how = {"steps": 2, "batch": 1, "samples": 1, "tv_weight": 0.0, "initial": "balls", "pattern": "tile"}
    how |= {"tile_cm": 25.0, "feature_cm": 0.5, "preview_every": 0, "snapshot_every": 1}
    run = train(None, people=path, logo="shirt+trousers", detectors=["builtin"], out=tmp_path / "run", **how).out
    said = evaluate(run, people=path, over_time=True, controls=("grey",), **HOW)
    rates, last = said["detectors"]["builtin"], said["over_time"][-1]["detectors"]["builtin"]
    assert last == {key: rates["logo"][key] for key in last}
    shown, config = run / "snapshots" / "step-00000002.png", json.loads((run / "config.json").read_text())
    worn, on_bodies = (open_run(run, config, None, bodies)[0] for bodies in (None, sample_bodies("unseen")))
    snapshot = snapshot_pattern(run, shown.with_suffix(".npy"), worn.cover)
    assert shown.read_bytes() == (run / "cloth.png").read_bytes()
    assert snapshot.identity == worn.identity == on_bodies.identity
    # An earlier version kept the faces' colours alone, which hide less than the cloth.
    shown.unlink()
    with pytest.raises(InputError, match=r"step-00000002\.png: no such file: .* earlier version"):
        evaluate(run, people=path, over_time=True, controls=("grey",), **HOW)


def test_the_zoo_copies_what_content_told(run: Path, path: Path, tmp_path: Path) -> None:
    config = json.loads((run / "config.json").read_text()) | trained_on(path)
    (run / "config.json").write_text(json.dumps(config))
    evaluate(
        run, "sample:unseen[0:1]", "procedural:test:2", angles="0", images_per_view=1, bare=1, size=128, resamples=100
    )
    evaluate(run, people=path, **HOW)
    record = write_entry(tmp_path, "mine", run, about="", licence="CC0-1.0")
    assert record["people"]["unseen"] == {"photographs": False} and record["people"]["white_box"] == {"builtin": True}
    assert record["people"]["detectors"]["builtin"].keys() == CONTROLS
    kept = json.loads(np.load(tmp_path / "mine.npz")["config"].tobytes())["people"]
    assert kept["pixels"] == config["people"]["pixels"] and not any("." in look for look in kept["looks"])
