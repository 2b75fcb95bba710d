# SPDX-License-Identifier: GPL-3.0-or-later
"""Why a cloak cannot be worn or judged now; "" means that it can. Cheap enough for every redraw."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..body.garments import is_dressed
from ..body.objects import of_the_body, refusal
from ..training.runs import run_of
from .worn_scenes import require_same_clothes


@of_the_body
def result_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why there are no colours to show."""
    if not obj.cloak.run:
        return f"'{obj.name}' has no training yet: press Start, or choose a run in the list"
    run = run_of(obj)
    if not run.is_dir():
        return f"{run}: no such run folder"
    return "" if (run / "colors.npy").is_file() else f"{run.name}: no colours yet; wait for the first step"


@of_the_body
def judged_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why nothing can be made of the body's run: no evaluation, no sheets to print, no film."""
    return result_reason(context) or worn_reason(obj) or refusal(require_same_clothes, obj, run_of(obj))


def worn_reason(obj: bpy.types.Object) -> str:
    """Why what is on the model is not what would be judged; "" when it is."""
    worn, run = obj.cloak.worn, run_of(obj)
    if not worn or run is None or Path(worn) == run or not is_dressed(obj):
        return ""
    return f"The model wears {Path(worn).name}, chosen is {run.name}: press Load Colours"
