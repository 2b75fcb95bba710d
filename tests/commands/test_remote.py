"""`cloak remote`: the other machine is this one, behind a prefix that runs a line of shell, as ssh does."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from cloak_core import cli
from cloak_core.commands.remote import Machine, files_of, named_paths
from cloak_core.exchange.face_lists import write_face_list
from cloak_core.exchange.scenes import read_scene
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.opening import load_scene

STUB = Path(__file__).parents[1] / "blender" / "inside" / "stub"


@pytest.fixture
def machine(tmp_path) -> list[str]:
    """Options of `cloak remote` for a machine that starts in another folder and has a trainer of its own."""
    home = tmp_path / "other machine"
    home.mkdir()
    ssh, program = tmp_path / "fake ssh", tmp_path / "stub python"
    ssh.write_text(f'#!/bin/sh\ncd "{home}"\nexec sh -c "$2"\n')  # its last word goes to a shell there
    program.write_text(f'#!/bin/sh\nPYTHONPATH="{STUB}" exec "{sys.executable}" "$@"\n')
    for script in (ssh, program):
        script.chmod(0o755)
    return [f"--machine='{ssh}' box", f"--folder={home / 'cloak'}", f"--program='{program}' -m cloak_core"]


@pytest.fixture
def logo(tmp_path) -> Path:
    """A face list in a folder whose name has what parts specs, beside a file that nobody named."""
    folder = tmp_path / "run=2:final"
    folder.mkdir()
    write_face_list(folder / "logo.npy", np.array([1, 2, 3]), "0" * 64)
    (folder / "secret.txt").write_text("not for others")
    return folder / "logo.npy"


def start(machine: list[str], *words: object, **environment: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "cloak_core", "remote", *machine, "--", *map(str, words)]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, env=os.environ | environment, **streams)


def arrived(machine: list[str]) -> list[str]:
    """The files over there, as they were called here."""
    folder = Path(machine[1].partition("=")[2])
    return sorted(path.name for path in folder.rglob("*") if path.is_file() and path.name != ".complete")


@pytest.mark.slow
def test_a_training_over_there_leaves_its_run_here_and_sends_only_what_was_named(machine, logo, tmp_path):
    detector = tmp_path / "net.py"
    (tmp_path / "real.py").write_text("def load(): ...")
    detector.symlink_to(tmp_path / "real.py")
    run = tmp_path / "run of mine"
    words = ("train", "--logo", logo, f"--detector=python:{detector}:load", "--out", run, "--steps", 3, "--json")
    process = start(machine, *words)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert json.loads(out)["out"] == str(run) and len(np.load(run / "colors.npy")) == 3
    sent = arrived(machine)
    assert "secret.txt" not in sent and "real.py" not in sent
    over_there = Path(machine[1].partition("=")[2])
    (net,) = over_there.rglob("net.py")
    assert net.read_text() == "def load(): ...", "a link is followed"
    assert sorted(path.name for path in over_there.glob("*/logo.npy*")) == ["logo.npy"]


@pytest.mark.slow
def test_a_training_is_cancelled_by_its_file(machine, logo, tmp_path):
    run = tmp_path / "run"
    words = ("train", "--logo", logo, "--detector", "builtin", "--out", run, "--steps", 400, "--json")
    process = start(machine, *words, CLOAK_STUB="slow")
    until = time.monotonic() + 100
    while not (run / "events.jsonl").exists() and process.poll() is None and time.monotonic() < until:
        time.sleep(0.1)
    (run / "cancel").touch()
    out, err = process.communicate(timeout=120)
    assert process.returncode == 3, err
    assert json.loads(out)["stopped"] and not (run / "cancel").exists()


@pytest.mark.slow
def test_what_cannot_be_is_said_in_one_line(machine, logo, tmp_path):
    train = ("train", "--logo", str(logo), "--out", str(tmp_path / "r"))
    for words, environment, message in (
        (train, {"CLOAK_OFFLINE": "1"}, "no network is allowed"),
        (("train", "--nonsense"), {}, "--nonsense"),
        ((), {}, "name a command after --"),
    ):
        process = start(machine, *words, **environment)
        _, err = process.communicate(timeout=60)
        assert process.returncode == 2 and message in err and "Traceback" not in err, err
    process = start(["--machine=false"], "zoo", "list")
    _, err = process.communicate(timeout=60)
    assert process.returncode == 255 and "cannot be reached" in err


@pytest.mark.slow
def test_a_launcher_stands_for_the_other_machine(machine, tmp_path):
    launcher = tmp_path / "cloak-box"
    done = subprocess.run(
        [sys.executable, "-m", "cloak_core", "remote", *machine, "--save", launcher], capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    done = subprocess.run(
        [launcher, "scene", "sample", "--out", tmp_path / "sample", "--json"], capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["out"] == str(tmp_path / "sample")
    assert read_scene(tmp_path / "sample").face_count == 4


def test_each_kind_of_option_is_known(tmp_path, logo, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a.cfg", "b.weights", "bodies.npz", "people.json", "coat.png", "x.xml", "x.bin", "palette.csv"):
        Path(name).touch()
    Path("photos").mkdir()
    words = ["train", "--logo", str(logo), "--detector", "darknet:a.cfg:b.weights@416", "--scene", "bodies.npz[0::2]"]
    words += ["--people", "people.json[1::2]", "--backgrounds", "photos", "--near", "coat.png", "--out", "run"]
    Path("best").touch()  # a preset, and the device, are no files, whatever lies there
    Path("cpu").touch()
    words += ["--preset", "best", "--device", "cpu"]
    read, written = named_paths(cli.parse(*cli.find(words)))
    assert read == {str(logo), "a.cfg", "b.weights", "bodies.npz", "people.json", "photos", "coat.png"}
    assert written == {"run"}
    assert sorted(files_of(Path("x.xml"))) == ["x.bin", "x.xml"]
    assert sorted(files_of(logo)) == ["logo.json", "logo.npy"]


def test_pictures_that_people_name_go_with_them(tmp_path):
    (tmp_path / "a.jpg").touch()
    record = {"images": [{"file_name": "a.jpg"}, {"file_name": "../outside.jpg"}, {"file_name": "missing.jpg"}]}
    (tmp_path / "people.json").write_text(json.dumps(record))
    assert sorted(files_of(tmp_path / "people.json")) == ["a.jpg", "people.json"]


def test_a_folder_is_sent_with_what_links_lead_to(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "1.jpg").touch()
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "more").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "photos" / "gone.jpg").symlink_to(tmp_path / "nowhere")
    assert sorted(files_of(tmp_path / "photos")) == ["photos/more/1.jpg"]
    assert load_scene("sample").face_count > 0


def test_what_the_other_machine_may_not_send_is_named(tmp_path: Path) -> None:
    run = tmp_path / "there" / "run"
    run.mkdir(parents=True)
    (run / "colors.npy").write_bytes(b"1")
    machine = Machine("sh -c", str(tmp_path / "there"))
    machine.fetch(str(run), tmp_path / "here")
    assert (tmp_path / "here" / "colors.npy").read_bytes() == b"1"
    (run / "config.json").symlink_to("/etc/hostname")
    with pytest.raises(InputError, match=r"sh -c: sent 'run/config\.json', which is no file or folder of run"):
        machine.fetch(str(run), tmp_path / "here")
