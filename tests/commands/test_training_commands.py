"""`cloak train --log` and `--extend`, and `cloak sweep`, through the command line."""

import json
import sys
from pathlib import Path

import pytest

from cloak_core.core.logo import select_region
from cloak_core.exchange.face_lists import write_face_list
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.zoo.entry import run_path

QUICK = {"steps": 3, "batch": 2, "size": 64, "translation": 5, "samples": 1, "angles": "0", "threads": 1}


@pytest.fixture
def logo(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bodies = sample_bodies("train")
    write_face_list(tmp_path / "logo.npy", select_region(bodies, "chest"), bodies.topology)
    return "logo.npy"


def train(logo, *more):
    options = [word for key, value in QUICK.items() for word in (f"--{key}", value)]
    material = ["--scene", "sample:train[0:1]", "--backgrounds", "procedural:train:2", "--logo", logo]
    return ["train", *material, "--out", "run", *options, *more]


def scalars(folder):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    found = EventAccumulator(str(folder))
    found.Reload()
    names = found.Tags()
    return {name: [event.step for event in found.Scalars(name)] for name in names["scalars"]}, names["images"]


@pytest.mark.slow
def test_tensorboard_shows_the_events_and_hides_what_a_resumed_run_does_again(logo, tmp_path, cloak):
    pytest.importorskip("tensorboard")
    options = ["--log", "tensorboard", "--preview-every", 2, "--checkpoint-every", 1, "--json"]
    code, said, _ = cloak(*train(logo, *options, "--max-seconds", 1e-6))
    assert code == 3 and json.loads(said)["step"] == 1
    code, said, _ = cloak(*train(logo, *options, "--resume"))
    assert code == 0 and json.loads(said)["step"] == 3
    found, pictures = scalars(tmp_path / "run" / "tensorboard")
    assert found["training/loss"] == found["training/success"] == [1, 2, 3] and pictures == ["preview"]


class Client:
    """Stands for mlflow and wandb: notes what it is called with."""

    def __init__(self) -> None:
        self.calls = []

    def __getattr__(self, name: str):
        def call(*given, **named):
            self.calls.append((name, given, named))
            return self

        return call

    def of(self, name: str) -> list:
        return [(given, named) for called, given, named in self.calls if called == name]


@pytest.mark.slow
def test_mlflow_and_wandb_hear_settings_numbers_and_previews(logo, tmp_path, cloak, monkeypatch):
    mlflow, wandb = Client(), Client()
    monkeypatch.setitem(sys.modules, "mlflow", mlflow)
    monkeypatch.setitem(sys.modules, "wandb", wandb)
    code, _, said = cloak(*train(logo, "--log", "mlflow", "--log", "wandb", "--preview-every", 2))
    assert code == 0, said
    assert mlflow.of("start_run") == [((), {"run_name": "run"})] and len(mlflow.of("end_run")) == 1
    assert mlflow.of("log_params")[0][0][0]["steps"] == "3"
    assert [named["step"] for _, named in mlflow.of("log_metrics")] == [1, 2, 3]
    assert "training/loss" in mlflow.of("log_metrics")[0][0][0]
    assert Path(mlflow.of("log_artifact")[0][0][0]).is_file()
    assert wandb.of("init")[0][1]["config"]["steps"] == 3 and len(wandb.of("finish")) == 1
    assert [set(given[0]) == {"preview"} for given, _ in wandb.of("log")].count(True) == len(wandb.of("Image"))
    assert [named["step"] for given, named in wandb.of("log") if "training/loss" in given[0]] == [1, 2, 3]


@pytest.mark.parametrize("name", ["tensorboard", "mlflow", "wandb"])
def test_a_client_that_is_missing_is_one_line_with_the_command(logo, tmp_path, cloak, monkeypatch, name):
    for module in [n for n in sys.modules if n.startswith(("torch.utils.tensorboard", "tensorboard"))]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, name, None)
    code, _, said = cloak(*train(logo, "--log", name))
    assert code == 2 and said.count("\n") == 1 and f"pip install 'cloak-core[{name}]'" in said
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_complete_run_is_made_longer(logo, tmp_path, cloak):
    code, said, _ = cloak(*train(logo))
    assert code == 0 and "Next: cloak evaluate run" in said
    code, _, said = cloak(*train(logo, "--resume", "--steps", 5))
    assert code == 2 and "(--extend N makes a run longer)" in said
    code, said, err = cloak(*train(logo, "--extend", 2, "--json"))
    assert code == 0, err
    assert (json.loads(said)["step"], json.loads(said)["out"]) == (5, "run-5")
    steps = [json.loads(line) for line in (tmp_path / "run-5" / "events.jsonl").read_text().splitlines()]
    assert [event["step"] for event in steps if event["type"] == "step"] == [1, 2, 3, 4, 5]
    assert json.loads((tmp_path / "run" / "config.json").read_text())["settings"]["steps"] == 3, "the run stays"
    for more, words in (
        (["--extend", 0], "--extend 0: some updates"),
        (["--extend", 2, "--resume"], "--extend, --resume"),
    ):
        assert words in cloak(*train(logo, *more))[2]
    assert "absent: no run to extend" in cloak(*train(logo, "--out", "absent", "--extend", 2))[2]


@pytest.mark.slow
def test_sweep(logo, tmp_path, cloak):
    base = QUICK | {"scene": "sample:train[0:1]", "backgrounds": "procedural:train:2", "logo": logo}
    lines = [f"{key} = {json.dumps(value)}" for key, value in base.items()]
    (tmp_path / "grid.toml").write_text("\n".join(["[base]", *lines, "[grid]", "lr = [0.01, 0.1]"]))
    code, said, _ = cloak("sweep", "grid.toml", "--out", "out", "--json")
    record = json.loads(said)
    assert code == 0 and record["done"] == 2 and [r["varied"]["lr"] for r in record["results"]] == [0.01, 0.1]
    code, said, errors = cloak("sweep", "grid.toml", "--out", "out")
    assert "Next: cloak evaluate out  (its run" in said
    assert run_path("out").parent == Path("out/runs") and (run_path("out") / "config.json").is_file()
    assert code == 0 and "2 of 2 runs done" in said and "run 1" not in errors
    code, _, said = cloak("report", "out")
    assert code == 0 and (run_path("out") / "report.html").is_file(), said
    (tmp_path / "grid.toml").write_text("[base]\n[grid]\ncolour = [1]\n")
    code, _, said = cloak("sweep", "grid.toml", "--out", "other")
    assert code == 2 and said.count("\n") == 1 and "grid.toml" in said and not (tmp_path / "other").exists()


@pytest.mark.slow
def test_a_run_that_is_stopped_says_how_it_goes_on_and_an_empty_folder_is_taken(logo, tmp_path, cloak):
    (tmp_path / "run").mkdir()
    code, _, said = cloak(*train(logo, "--max-seconds", 1e-6))
    assert code == 3 and "stopped at step 1: time budget; the same command with --resume goes on" in said
