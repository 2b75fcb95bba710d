"""What is uploaded: the wheel works alone, in an environment outside the checkout; the sources hold the project."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.shared_folders import fill_once

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
TRACES = shutil.ignore_patterns(".*_cache", "__pycache__", "*.egg-info")
AT_TOP = shutil.ignore_patterns(".git", ".venv*", "runs", "build", "dist", "site")


OUTSIDE = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "NUMBA_CACHE_DIR")}
"""Of a process that does not see the checkout: pip takes an egg-info on the path for an installed package."""


def run(*command: object, **options: object) -> subprocess.CompletedProcess:
    """What it printed; a command that fails shows what it said."""
    options = {"env": OUTSIDE} | options
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def left(folder: str, names: list[str]) -> set[str]:
    """What a copy of the checkout leaves out."""
    return TRACES(folder, names) | (AT_TOP(folder, names) if Path(folder) == ROOT else set())


def build(folder: Path) -> None:
    shutil.copytree(ROOT, folder / "sources", symlinks=True, ignore=left)
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder / "dist", folder / "sources")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sdist, and the wheel that was built of the sdist."""
    return fill_once(tmp_path_factory, "packaging", build) / "dist"


@pytest.fixture(scope="module")
def python(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Python of an environment with the wheel; the packages that it needs are lent by this one, the checkout is not."""
    (wheel,) = built.glob("*.whl")
    return fill_once(tmp_path_factory, "environment", lambda folder: install(wheel, folder)) / "bin" / "python"


def install(wheel: Path, folder: Path) -> None:
    run(sys.executable, "-m", "venv", "--without-pip", folder)
    python = folder / "bin" / "python"
    run(sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps", "--no-index", wheel)
    place = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").stdout.strip())
    # A path in a .pth adds the folder, not the .pth files in it: an editable installation there stays unseen.
    (place / "lent.pth").write_text(sysconfig.get_path("purelib") + "\n", "utf-8")


def test_one_version_everywhere() -> None:
    version = re.search(r'^__version__ = "(.+)"', (ROOT / "cloak_core" / "__init__.py").read_text("utf-8"), re.M)[1]
    assert tomllib.loads((ROOT / "blender_manifest.toml").read_text("utf-8"))["version"] == version
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text("utf-8")
    assert f"\n## {version}\n" in (ROOT / "CHANGELOG.md").read_text("utf-8")


def test_the_readme_of_the_package_index_has_no_link_that_leads_nowhere() -> None:
    readme, url = (ROOT / "README.md").read_text("utf-8"), "https://forge.example/cloak"
    spec = importlib.util.spec_from_file_location("cloak_setup", ROOT / "setup.py")
    setup = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(setup)
    linked, bare = setup.index_readme(readme, url), setup.index_readme(readme, None)
    assert f"({url}/blob/HEAD/docs/install.md)" in linked and f"({url}/raw/HEAD/docs/images/cloak.png)" in linked
    for text in (linked, bare):
        assert all(target.startswith("https://") for target in re.findall(r"\]\(([^)]+)\)", text))
    assert "![" not in bare and "[Learning Transferable" in bare


@pytest.mark.long
def test_both_files_are_fit_to_be_uploaded(built: Path) -> None:
    said = run(sys.executable, "-m", "twine", "check", "--strict", *built.iterdir()).stdout
    assert said.count("PASSED") == 2


@pytest.mark.long
def test_the_wheel_holds_every_file_of_the_packages_and_nothing_else(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    packages = [ROOT / "cloak_core", ROOT / "blender_addon"]
    there = {
        (Path(folder) / name).relative_to(ROOT).as_posix()
        for package in packages
        for folder, _, files in os.walk(package, followlinks=True)
        for name in files
        if Path(folder).name != "__pycache__"
    }
    assert names == there


@pytest.mark.long
def test_the_sources_hold_the_tests_the_documents_and_the_tools(built: Path) -> None:
    (sources,) = built.glob("*.tar.gz")
    with tarfile.open(sources) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    for wanted in ("CHANGELOG.md", "CITATION.cff", "LICENSES/Apache-2.0.txt", "Makefile", "blender_manifest.toml"):
        assert wanted in names
    for folder in ("docs", "examples", "tests", "tools", "records"):
        there = {p.relative_to(ROOT).as_posix() for p in (ROOT / folder).rglob("*") if p.is_file()}
        assert {name for name in there if "__pycache__" not in name} <= names
    assert not [name for name in names if name.endswith(".pyc")]


@pytest.mark.long
def test_the_wheel_does_the_main_job_and_says_once_that_it_compiles(python: Path, tmp_path: Path) -> None:
    """In an empty folder; loops are compiled by the first command that draws, and kept."""
    environment = OUTSIDE | {"CLOAK_CACHE": "off", "OMP_NUM_THREADS": "1"}

    def cloak(line: str) -> subprocess.CompletedProcess:
        return run(python.with_name("cloak"), *line.split(), cwd=tmp_path, env=environment)

    place = run(python, "-c", "import cloak_core; print(cloak_core.__file__)", cwd=tmp_path, env=environment).stdout
    assert Path(place.strip()).is_relative_to(python.parents[1])
    assert json.loads(cloak("zoo list --json").stdout)["zoo"]
    assert "Measure" in cloak("--help").stdout
    cloak("logo select --scene sample --region chest+thighs --out chest.npy")
    small = "--size 96 --samples 1 --threads 1"
    trained = cloak(
        "train --scene sample:train[0:2] --logo chest.npy --detector builtin --backgrounds procedural:train:4 "
        f"--angles 0 --steps 2 --batch 2 --translation 4 {small} --out run"
    )
    assert trained.stderr.count("compiling the loops that draw, once after installation") == 1
    judged = cloak(
        "evaluate run --scene sample:unseen[0] --backgrounds procedural:test:2 --angles 0 --images-per-view 1 --bare 1 "
        f"--shift 4 --resamples 100 {small} --json"
    )
    assert json.loads(judged.stdout)["detectors"]["builtin"]["logo"]["n"] == 1
    cloak("report run")
    assert (tmp_path / "run" / "report.html").stat().st_size > 10_000


@pytest.mark.long
def test_the_wheel_knows_its_extras_and_brings_the_scripts_for_blender(python: Path) -> None:
    asked = "from importlib.metadata import metadata; print(*metadata('cloak-core').get_all('Provides-Extra'))"
    assert set(run(python, "-c", asked).stdout.split()) == set(PROJECT["optional-dependencies"])
    asked = "from cloak_core.sources.bodies.blender.outside import ROOT; print(ROOT / 'blender_addon' / 'train.py')"
    script = Path(run(python, "-c", asked, env={"PATH": os.environ["PATH"]}, cwd="/").stdout.strip())
    assert script.is_relative_to(python.parents[1])
    blender = ROOT / ".venv-blender" / "bin" / "python"
    assert blender.exists(), "no Python with bpy: run tools/setup_blender.sh"
    asked = [blender, script, "--", "--logo", "chest", "--out", "run", "--hat"]
    refused = subprocess.run(asked, capture_output=True, text=True, timeout=300, check=False)
    assert refused.returncode == 2 and "cloak: unrecognized arguments: --hat" in refused.stderr


def packages(folder: Path, **versions: str) -> Path:
    for name, version in versions.items():
        (folder / f"{name}-{version}.dist-info").mkdir(parents=True)
        metadata = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
        (folder / f"{name}-{version}.dist-info" / "METADATA").write_text(metadata)
    return folder


@pytest.mark.parametrize(
    ("versions", "found"),
    [
        ({"torch": "2.15.0+cpu", "torchvision": "0.30"}, True),
        ({"torch": "3.0", "torchvision": "1.0"}, True),
        ({"torch": "2.9.1", "torchvision": "0.24"}, False),
        ({"torch": "2.15.0"}, False),
        ({}, False),
    ],
)
def test_setting_up_takes_a_torch_that_is_there(versions: dict[str, str], found: bool, tmp_path: Path) -> None:
    folder = packages(tmp_path, **versions)
    command = [sys.executable, "-S", str(ROOT / "tools" / "find_torch.py")]
    done = subprocess.run(command, env={"PYTHONPATH": str(folder)}, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == ((0, str(folder)) if found else (1, "")), done.stderr
