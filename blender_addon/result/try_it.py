# SPDX-License-Identifier: GPL-3.0-or-later
"""Try It: one button from an empty file to pictures with a cloak and without: sample body, short training, check."""

from collections.abc import Callable

import bpy

from ..blender import colors
from ..body.objects import active_body
from ..session import session
from ..trainer.jobs import Job
from ..ui.operator import CloakOperator
from ..ui.window import areas

STEPS = 100
ANGLES = (-10, 10, 20)  # first, last and step, degrees


class CLOAK_OT_try_it(CloakOperator, label="Try It", trains=True):
    """Add the sample body, train its chest for a short while against the built-in detector, and render it with the \
cloak and without, for the detector to judge. Takes some minutes; Blender stays usable"""

    def run(self, context: bpy.types.Context) -> str:
        bpy.ops.cloak.add_sample_body()
        _then(session.job_of("Sample body"), _train)
        return "Sample body, short training, check: the panel shows how far it is"


def _then(job: Job, following: Callable[[], None]) -> None:
    """Let a step follow when a job has ended well; what it ends with is said before."""
    before = job.on_end

    def ended(job: Job) -> str | None:
        message = before(job) if before is not None else None
        if job.state == "done":
            following()
        return message

    job.on_end = ended


def _train() -> None:
    settings = bpy.context.scene.cloak
    settings.steps, settings.pose_source = STEPS, "CURRENT"
    settings.angle_first, settings.angle_last, settings.angle_step = ANGLES
    bpy.ops.cloak.train_start()
    _then(session.job_of("Training"), _check)


def _check() -> None:
    """Show the cloak as the detector saw it, and let the detector judge renders of it."""
    colors.use_standard_view(bpy.context.scene)
    for _, area in areas("VIEW_3D"):
        area.spaces.active.shading.light = "FLAT"
    active_body(bpy.context).select_set(False)  # its outline would hide the cloak
    bpy.ops.cloak.render_check()
