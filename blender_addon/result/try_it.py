# SPDX-License-Identifier: GPL-3.0-or-later
"""Try It: one button from an empty file to a picture before and after: sample body, short training, check.

The status bar says how far it is.
"""

from collections.abc import Callable

import bpy
import numpy as np

from ..blender import colors
from ..blender.pictures import new_image, read_picture
from ..body.objects import active_body
from ..session import session
from ..trainer.command_lines import options, require
from ..trainer.jobs import Job
from ..training.detectors import judges
from ..training.runs import run_of, side_folder
from ..translations import said
from ..ui.operator import CloakOperator
from ..ui.window import areas, show_image, tell_status
from .render_check import last_verdicts

STEPS = 100
PICTURE = "{:.2f} before, {:.2f} after: scores, reported from {:g}"  # its beginning is seen in the editor's header


class CLOAK_OT_try_it(CloakOperator, label="Try It", trains=True):
    """Add the sample body, train its front for a short while against the built-in detector, and render it with the \
cloak and without, for the detector to judge. Takes some minutes; Blender stays usable"""

    def run(self, context: bpy.types.Context) -> str:
        require(options(judges(context.scene.cloak)))
        bpy.ops.cloak.add_sample_body()
        _then("Sample body", _train)
        return "Sample body, short training, check: the status bar shows how far it is"


def _then(label: str, following: Callable[[], None]) -> None:
    """Let a step follow when the job of this label has ended well; until then the status bar shows it."""
    job = session.job_of(label)
    end, tick = job.on_end, job.on_tick

    def ticked(job: Job) -> None:
        if job.active:
            tell_status(f"{label}: {said(job.describe())}")
        if tick is not None:
            tick(job)

    def ended(job: Job) -> str | None:
        tell_status("")
        message = end(job) if end is not None else None
        if job.state == "done":
            following()
        return message

    job.on_end, job.on_tick = ended, ticked


def _train() -> None:
    settings = bpy.context.scene.cloak
    settings.steps, settings.pose_source = STEPS, "CURRENT"
    settings.angle_first, settings.angle_last, settings.angle_step = -10, 10, 20  # degrees
    active_body(bpy.context).cloak.logo = "front"  # the chest alone hides nobody in so few steps
    bpy.ops.cloak.train_start()
    _then("Training", _check)


def _check() -> None:
    """Show the cloak as the detector saw it, and let the detector judge renders of it."""
    colors.use_standard_view(bpy.context.scene)
    for _, area in areas("VIEW_3D"):
        area.spaces.active.shading.light = "FLAT"
    active_body(bpy.context).select_set(False)  # its outline would hide the cloak
    bpy.ops.cloak.render_check()
    _then("Render check", _compare)


def _compare() -> None:
    """Show the first render without the cloak, and beside it the one with it; its name has the scores."""
    verdict = last_verdicts(side_folder(run_of(active_body(bpy.context))))[0]
    shown = (len(verdict.images) // 2, 0)
    title = PICTURE.format(*(verdict.scores[number] for number in shown), verdict.threshold)
    image = new_image(title, np.concatenate([read_picture(verdict.images[n])[..., :3] for n in shown], axis=1))
    image.pack()
    show_image(image)
