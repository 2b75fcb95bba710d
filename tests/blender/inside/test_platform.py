"""What reviewers of extensions.blender.org look for; docs/contributing/blender.md has the list in words."""

import ast
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import bpy
import pytest
from conftest import EXTENSION, ROOT

ADD_ON = ROOT / "blender_addon"
ROOMS = {
    file.relative_to(ADD_ON).as_posix(): file
    for file in ADD_ON.rglob("*.py")
    if not {"files", "exchange"} & set(file.parts) and file.name not in ("train.py", "cycles_frames.py")
}
SHARED = {
    f"{room}/{path.name}": path
    for room in ("files", "exchange")
    for path in (ROOT / "cloak_core" / room).glob("*.py")
    if path.name not in ("caching.py", "likeness.py", "torch_pickles.py", "unpickling.py", "pickle_machine.py")
}
LICENCE = b"# SPDX-License-Identifier: GPL-3.0-or-later"
NETWORK = {"socket", "urllib", "http", "requests", "ssl", "ftplib", "smtplib", "pip", "ensurepip", "venv"}
FOREIGN = {"torch", "torchvision", "cloak_core", "pickle", "ctypes"}


@pytest.fixture(scope="module")
def archive() -> zipfile.ZipFile:
    with zipfile.ZipFile(EXTENSION) as archive:
        yield archive


@pytest.fixture(scope="module")
def manifest(archive) -> dict:
    return tomllib.loads(archive.read("blender_manifest.toml").decode())


@pytest.fixture(scope="module")
def trees(archive) -> dict[str, ast.AST]:
    return {name: ast.parse(archive.read(name)) for name in archive.namelist() if name.endswith(".py")}


def blender_ext(*words: object) -> None:
    """Blender's own tool for extensions, which its preferences start as well."""
    scripts = Path(bpy.utils.system_resource("SCRIPTS"))
    (tool,) = scripts.glob("addons_core/bl_pkg/cli/blender_ext.py")
    done = subprocess.run([sys.executable, str(tool), *map(str, words)], capture_output=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_blenders_own_tool_finds_it_valid():
    blender_ext("validate", EXTENSION)


def test_it_is_installed_from_a_repository_of_our_own(tmp_path, archive):
    served, local = tmp_path / "served", tmp_path / "local"
    served.mkdir()
    shutil.copy(EXTENSION, served)
    blender_ext("server-generate", "--html", "--repo-dir", served)
    assert EXTENSION.name in (served / "index.html").read_text()
    remote = ("--remote-url", (served / "index.json").as_uri(), "--local-dir", local)
    versions = ("--blender-version", ".".join(map(str, bpy.app.version)))
    if bpy.app.version >= (4, 4, 0):
        versions += ("--python-version", ".".join(map(str, sys.version_info[:3])))
    local.mkdir()
    blender_ext("sync", *remote)
    blender_ext("install", *remote, *versions, "cloak")
    installed = {
        path.relative_to(local / "cloak").as_posix() for path in (local / "cloak").rglob("*") if path.is_file()
    }
    assert installed == {name for name in archive.namelist() if not name.endswith("/")}


def test_the_zip_holds_the_add_on_and_no_more(archive):
    names = {name for name in archive.namelist() if not name.endswith("/")}
    others = {"blender_manifest.toml", "translations/words.toml", "LICENSE"}
    assets = {name for name in names if name.startswith("assets/")}
    assert names - assets == ROOMS.keys() | SHARED.keys() | others
    assert {Path(name).suffix for name in assets} <= {".npz", ".npy", ".json", ".png", ".blend"}
    assert all(archive.read(name) == path.read_bytes() for name, path in ROOMS.items())
    assert all(archive.read(name).endswith(path.read_bytes()) for name, path in SHARED.items())
    assert sum(info.file_size for info in archive.infolist()) < 10e6


def test_everything_is_gpl_and_says_so(archive, manifest, trees):
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later"]
    assert b"GNU GENERAL PUBLIC LICENSE" in archive.read("LICENSE")
    assert all(archive.read(name).startswith(LICENCE) for name in trees)
    assert all(re.match(r"\d{4} \w", line) for line in manifest["copyright"]) and manifest["copyright"]


def test_the_manifest_follows_the_rules(manifest):
    assert re.fullmatch(r"[a-z][a-z0-9_]*", manifest["id"]) and re.fullmatch(r"\d+\.\d+\.\d+", manifest["version"])
    assert len(manifest["tagline"]) <= 64 and manifest["tagline"][-1].isalnum()
    assert "Blender" not in manifest["name"] and "wheels" not in manifest
    assert manifest["permissions"].keys() == {"files", "clipboard"}, "no network"
    assert all(len(why) <= 64 and why[-1].isalnum() for why in manifest["permissions"].values())


def test_nothing_reaches_for_the_network_or_installs_packages(trees):
    for name, tree in trees.items():
        for node in ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and not node.level else []
            assert not {n.split(".")[0] for n in names} & (NETWORK | FOREIGN), name
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                assert node.value not in ("pip", "ssh", "-m pip", "ensurepip"), name


def test_it_writes_into_no_folder_of_its_own():
    from cloak.properties import output_folder
    from cloak.trainer.program import user_folder

    own, runs = Path(sys.modules["cloak"].__file__).parent, output_folder(bpy.context.scene.cloak)
    assert not user_folder("test").is_relative_to(own) and not runs.is_relative_to(own)
    assert not runs.is_relative_to(user_folder("")), "what was trained outlives the extension"
    assert not list(own.rglob("*.log"))


FORBIDDEN_CALLS = {"print", "exec", "eval", "compile", "__import__"}


def test_nothing_is_printed_evaluated_or_put_among_the_modules(trees):
    for name, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call):
                assert getattr(node.func, "id", "") not in FORBIDDEN_CALLS, (name, node.lineno)
            if isinstance(node, ast.Attribute) and node.attr in ("modules", "path") and name != "headless.py":
                assert getattr(node.value, "id", "") != "sys", (name, node.lineno)
