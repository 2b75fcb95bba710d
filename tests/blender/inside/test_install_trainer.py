"""Installing the trainer: real environments and real pip, a tiny wheel instead of the trainer, no network."""

import os
import re
import sys
import tomllib
import zipfile
from pathlib import Path

import bpy
import pytest
from cloak.files.errors import InputError
from cloak.session import session
from cloak.trainer import install as trainer_install
from cloak.trainer import jobs
from cloak.trainer import operators as install
from cloak.trainer.operators import trainer_folder
from cloak.trainer.preferences import preferences, trainer_reason
from conftest import EXTENSION, ROOT, STUB, make_launcher, run_job, wait_for


def make_wheel(folder: Path, *needs: str, torch: str = "") -> Path:
    """A wheel with the stub trainer and the stub torch in it."""
    path = folder / "cloak_core-0.1-py3-none-any.whl"
    about = "cloak_core-0.1.dist-info"
    files = {name: (STUB / name).read_text() for name in ("cloak_core/__init__.py", "torch/__init__.py")}
    files |= {"numpy/__init__.py": "", "torch/__init__.py": torch or files["torch/__init__.py"]}
    files[f"{about}/METADATA"] = "\n".join(
        ["Metadata-Version: 2.1", "Name: cloak-core", "Version: 0.1", *(f"Requires-Dist: {need}" for need in needs)]
    )
    files[f"{about}/WHEEL"] = "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    files[f"{about}/RECORD"] = "".join(f"{name},,\n" for name in (*files, f"{about}/RECORD"))
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return path


@pytest.fixture
def wheel(tmp_path, monkeypatch) -> Path:
    """Chosen in the preferences; pip asks no index, Blender may go online, nothing is installed before or after."""
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    for name in ("PIP_INDEX_URL", "PIP_EXTRA_INDEX_URL", "PIP_FIND_LINKS"):
        monkeypatch.delenv(name, raising=False)
    bpy.context.preferences.system.use_online_access = True
    path = make_wheel(tmp_path)
    kept = preferences()
    kept.source, kept.python, kept.answer = str(path), "", ""
    yield path
    trainer_install.sweep(trainer_folder(), None).join()
    kept.source, kept.python, kept.answer = "", "", ""


def left() -> list[str]:
    """Environments in the add-on's folder."""
    return sorted(place.name for place in trainer_folder().iterdir() if place.is_dir())


def wait_until_swept(*names: str) -> None:
    wait_for(lambda: left() == sorted(names))


def test_the_trainer_is_installed_tested_and_chosen(wheel):
    bpy.ops.cloak.install_trainer(python=sys.executable)
    assert jobs.busy() == "Installation is running: wait for it, or cancel it"
    job = run_job()
    assert job.state == "done", job.message
    assert re.match(r"Cloak 0.stub, torch 0.stub, Python 3\.\d+\.\d+, CPU", job.message)
    assert preferences().answer == job.message
    assert Path(preferences().python) == trainer_folder() / "1" / "bin" / "python"
    wait_for(lambda: trainer_reason() is not None)
    assert trainer_reason() == "" and bpy.context.preferences.is_dirty
    bpy.ops.cloak.show_install_log()
    assert "Successfully installed cloak-core-0.1" in bpy.data.texts["Cloak installation"].as_string()
    # The one that works stays until the next one does.
    wheel.write_bytes(b"no wheel")
    bpy.ops.cloak.install_trainer(python=sys.executable)
    assert run_job().state == "failed"
    wait_until_swept("1")
    assert Path(preferences().python).is_file()
    make_wheel(wheel.parent)
    bpy.ops.cloak.install_trainer(python=sys.executable)
    assert run_job().state == "done"
    assert Path(preferences().python).parts[-3] == "2"
    wait_until_swept("2")


def test_cancelling_leaves_nothing(wheel):
    bpy.ops.cloak.install_trainer(python=sys.executable)
    wait_for(lambda: left() == ["1"])
    group = session.job._process.pid
    bpy.ops.cloak.train_cancel()
    job = run_job()
    assert (job.state, job.message) == ("stopped", "Installation cancelled: nothing of it is left")
    wait_until_swept()
    with pytest.raises(ProcessLookupError):  # nor a child of venv or pip
        os.killpg(group, 0)
    assert not preferences().python


def test_an_index_that_does_not_answer_is_named(wheel, monkeypatch):
    monkeypatch.delenv("PIP_NO_INDEX")
    monkeypatch.setenv("PIP_RETRIES", "1")
    monkeypatch.setenv("PIP_INDEX_URL", "http://127.0.0.1:9/simple")
    make_wheel(wheel.parent, "no-such-thing")
    bpy.ops.cloak.install_trainer(python=sys.executable)
    job = run_job()
    assert job.state == "failed" and "The package index cannot be reached" in job.message
    assert job.message == preferences().answer and str(trainer_folder()) in job.message
    wait_until_swept()


def test_a_package_that_the_index_lacks_is_named(wheel):
    make_wheel(wheel.parent, "no-such-thing")
    bpy.ops.cloak.install_trainer(python=sys.executable)
    assert "The package index has no suitable no-such-thing" in run_job().message


def test_a_trainer_that_does_not_start_is_not_chosen(wheel):
    make_wheel(wheel.parent, torch="raise ImportError('no libtorch.so')")
    bpy.ops.cloak.install_trainer(python=sys.executable)
    job = run_job()
    assert job.state == "failed" and "no libtorch.so" in job.message and not preferences().python


