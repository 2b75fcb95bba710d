# SPDX-License-Identifier: GPL-3.0-or-later
"""Exports of a body that wears a run's colours: to be judged and filmed, not trained on."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy

from .exchange.bodies import Bodies
from .exchange.face_lists import read_face_list
from .exchange.scenes import write_scene
from .files.errors import InputError
from .poses import PoseChoice
from .run_states import read_state
from .scene_export import export_bodies


def export_worn(
    context: bpy.types.Context,
    obj: bpy.types.Object,
    run: Path | None,
    choice: PoseChoice,
    with_clothing: bool,
    folder: Path,
) -> Bodies:
    """A scene package in `folder` (replaced) on which the run's colours fit. Without a run any will do.

    It is tried with and without clothing, for the colours belong to what was exported when training began. Raises
    `InputError` where neither has the faces of the training.
    """
    expected = read_face_list(run / "logo.npy").topology if run else None
    logo = read_state(run).logo if run else ""
    for clothed in (with_clothing, not with_clothing):
        bodies = export_bodies(context, obj, choice, clothed, logo)
        if expected in (None, bodies.topology):
            shutil.rmtree(folder, ignore_errors=True)
            write_scene(folder, bodies, creator="cloak add-on")
            return bodies
    raise InputError(
        f"'{obj.name}' changed since {run.name} was trained: its faces, or those of its clothing, are others; undo the "
        "change, or train again"
    )
