# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel on top: the program that trains, and the jobs that run."""

import bpy

from ..session import session
from ..translations import said
from ..ui.panel_parts import CloakPanel, figure, wrapped
from ..ui.window import tool_at_work
from .jobs import TrainingJob
from .program import PACKAGE, preferences, trainer_reason

TRAINER = "The program that trains, outside of Blender; the add-on's preferences choose and test it"
FIGURES = (
    "Loss: what training makes small, of the last step. Success: the share of the last training images in which the "
    "detector does not report the body, a running mean"
)


class CLOAK_PT_jobs(CloakPanel, label="Jobs"):
    """What runs outside Blender, and how far it is"""

    bl_options = {"HIDE_HEADER"}  # noqa: RUF012

    def draw(self, context: bpy.types.Context) -> None:
        session.panel_seen = True
        active = [(number, job) for number, job in enumerate(session.jobs) if job.active]
        for number, job in active:
            row = self.layout.row(align=True)
            row.progress(factor=job.fraction, text=said(job.describe()))
            row.operator("cloak.train_cancel", text="", icon="X").number = number
            if isinstance(job, TrainingJob) and job.progress.figures():
                figure(self.layout, job.progress.figures().capitalize(), FIGURES)
            if job.notice:
                wrapped(self.layout, context, job.notice, icon="ERROR")
        if active and (tool := tool_at_work()):
            wrapped(self.layout, context, f"What jobs bring waits for: {tool}")
        if reason := trainer_reason():
            wrapped(self.layout, context, reason)
            row = self.layout.row(align=True)
            row.operator("cloak.copy_install_line", icon="COPYDOWN")
            row.operator("preferences.addon_show", text="", icon="PREFERENCES").module = PACKAGE
        elif not active:
            figure(self.layout, preferences().answer or "Trainer found", TRAINER, "CONSOLE")