def test_a_python_without_pip_is_refused_at_once(wheel, tmp_path):
    (tmp_path / "bare").mkdir()
    (tmp_path / "bare" / "venv.py").write_text("raise ModuleNotFoundError(\"No module named 'venv'\")")
    bare = make_launcher(tmp_path / "base", [tmp_path / "bare"])
    with pytest.raises(RuntimeError, match="has neither venv nor pip: install them"):
        bpy.ops.cloak.install_trainer(python=str(bare))
    with pytest.raises(RuntimeError, match="cannot be run"):
        bpy.ops.cloak.install_trainer(python="/nowhere/python")
    assert not left()


def test_no_room_and_no_permission_are_said_before_anything_is_written(wheel, monkeypatch):
    monkeypatch.setattr(trainer_install, "GIGABYTES", 1e9)
    with pytest.raises(RuntimeError, match=r"takes about 1000000000.0 GB, but only .* GB are free there"):
        bpy.ops.cloak.install_trainer(python=sys.executable, share_torch=False)
    monkeypatch.setattr(install, "trainer_folder", lambda: Path("/nowhere/at/all"))
    with pytest.raises(RuntimeError, match="/nowhere/at/all: No such file"):
        bpy.ops.cloak.install_trainer(python=sys.executable)
    monkeypatch.undo()
    assert not left()
    for said, words in (
        ("ERROR: Could not install packages due to an OSError: [Errno 28] No space left on device", "disk is full"),
        ("Error: [Errno 13] Permission denied: '/x/bin'", "no permission"),
        ("ERROR: cloak_core-9-cp39-win.whl is not a supported wheel on this platform.", "another system"),
        ("Package 'cloak-core' requires a different Python: 3.9.1 not in '>=3.11'", "does not suit"),
    ):
        assert words in trainer_install.diagnosis(f"Collecting x\n{said}\n", "")
    assert trainer_install.diagnosis("gibberish", "exit code 1") == "exit code 1"


def test_offline_and_without_a_source_the_button_says_so(wheel):
    preferences().source = ""
    with pytest.raises(RuntimeError, match=r"poll\(\).*Choose what to install"):
        bpy.ops.cloak.install_trainer()
    preferences().source = str(wheel.parent)
    with pytest.raises(RuntimeError, match=r"poll\(\).*no pyproject.toml in it"):
        bpy.ops.cloak.install_trainer()
    bpy.context.preferences.system.use_online_access = False
    with pytest.raises(RuntimeError, match=r"poll\(\).*online access is off"):
        bpy.ops.cloak.install_trainer()


def test_the_wheel_that_came_with_the_add_on_is_taken_unless_another_is_chosen(wheel, tmp_path):
    """`make extension` puts it there."""
    assert trainer_install.find_source(str(wheel)) == wheel
    bundled = Path(trainer_install.__file__).parent
    try:
        own = make_wheel(bundled)
        assert trainer_install.find_source("") == own and trainer_install.find_source(str(wheel)) == wheel
    finally:
        for left in bundled.glob("*.whl"):
            left.unlink()


def test_a_torch_that_is_there_can_be_shared(wheel, tmp_path):
    """A Python with torch and torchvision: the new environment sees them, and no other Python's."""
    packages = tmp_path / "packages"
    for name, version in (("torch", "2.14.1+cpu"), ("torchvision", "0.29")):
        (packages / f"{name}-{version}.dist-info").mkdir(parents=True)
        (packages / f"{name}-{version}.dist-info" / "METADATA").write_text(f"Name: {name}\nVersion: {version}\n")
    rich = tmp_path / "rich"  # that has them only when it is asked, not when it runs pip
    rich.write_text(f'#!/bin/sh\n[ "$1" = -c ] && export PYTHONPATH="{packages}"\nexec "{sys.executable}" "$@"\n')
    rich.chmod(0o755)
    base = trainer_install.find_base(str(rich))
    assert (base.torch, base.torch_folder) == ("2.14.1+cpu", str(packages))
    assert trainer_install.gigabytes(base, True) < 1 < 5 < trainer_install.gigabytes(base, False)
    make_wheel(wheel.parent, "torch>=2.14", "torchvision")
    bpy.ops.cloak.install_trainer(python=str(rich), share_torch=True)
    job = run_job()
    assert job.state == "done" and "torch 0.stub" in job.message  # pip asked for no torch of its own
    bpy.ops.cloak.install_trainer(python=str(rich), share_torch=False)
    assert "The package index has no suitable torch" in run_job().message


def test_a_torch_that_is_too_old_is_not_offered(wheel, tmp_path):
    for name, version in (("torch", "2.9.1"), ("torchvision", "0.24")):
        (tmp_path / f"{name}-{version}.dist-info").mkdir()
        (tmp_path / f"{name}-{version}.dist-info" / "METADATA").write_text(f"Name: {name}\nVersion: {version}\n")
    assert not trainer_install.find_base(str(make_launcher(tmp_path / "old", [tmp_path]))).torch
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = {line.split(">=")[0]: line.partition(">=")[2] for line in project["dependencies"]}
    assert tuple(map(int, needed["torch"].split("."))) == trainer_install.TORCH_NEEDED
    assert project["requires-python"] == ">=" + ".".join(map(str, trainer_install.PYTHON_NEEDED))


def test_a_slow_python_keeps_nobody_waiting_for_the_question(wheel, tmp_path):
    slow = tmp_path / "slow"
    slow.write_text("#!/bin/sh\nsleep 2\nexit 1\n")
    slow.chmod(0o755)
    with pytest.raises(InputError, match="Still looking for a Python"):
        install._base(str(slow), 0.1)


def test_the_manifest_says_why_it_wants_the_network():
    with zipfile.ZipFile(EXTENSION) as archive:
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
    assert "pip" in manifest["permissions"]["network"]
