# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties of Blender, as the add-on declares them."""

from collections.abc import Callable

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5, 0) else set()
"""Options of paths: the file browser may put in "//" paths. Older Blenders always let it."""


def _plain(kind: Callable, default: object) -> Callable:
    """A function that declares properties of a kind: by name, description, default, and Blender's other options."""

    def declare(name: str, description: str, default: object = default, **options: object) -> object:
        return kind(name=name, description=description, default=default, **options)

    return declare


text, switch = _plain(StringProperty, ""), _plain(BoolProperty, False)
whole, number = _plain(IntProperty, 0), _plain(FloatProperty, 0.0)


def path(name: str, description: str, subtype: str = "FILE_PATH", relative: bool = True, **options: object) -> object:
    """A file or folder; it may lie beside the .blend file ("//"), unless not `relative`."""
    options |= {"options": {"ANIMATABLE"} | RELATIVE} if relative else {}
    return StringProperty(name=name, description=description, subtype=subtype, **options)


def share(name: str, description: str, default: float, least: float = 0.0, most: float = 1.0) -> object:
    """A slider from `least` to `most`."""
    return number(name, description, default, min=least, max=most, subtype="FACTOR")


def choice(name: str, description: str, *items: tuple[str, str, str], **options: object) -> object:
    """One of some items: value, name, description; the first is the default."""
    return EnumProperty(name=name, description=description, items=items, **options)
