# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the disk, small, in the panel."""

from __future__ import annotations

from pathlib import Path

import bpy.utils.previews

_pictures: bpy.utils.previews.ImagePreviewCollection | None = None


def icon_of(path: Path) -> int:
    """The icon that shows a picture; 0 where there is none."""
    if _pictures is None or not path.is_file():
        return 0
    name = f"{path} {path.stat().st_mtime_ns}"
    if name not in _pictures:
        _pictures.load(name, str(path), "IMAGE")
    return _pictures[name].icon_id


def register() -> None:
    global _pictures
    _pictures = bpy.utils.previews.new()


def unregister() -> None:
    global _pictures
    bpy.utils.previews.remove(_pictures)
    _pictures = None
