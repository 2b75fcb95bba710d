"""Nothing that a .blend or a run's folder names runs code or asks the network before this user says yes."""

import json
from pathlib import Path

import bpy
import pytest
from cloak.files.errors import InputError
from cloak.session import session
from cloak.trainer import program
from cloak.training import runs
from conftest import run_job
from test_runs import cancelled_run, choose

NAMED = ("python:{evil}:load", "jpeg=75:python:{evil}:load", "transformers:evil/model", "onnx:\\\\host\\share\\a.onnx")


@pytest.fixture
def evil(tmp_path: Path) -> Path:
    path = tmp_path / "evil.py"
    path.write_text("load = 1\n")
    return path


def from_file(spec: str) -> None:
    """A scene's detector, as a .blend that is opened brings it."""
    bpy.context.scene.cloak.detectors.add().spec = spec
    session.allowed.clear()


def starts(operator: str) -> bool:
    """Press a button: whether a job came of it."""
    before = list(session.jobs)
    try:
        getattr(bpy.ops.cloak, operator)()
    except RuntimeError as error:
        assert "waits for your yes" in str(error), error
    return session.jobs != before


@pytest.mark.parametrize("spec", NAMED)
@pytest.mark.parametrize("operator", ["train_start", "detector_check", "heatmap", "try_it"])
def test_detectors_of_a_file_wait_for_a_yes(ready, evil, tmp_path, operator, spec):
    from_file(spec.format(evil=evil))
    assert not starts(operator) and not list(tmp_path.rglob("*.input"))
    program.allow([spec.format(evil=evil)])
    assert starts(operator)


@pytest.mark.parametrize("operator", ["render_check", "evaluate", "eye", "turntable"])
def test_so_do_judges(ready, evil, operator):
    bpy.ops.cloak.train_start()
    run_job()
    from_file(f"python:{evil}:load")
    assert not starts(operator) and session.eye is None


def test_a_yes_is_for_this_code(ready, evil):
    from_file(f"python:{evil}:load")
    bpy.context.scene.cloak.detectors[0].options = "640"
    bpy.ops.cloak.allow(specs=f"python:{evil}:load@640", then="CLOAK_OT_detector_check")
    assert session.job.label == "Detector check"
    bpy.context.scene.cloak.detectors[0].threshold = 0.4
    program.require([f"--detector={bpy.context.scene.cloak.detectors[0].full}"])
    evil.write_text("load = 2\n")
    with pytest.raises(program.Unasked, match="runs code, and waits for your yes"):
        program.require([f"--detector=python:{evil}:load"])


def test_what_the_user_chooses_is_named_by_the_user(ready, evil):
    bpy.ops.cloak.detector_add(directory=str(evil.parent), files=[{"name": evil.name}])
    bpy.ops.cloak.detector_add_named(spec="transformers:some/model")
    assert starts("train_start")


@pytest.mark.parametrize(
    "word", ["--query-prior=builtin", "--people=/etc/passwd", "--out=/tmp/x", "x", "--detector", ""]
)
def test_options_of_a_folder_are_known_by_name(ready, monkeypatch, word):
    run = cancelled_run(ready, monkeypatch)
    path = runs.input_folder(run) / runs.COMMAND
    record = json.loads(path.read_text())
    path.write_text(json.dumps(record | {"options": [*record["options"], word]}))
    with pytest.raises(InputError, match="is no option of a run"):
        runs.remembered_options(run)
    choose(run.name)
    assert not bpy.ops.cloak.train_resume.poll()
    path.write_text(json.dumps(record | {"options": [*record["options"], "--made-from", "sample:train"]}))
    assert runs.remembered_options(run)[-1] == "--made-from=sample:train"


def test_a_name_is_no_option(ready):
    from_file("--events=x")
    with pytest.raises(RuntimeError, match="is an option, not a detector"):
        bpy.ops.cloak.detector_check()


def test_every_string_of_a_command_may_be_evil(ready, evil, monkeypatch):
    run = cancelled_run(ready, monkeypatch)
    path = runs.input_folder(run) / runs.COMMAND
    record = json.loads(path.read_text())
    started = []
    monkeypatch.setattr("cloak.trainer.jobs.TrainingJob.start", lambda job: started.append(job))
    for spec in (f"python:{evil}:load", "transformers:evil/model", "https://evil.example/a.onnx", "../outside"):
        for k, word in enumerate(record["options"]):
            for put in (spec, f"{word.partition('=')[0]}={spec}"):
                changed = [*record["options"][:k], put, *record["options"][k + 1 :]]
                path.write_text(json.dumps(record | {"options": changed}))
                choose(run.name)
                if bpy.ops.cloak.train_resume.poll() and spec != "../outside":
                    assert not starts("train_resume"), put
    assert not started


@pytest.fixture(autouse=True)
def forgotten():
    session.allowed.clear()
    yield
    session.allowed.clear()
