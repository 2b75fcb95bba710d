# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators: each checks, calls a plain function of the rooms above, and says what happened."""

from . import (
    bake,
    body,
    drag_stamp,
    evaluate,
    heat,
    install,
    logo,
    outputs,
    paint,
    pick,
    result,
    runs,
    stamp,
    start_stop,
)

CLASSES = (
    *install.CLASSES,
    *body.CLASSES,
    *logo.CLASSES,
    *pick.CLASSES,
    *paint.CLASSES,
    *stamp.CLASSES,
    *drag_stamp.CLASSES,
    *heat.CLASSES,
    *start_stop.CLASSES,
    *runs.CLASSES,
    *result.CLASSES,
    *bake.CLASSES,
    *evaluate.CLASSES,
    *outputs.CLASSES,
)
