"""Build the Blender extension with Blender's own builder: `python tools/build_extension.py [--out dist]`.

The builder wants `__init__.py` beside the manifest, so the add-on, the manifest, the licence and the two shared
packages are staged in a temporary folder first. It comes with the `bpy` package, or with a `blender` on the path.
`--repository` builds a folder that any web server makes an extension repository. CLOAK_URL names the project's site.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

from stable_blend import stable

ROOT = Path(__file__).resolve().parents[1]
SHARED = ("files", "exchange")
"""Rooms of cloak_core that the add-on uses; links in the checkout, which some systems check out as text files."""
UNPICKLING = ("torch_pickles.py", "unpickling.py", "pickle_machine.py")
LEFT_OUT = ("caching.py", "likeness.py", *UNPICKLING, "__pycache__")
"""Of those rooms, what the add-on does not use."""
CHECKOUT = ("train.py", "cycles_frames.py")
"""Of the add-on, what only the trainer runs."""
LICENCE = "# SPDX-License-Identifier: GPL-3.0-or-later\n"
EARLIEST = time.mktime((1980, 1, 1, 0, 0, 0, 0, 0, -1))
"""The first moment that a zip can hold, on this machine's clock."""
BUILDER = "scripts/addons_core/bl_pkg/cli/blender_ext.py"


def main() -> int:
    """Stage, validate and build; prints the path of the zip."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder for the zip (default: dist)")
    parser.add_argument("--repository", action="store_true", help="also write the index of an extension repository")
    options = parser.parse_args()
    builder = find_builder()
    if builder is None:
        print(
            "Blender's extension builder is missing: `tools/setup_blender.sh` brings it (the bpy package), "
            "or put a Blender on the path",
            file=sys.stderr,
        )
        return 2
    with tempfile.TemporaryDirectory() as temporary:
        source = Path(temporary) / "cloak"
        stage(source)
        package = options.out / package_name()
        options.out.mkdir(parents=True, exist_ok=True)
        package.unlink(missing_ok=True)
        index = [["server-generate", "--html", "--repo-dir", str(options.out)]] if options.repository else []
        for command in (
            ["validate", str(source)],
            ["build", "--source-dir", str(source), "--output-filepath", str(package)],
            ["validate", str(package)],
            *index,
        ):
            done = subprocess.run([*builder, *command], stdout=sys.stderr, check=False)
            if done.returncode:
                return 1
    print(package)
    return 0


def package_name() -> str:
    """The zip's name, from the manifest."""
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text("utf-8"))
    return f"{manifest['id']}-{manifest['version']}.zip"


def stage(folder: Path) -> None:
    """Stage the extension as Blender wants it: the add-on, its assets, the shared formats, manifest and licence."""
    source = ROOT / "blender_addon"
    shutil.copytree(source, folder, ignore=shutil.ignore_patterns(*SHARED, *CHECKOUT, "__pycache__"))
    for room in SHARED:
        shutil.copytree(ROOT / "cloak_core" / room, folder / room, ignore=shutil.ignore_patterns(*LEFT_OUT))
        for path in (folder / room).rglob("*.py"):  # whose licence in the repository, Apache-2.0, allows for this one
            path.write_text(LICENCE + path.read_text("utf-8"), "utf-8")
    shutil.copyfile(ROOT / "LICENSES" / "GPL-3.0-or-later.txt", folder / "LICENSE")
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    cloths = folder.with_name("cloths")
    command = [trainer_python(), str(ROOT / "tools" / "blender_assets.py"), str(folder / "assets"), str(cloths)]
    subprocess.run(command, check=True, env=environment | {"PYTHONPATH": str(ROOT)})
    library = folder / "assets" / "library" / "cloths.blend"
    command = [*run_in_blender(ROOT / "tools" / "blender_cloths.py"), str(folder), str(cloths), str(library)]
    subprocess.run(command, check=True, stdout=sys.stderr, env=environment | {"PYTHONDONTWRITEBYTECODE": "1"})
    manifest = (ROOT / "blender_manifest.toml").read_text("utf-8")
    if site := os.environ.get("CLOAK_URL", "").rstrip("/"):
        manifest = manifest.replace('type = "add-on"\n', f'type = "add-on"\nwebsite = "{site}"\n')
    (folder / "blender_manifest.toml").write_text(manifest, "utf-8")
    library.write_bytes(stable(library.read_bytes()))
    for path in folder.rglob("*"):  # the same content is to be the same zip, wherever and whenever it is built
        path.chmod(0o755 if path.is_dir() else 0o644)
        os.utime(path, (EARLIEST, EARLIEST))


def trainer_python() -> str:
    """The Python with cloak_core, which makes the assets; the builder's own has no place for it."""
    return os.environ.get("CLOAK_TRAINER") or str(ROOT / ".venv" / "bin" / "python")


def run_in_blender(script: Path) -> list[str]:
    """The command line that runs a script with Blender's Python; its arguments follow."""
    here = importlib.util.find_spec("bpy") is not None
    python = sys.executable if here else str(ROOT / ".venv-blender" / "bin" / "python")
    if os.access(python, os.X_OK):
        return [python, str(script)]
    return [find_blender(), "-b", "--factory-startup", "--python-exit-code", "1", "-P", str(script), "--"]


def find_blender() -> str | None:
    """Blender's program, where there is one."""
    return os.environ.get("BLENDER") or shutil.which("blender")


def find_builder() -> list[str] | None:
    """The command line of Blender's extension builder."""
    packages = []
    spec = importlib.util.find_spec("bpy")
    if spec is not None and spec.submodule_search_locations:
        packages += [Path(place) for place in spec.submodule_search_locations]
    packages += (ROOT / ".venv-blender").glob("lib/python*/site-packages/bpy")
    for package in packages:
        for script in sorted(package.glob(f"*/{BUILDER}")):
            return [sys.executable, str(script)]
    blender = find_blender()
    return [blender, "--command", "extension"] if blender else None


if __name__ == "__main__":
    sys.exit(main())
