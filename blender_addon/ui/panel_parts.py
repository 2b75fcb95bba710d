# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panels are drawn with."""

import textwrap

import bpy

from ..body.objects import NO_BODY, body_reason
from ..session import session
from ..trainer.program import trainer_reason
from ..translations import said


def wrapped(layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "INFO") -> None:
    """Draw a message, wrapped to the width of the sidebar."""
    scale = context.preferences.system.ui_scale
    width = max(20, int((context.region.width / scale - 60) / 6.2)) if context.region else 48
    column = layout.column(align=True)
    column.scale_y = 0.85
    for index, line in enumerate(textwrap.wrap(said(text), width) or [""]):
        column.label(text=line, icon=icon if index == 0 else "BLANK1")


def settings_column(layout: bpy.types.UILayout, owner: object = None, *names: str, **look: bool) -> bpy.types.UILayout:
    """A column of settings, their names on the left, values on the right; it begins with these of `owner`."""
    column = layout.column(**look)
    column.use_property_split, column.use_property_decorate = True, False
    for name in names:
        column.prop(owner, name)
    return column


def figure(layout: bpy.types.UILayout, text: str, tip: str, icon: str = "BLANK1") -> None:
    """Draw a figure with a tooltip that explains it."""
    row = layout.row(align=True)
    row.alignment = "LEFT"
    row.operator("cloak.explain", text=said(text), icon=icon, emboss=False).tip = tip


class CloakPanel(bpy.types.Panel):
    """Base of the panels."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Cloak"

    def __init_subclass__(
        cls, label: str, inside: str = "", closed: bool = False, unfinished: object = None, trains: bool = False
    ) -> None:
        """inside: the panel that it is part of; it is closed at first, as with `closed`.

        trains: without a trainer there is nothing in it, and it is not shown.
        unfinished(context): why the next steps cannot have what they need of this one; "" gives its header a tick.
        """
        cls.bl_label, cls.unfinished, cls.trains = label, staticmethod(unfinished), trains
        if inside:
            cls.bl_parent_id = f"CLOAK_PT_{inside}"
        if inside or closed:
            cls.bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return not (cls.trains and trainer_reason())

    def draw_header(self, context: bpy.types.Context) -> None:
        if self.unfinished and not self.unfinished(context):
            self.layout.label(icon="CHECKMARK")

    def gate(self, context: bpy.types.Context, reason: str) -> bpy.types.UILayout:
        """A column of settings, greyed out below its reason when there is one."""
        self.say(context, reason)
        column = settings_column(self.layout)
        column.enabled = not reason
        return column

    def say(self, context: bpy.types.Context, reason: str) -> None:
        """Draw why a step cannot run, if so; problems of the body are described in step 1."""
        if reason:
            wrapped(self.layout, context, NO_BODY if body_reason(context) else reason)

    def outcome(self, context: bpy.types.Context, *labels: str) -> None:
        """Draw how this panel's last job ended. Running jobs stand in the panel on top."""
        job = session.job_of(*labels)
        if job and not job.active and job.message:
            bad = job.state == "failed" or job.is_bad_news
            wrapped(self.layout, context, job.message, icon="ERROR" if bad else "CHECKMARK")
