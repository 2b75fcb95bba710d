# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths that a .blend file keeps: relative to it ("//...") where they lie beside it, so that a project can be moved.

Blender itself carries relative paths over when a file is saved into another folder, but not those of add-ons.
"""

import itertools
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

_while_saving: list[tuple[bpy.types.PropertyGroup, dict[str, str]]] = []
"""Owners of paths, and their paths as absolute ones by name, while a file is being written."""


def absolute(path: str) -> str:
    """A path as the user typed it ("//" means beside the .blend file) as an absolute one; "" stays ""."""
    return str(Path(bpy.path.abspath(path)).absolute()) if path else ""


def blend_folder() -> Path | None:
    """Return the folder of the open file; None if the file was never saved."""
    return Path(bpy.data.filepath).parent if bpy.data.filepath else None


def first_free(folder: Path, name: str, suffix: str = "", beside: str = "") -> Path:
    """A path that does not exist, nor does it with `beside` behind it: "name.suffix", "name 2.suffix" and so on."""
    for number in itertools.count(1):
        place = folder / (name + (f" {number}" if number > 1 else "") + suffix)
        if not place.exists() and not (beside and place.with_name(place.name + beside).exists()):
            return place


def portable(path: str, folder: Path | None) -> str:
    """Write an absolute path relative to `folder` ("//...") if it lies in it."""
    if folder is None or not path or not Path(path).is_relative_to(folder):
        return path
    return "//" + Path(path).relative_to(folder).as_posix()


def _owners() -> list[bpy.types.PropertyGroup]:
    objects = [obj.cloak for obj in bpy.data.objects if obj.library is None]
    scenes = [scene.cloak for scene in bpy.data.scenes if scene.library is None]
    return [*objects, *scenes, *(s.judging for s in scenes), *(d for s in scenes for d in s.detectors)]


@persistent
def before_saving(file: str, _: object = None) -> None:
    """Before saving: rewrite paths relative to the folder of the file to be written."""
    folder = Path(file).parent if file else None
    _while_saving.clear()
    for owner in _owners():
        strings = [p for p in owner.bl_rna.properties if p.type == "STRING" and p.subtype in ("FILE_PATH", "DIR_PATH")]
        paths = {p.identifier: absolute(getattr(owner, p.identifier)) for p in strings if getattr(owner, p.identifier)}
        if paths:
            _while_saving.append((owner, paths))
            _write(owner, paths, folder)


@persistent
def after_saving(*_: object) -> None:
    """After saving: rewrite paths relative to the open file, which may differ from the written one (a copy)."""
    for owner, paths in _while_saving:
        _write(owner, paths, blend_folder())
    _while_saving.clear()


def _write(owner: bpy.types.PropertyGroup, paths: dict[str, str], folder: Path | None) -> None:
    for name, path in paths.items():
        words = portable(path, folder)
        if getattr(owner, name) != words:
            setattr(owner, name, words)


HANDLERS = (("save_pre", before_saving), ("save_post", after_saving), ("save_post_fail", after_saving))
