"""Records of others name detectors: whatever would run code is refused unless the caller names it."""

import json
import socket
from pathlib import Path

import pytest

import cloak_core
from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from cloak_core.files.specs import reach
from cloak_core.studies.sweeps import read_grid
from cloak_core.studies.zoo_reproduction import Files, evaluate_again
from cloak_core.zoo.entry import Entry, entry

CODE = """
from pathlib import Path
Path(__file__).with_name("ran").touch()
import torch
class Mine(torch.nn.Module):
    def forward(self, images):
        return images.new_zeros(len(images), 1, 4), images.mean((1, 2, 3))[:, None].clamp(0, 1)
make = Mine
"""


@pytest.fixture
def evil(tmp_path: Path) -> tuple[Path, str]:
    """A run folder from a stranger: its config.json names code that lies in it."""
    run = entry("builtin-sample").write_run(tmp_path / "got")
    (run / "evil.py").write_text(CODE)
    config = json.loads((run / "config.json").read_text())
    spec = f"python:{run / 'evil.py'}:make"
    config["detectors"][0]["spec"] = spec
    (run / "config.json").write_text(json.dumps(config))
    return run, spec


FEW = ("--most-images", "2", "--bare", "1", "--size", "64", "--shift", "0", "--angles", "0")
FEW += ("--scene", "sample:unseen[0:1]")


@pytest.mark.parametrize("before", ["", "jpeg=75:", "segment:blur=1:"])
@pytest.mark.parametrize(
    "words", [["evaluate", "RUN", *FEW], ["film", "RUN", "--out", "FILM"], ["evaluate", "RUN", "--people", "PEOPLE"]]
)
def test_a_run_folder_runs_no_code(evil, words: list[str], before: str, tmp_path: Path, cloak) -> None:
    run, spec = evil
    config = json.loads((run / "config.json").read_text())
    config["detectors"][0]["spec"] = before + spec
    (run / "config.json").write_text(json.dumps(config))
    places = {"RUN": str(run), "FILM": str(tmp_path / "film"), "PEOPLE": str(tmp_path / "people.json")}
    code, _, said = cloak(*(places.get(word, word) for word in words))
    assert code == 2 and f"--detector {before + spec}" in said.replace("\n", ""), said
    assert not (run / "ran").exists()


def test_nor_does_the_library(evil, tmp_path: Path) -> None:
    run, _ = evil
    for asked in (
        lambda: cloak_core.evaluate(run),
        lambda: cloak_core.film(run, tmp_path / "film"),
        lambda: cloak_core.evaluate(run, people=tmp_path / "people.json"),
    ):
        with pytest.raises(InputError, match="which runs code: only where you name it"):
            asked()
    assert not (run / "ran").exists()


def test_named_code_is_run(evil, cloak) -> None:
    run, spec = evil
    assert cloak("evaluate", run, "--detector", spec, *FEW)[0] == 0 and (run / "ran").exists()


def test_zoo_entries_and_grids_run_code_only_where_it_is_named(evil, tmp_path: Path) -> None:
    run, spec = evil
    shipped = entry("builtin-sample")
    judged = {"python:evil.py:make": next(iter(shipped.record["evaluation"]["detectors"].values()))}
    record = shipped.record | {"evaluation": shipped.record["evaluation"] | {"detectors": judged}}
    foreign = Entry(record, shipped.config, shipped.colors, shipped.ids)
    with pytest.raises(InputError, match=r"zoo:builtin-sample: names python:evil\.py:make, which runs code"):
        evaluate_again(foreign, Files(run), 2, "cpu", None)
    assert not (run / "ran").exists()

    grid = tmp_path / "grid.toml"
    grid.write_text(
        f"[base]\nscene = 'sample'\nlogo = 'chest'\n[grid]\nseed = [0, 1]\ndetector = ['builtin', ['jpeg=75:{spec}']]\n"
    )
    with pytest.raises(InputError, match=r"grid\.toml: names jpeg=75:python:"):
        read_grid(grid)
    assert len(read_grid(grid, named=[f"jpeg=75:{spec}"])) == 4


def test_a_run_whose_detector_is_not_here_says_how_to_name_it() -> None:
    with pytest.raises(InputError, match=r"trained against onnx:yolov8n\.onnx.* is not here: name your copy"):
        cloak_core.evaluate("zoo:yolov8n-anny", "sample:unseen[0:1]", "procedural:test:1")


@pytest.mark.parametrize(
    ("spec", "does"),
    [
        *((spec, "") for spec in ("builtin", "jpeg=75:builtin@224", "onnx:a.onnx", "darknet:a.cfg:b.weights")),
        *((spec, "") for spec in ("ultralytics:python.pt", "transformers:{here}", "blur=1:transformers:{here}@640")),
        *((spec, "runs code") for spec in ("python:C:\\a.py:load", "segment:blur=1:python:a.py:f@conf=0.5")),
        *((spec, "asks the network") for spec in ("transformers:some/model", "jpeg=75:transformers:{here}/none@640")),
        *((spec, "asks the network") for spec in ("onnx:\\\\host\\share\\a.onnx", "darknet:a.cfg://host/b.weights")),
    ],
)
def test_what_a_spec_does_beyond_reading_files(spec: str, does: str, tmp_path: Path) -> None:
    assert reach(spec.format(here=tmp_path)) == does


def test_a_model_s_name_in_a_run_asks_nobody(evil, monkeypatch) -> None:
    """Nor does a name of the user's, before --download."""
    asked: list = []
    refuse = lambda *words, **options: asked.append(words) or (_ for _ in ()).throw(OSError("no network"))
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    run, _ = evil
    config = json.loads((run / "config.json").read_text())
    config["detectors"][0]["spec"] = "transformers:some/model"
    (run / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match="which asks the network: only where you name it"):
        cloak_core.evaluate(run)
    with pytest.raises(InputError, match="not in the local cache"):
        load_detector("transformers:some/model")
    assert not asked
