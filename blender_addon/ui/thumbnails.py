# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the disk, small, in the panel."""

from __future__ import annotations

from pathlib import Path

import bpy.utils.previews

_pictures: bpy.utils.previews.ImagePreviewCollection | None = None
_names: dict[Path, str] = {}
"""What each file is called in the collection, which holds it as it last was."""


def icon_of(path: Path) -> int:
    """The icon that shows a picture; 0 where there is none."""
    if _pictures is None or not path.is_file():
        return 0
    name = f"{path} {path.stat().st_mtime_ns}"
    if name not in _pictures:
        if path in _names:
            del _pictures[_names[path]]
        _pictures.load(name, str(path), "IMAGE")
        _names[path] = name
    return _pictures[name].icon_id


def register() -> None:
    global _pictures
    _pictures = bpy.utils.previews.new()


def unregister() -> None:
    global _pictures
    bpy.utils.previews.remove(_pictures)
    _pictures = None
    _names.clear()
