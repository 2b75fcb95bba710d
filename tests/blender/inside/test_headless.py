"""`train.py` without a window, as users run it: exit codes and files, by the stub trainer."""

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from cloak import headless as script
from cloak.blender import colors, faces
from cloak.blender.mesh_arrays import topology
from conftest import ROOT, blender_command
from made import make_egg

SCRIPT = ROOT / "blender_addon" / "train.py"
RED = Path(__file__).with_name("red_detector.py")


def train(folder: Path, *arguments: object, python: object = None) -> subprocess.CompletedProcess:
    words = [*arguments, *(["--python", python] if python else [])]
    return subprocess.run(
        blender_command(SCRIPT, *words), cwd=folder, capture_output=True, text=True, timeout=300, check=False
    )


@pytest.fixture
def train_here(monkeypatch, capfd):
    """Return `train`, but in this process, which spares each a start of Blender; its preview is a coarse one."""
    monkeypatch.setattr(script, "PREVIEW_SAMPLES", 1)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def run(folder: Path, *arguments: object, python: object) -> subprocess.CompletedProcess:
        monkeypatch.chdir(folder)
        words = [*map(str, arguments), "--python", str(python)]
        return subprocess.CompletedProcess(words, script.run(words), *capfd.readouterr())

    yield run
    for number, handler in handlers.items():
        signal.signal(number, handler)


def save_body(folder: Path, ids, name: str = "chest") -> Path:
    obj = make_egg()
    faces.new_logo(obj, name, np.isin(np.arange(len(obj.data.polygons)), ids))
    path = folder / "körper 1.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def reds(obj) -> np.ndarray:
    return (np.abs(colors.written_colors(obj) - [1, 0, 0]) < 1 / 255).all(1)


def test_from_blend_to_blend(tmp_path, stub, train_here):
    blend = save_body(tmp_path, [4, 5, 6])
    frames = ("--frames", "1:60:10", "--angles", "-10:10:5", "--steps", 3, "--detector", "builtin")
    done = train(
        tmp_path, "--blend", blend, "--logo", "chest", *frames, "--out", "RUN", "--save", "cloaked.blend", python=stub
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "exported 6 poses" in done.stdout and "Training done: 3/3" in done.stdout
    assert (tmp_path / "RUN" / "blender.png").read_bytes().startswith(b"\x89PNG")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "cloaked.blend"))
    obj = bpy.data.objects["Body"]
    assert np.flatnonzero(reds(obj)).tolist() == [4, 5, 6]
    assert obj.cloak.run == "//RUN"  # the panel goes on from here
    again = train_here(tmp_path, "--blend", blend, "--logo", "chest", "--out", "RUN", python=stub)
    assert again.returncode == 2 and "exists already (continue it with --resume" in again.stderr


def refused(done: subprocess.CompletedProcess) -> list[str]:
    """What `train.py` says on standard error where it ends with code 2."""
    assert done.returncode == 2 and "Traceback" not in done.stderr, done
    return [line for line in done.stderr.splitlines() if line.startswith("cloak: ")]


def test_bad_input_is_one_line_and_code_2(tmp_path, stub, monkeypatch, train_here):
    blend = save_body(tmp_path, [4, 5, 6])
    (tmp_path / "junk.blend").write_bytes(b"no blend at all")
    some = ("--blend", blend, "--out", "RUN")
    for words, message in (
        ((*some,), "required: --logo"),
        ((*some, "--logo", "x", "--nonsense"), "unrecognized arguments: --nonsense"),
        ((*some, "--logo", "hat"), "'Body' has no logo 'hat' (it has: chest)"),
        ((*some, "--logo", "chest", "--object", "Ghost"), "--object Ghost: no such object in the scene (meshes: Body)"),
        ((*some, "--logo", "chest", "--frames", "one"), "--frames one: A:B:STEP"),
        ((*some, "--logo", "chest", "--subdivide", "-1"), "--subdivide -1: 0 levels or more"),
        ((*some, "--logo", "chest", "--resume"), "--out RUN: no run to resume there"),
        ((*some, "--logo", "chest", "--save", "."), "--save"),
        (("--blend", "junk.blend", "--out", "RUN", "--logo", "chest"), "--blend junk.blend: not a file that Blender"),
        ((*some, "--logo", "chest", "--save", "no/where.blend"), "where.blend: the folder"),
        (("--blend", "none.blend", "--out", "RUN", "--logo", "chest"), "--blend none.blend: no such file"),
        ((*some, "--logo", "missing.npy"), "missing.npy: no such file"),
    ):
        (line,) = refused(train_here(tmp_path, *words, python=stub))
        assert message in line and not list(tmp_path.glob("RUN*"))
    nowhere = train_here(tmp_path, *some, "--logo", "chest", python="/nowhere/python")
    assert "'/nowhere/python' cannot be run" in refused(nowhere)[-1]
    monkeypatch.setenv("CLOAK_STUB", "refuse")
    (line,) = refused(train_here(tmp_path, *some, "--logo", "chest", python=stub))
    assert "cloak: --detector builtin: no such thing here" in line
    monkeypatch.setenv("CLOAK_STUB", "crash")
    done = train_here(tmp_path, *some, "--logo", "chest", python=stub)  # the failed start before is not in its way
    assert done.returncode == 1 and "a defect" in done.stderr


