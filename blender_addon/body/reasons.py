# SPDX-License-Identifier: GPL-3.0-or-later
"""Why a step cannot run yet, as far as body and logo decide it; "" means that it can. Cheap enough for every redraw."""

from __future__ import annotations

import functools
from collections.abc import Callable

import bpy

from ..blender.faces import logo_names
from ..files.errors import InputError
from .objects import active_body, require_upright

NO_BODY = "Choose a body first"


def refusal(check: Callable, *arguments: object) -> str:
    """What `check` has against its arguments; "" when nothing."""
    try:
        check(*arguments)
    except InputError as error:
        return str(error)
    return ""


def body_reason(context: bpy.types.Context) -> str:
    """Why there is no usable body."""
    return refusal(active_body, context)


def of_the_body(reason: Callable[[bpy.types.Context, bpy.types.Object], str]) -> Callable[[bpy.types.Context], str]:
    """A reason that asks about the active body; where there is none, why not."""

    @functools.wraps(reason)
    def asked(context: bpy.types.Context) -> str:
        return body_reason(context) or reason(context, active_body(context))

    return asked


@of_the_body
def logo_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why there is no logo to train."""
    if logo_names(obj.data):
        return ""
    others = [o.name for o in context.view_layer.objects if o.type == "MESH" and o != obj and logo_names(o.data)]
    if others:
        return f"No logo on '{obj.name}'; '{others[0]}' has one: click that, or make one here"
    return "Make a logo first"


@of_the_body
def upright_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why nothing can be stamped onto the body."""
    return refusal(require_upright, obj)