def test_a_trainer_that_does_nothing_and_a_closed_output_have_their_codes(tmp_path, stub, train_here):
    blend = save_body(tmp_path, [4, 5, 6])
    idle = tmp_path / "idle"
    idle.write_text("#!/bin/sh\nexit 0\n")
    idle.chmod(0o755)
    done = train_here(tmp_path, "--blend", blend, "--logo", "chest", "--out", "A", python=idle)
    assert done.returncode == 1 and "the trainer ended and left no colours in" in done.stderr
    command = blender_command(SCRIPT, "--blend", blend, "--logo", "chest", "--out", "B", "--python", stub)
    closed = subprocess.run(["sh", "-c", 'exec "$@" >&-', "sh", *command], cwd=tmp_path, timeout=300, check=False)
    assert closed.returncode in (0, 1)


@pytest.mark.parametrize("out", ["/proc/nowhere/RUN", "file.txt/RUN", "/proc/RUN"])
def test_a_place_that_cannot_be_written_is_one_line_and_code_2(tmp_path, stub, out, train_here):
    (tmp_path / "file.txt").touch()
    words = ("--blend", save_body(tmp_path, [4]), "--logo", "chest", "--out", out)
    (line,) = refused(train_here(tmp_path, *words, python=stub))
    assert out.split("/")[-2] in line


def test_stopped_is_code_3_and_resume_finishes(tmp_path, stub, monkeypatch, train_here):
    blend = save_body(tmp_path, [4, 5, 6])
    words = ["--blend", str(blend), "--logo", "chest", "--out", "RUN", "--steps", "40"]
    monkeypatch.setenv("CLOAK_STUB", "slow")
    command = blender_command(SCRIPT, *words, "--python", stub)
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE)
    until = time.monotonic() + 250
    while not (tmp_path / "RUN" / "step.txt").exists() and time.monotonic() < until:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGINT)
    _, stderr = process.communicate(timeout=120)
    assert process.returncode == 3 and b"Resume goes on from there" in stderr
    monkeypatch.setenv("CLOAK_STUB", "")
    words[words.index("40")] = "50"
    done = train_here(tmp_path, *words, "--resume", "--save", "cloaked.blend", python=stub)
    assert "--resume keeps what the run was started with: steps 40 (not 50)" in done.stdout
    assert done.returncode == 0 and (tmp_path / "cloaked.blend").exists(), done.stderr


def test_resume_runs_code_of_the_folder_only_where_it_is_named(tmp_path, stub, monkeypatch, train_here):
    words = ["--blend", save_body(tmp_path, [4]), "--logo", "chest", "--out", "RUN", "--steps", "3"]
    monkeypatch.setenv("CLOAK_STUB", "crash")
    assert train_here(tmp_path, *words, python=stub).returncode == 1
    (tmp_path / "RUN").mkdir(exist_ok=True)
    path, evil = tmp_path / "RUN.input" / "command.json", f"python:{tmp_path / 'evil.py'}:load"
    record = json.loads(path.read_text())
    path.write_text(json.dumps(record | {"options": ["--detector=python:{project}/evil.py:load"], "project": ".."}))
    monkeypatch.setenv("CLOAK_STUB", "")
    (line,) = refused(train_here(tmp_path, *words, "--resume", python=stub))
    assert f"{evil} runs code, and waits for your yes" in line
    done = train_here(tmp_path, *words, "--resume", "--detector", evil, python=stub)
    assert done.returncode == 0, done.stderr


def test_a_face_list_a_sample_body_and_several_logos(tmp_path, stub, train_here):
    done = train_here(
        tmp_path, "--sample", "--logo", "chest", "--out", "A", "--steps", 2, "--frames", "1:2:1", python=stub
    )
    assert done.returncode == 0 and "exported 2 poses, 4 faces" in done.stdout, done.stderr
    remembered = json.loads((tmp_path / "A.input" / "command.json").read_text())["options"]
    assert remembered[-1] == "--made-from=sample:train"
    save_body(tmp_path, [4, 5, 6])
    obj = bpy.data.objects["Body"]
    faces.new_logo(obj, "back", np.isin(np.arange(len(obj.data.polygons)), [9]))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "two.blend"))
    done = train_here(
        tmp_path, "--blend", "two.blend", "--logo", "chest + back", "--out", "B", "--steps", 2, python=stub
    )
    assert done.returncode == 0 and np.load(tmp_path / "B" / "logo.npy").tolist() == [4, 5, 6, 9], done.stderr
    from cloak.exchange.face_lists import write_face_list

    write_face_list(tmp_path / "list.npy", np.array([7, 8]), topology(bpy.data.objects["Body"]))
    done = train_here(tmp_path, "--blend", "two.blend", "--logo", "list.npy", "--out", "C", "--steps", 2, python=stub)
    assert done.returncode == 0 and np.load(tmp_path / "C" / "logo.npy").tolist() == [7, 8], done.stderr
