# SPDX-License-Identifier: GPL-3.0-or-later
"""What all operators and panels share.

Of operators: `InputError` becomes a message in the status bar, and nothing else has happened.
"""

import inspect
import textwrap
from collections.abc import Callable, Sequence
from contextlib import nullcontext

import blf
import bpy
from bpy.props import StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ..body.objects import NO_BODY, active_body, body_reason
from ..files.errors import InputError
from ..session import session
from ..trainer.program import Unasked, trainer_reason
from ..translations import said
from .window import in_window, progress_cursor

Reason = Callable[[bpy.types.Context], str]
"""Why an operator cannot run now, "" when it can: what a greyed button says. Quick: asked on every redraw."""
WITH_UNDO = {"REGISTER", "UNDO"}  # of operators that change the mesh and have ended when they return


class CloakOperator(bpy.types.Operator):
    """Base: `run(context)` does the work and returns what to say, "" for nothing. CLOAK_OT_x is `bpy.ops.cloak.x`."""

    bl_options = {"REGISTER"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        reasons = (reason(context) for reason in cls.needs)
        reason = (cls.trains and trainer_reason()) or next(filter(None, reasons), "")
        if reason:
            cls.poll_message_set(said(reason))
        return not reason

    def __init_subclass__(
        cls, label: str = "", needs: Sequence[Reason] = (), trains: bool = False, told_by: str = ""
    ) -> None:
        """trains: it needs the trainer. told_by: the property by which its buttons, and so their tooltips, differ."""
        cls.bl_idname, cls.bl_label = "cloak." + cls.__name__.removeprefix("CLOAK_OT_"), label
        cls.needs, cls.trains, cls.told_by = needs, trains, told_by

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """A button's tooltip: what the value of its own does; "" is the class's docstring."""
        if not cls.told_by or not (value := getattr(properties, cls.told_by)):
            return ""
        declared = properties.bl_rna.properties[cls.told_by]
        if declared.type == "ENUM":
            return said(declared.enum_items[value].description)
        return said(value if declared.type == "STRING" else declared.description)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self.attempt(self.run, context)

    def attempt(self, work: Callable[..., str | set[str]], *arguments: object) -> set[str]:
        """Do the work and report its message. Returns Blender's result set, or the one that the work returns."""
        session.note_change(geometry=False)  # whatever a script did since the last redraw
        try:
            message = work(*arguments)
        except InputError as error:
            if isinstance(error, Unasked) and bpy.context.window is not None and not bpy.app.background:
                bpy.ops.cloak.allow("INVOKE_DEFAULT", specs="\n".join(error.specs), then=type(self).__name__)
                return {"CANCELLED"}
            self.report({"ERROR"}, said(str(error)))
            return {"CANCELLED"}
        if isinstance(message, set):
            return message
        if message:
            self.report({"INFO"}, said(message))
        return {"FINISHED"}


def operator(
    label: str,
    *needs: Reason,
    undo: bool = False,
    reads: str = "",
    writes: str = "",
    confirm: bool = False,
    told_by: str = "",
    trains: bool = False,
    **properties: object,
) -> Callable[[Callable[..., str]], Callable[..., str]]:
    """Make the operator `bpy.ops.cloak.NAME` of a function NAME; its docstring is the tooltip, it returns what to say.

    The function gets the context, the properties by their names, and as `obj` the active body: then it changes the
    body, can be undone, and may call `show_progress`, by which the mouse pointer counts up.
    reads, writes: suffixes of the files that Blender's browser shows first; `filepath` is a property then.
    """

    def declare(work: Callable[..., str]) -> Callable[..., str]:
        asked = [name for name in inspect.signature(work).parameters if name != "context"]
        changes = "obj" in asked

        def run(self: CloakOperator, context: bpy.types.Context) -> str:
            values = {name: active_body(context) if name == "obj" else getattr(self, name) for name in asked}
            with progress_cursor() if changes else nullcontext():
                return work(context, **values)

        parts = {"__doc__": work.__doc__, "__module__": work.__module__, "__annotations__": properties, "run": run}
        bases = (CloakOperator, *([ImportHelper] if reads else []), *([ExportHelper] if writes else []))
        if suffix := reads or writes:
            parts["filename_ext"] = suffix.partition(";")[0]
            properties["filter_glob"] = StringProperty(default=f"*{suffix}", options={"HIDDEN"})
        if undo or changes:
            parts["bl_options"] = WITH_UNDO
        if confirm:
            parts["invoke"] = lambda self, context, event: context.window_manager.invoke_confirm(self, event)
        known = {"needs": needs or ([body_reason] if changes else []), "trains": trains, "told_by": told_by}
        work.operator = type(f"CLOAK_OT_{work.__name__}", bases, parts, label=label, **known)
        return work

    return declare


def push_undo(message: str) -> None:
    """An undo step for what a timer changed, so that the next Ctrl Z does not take it along.

    Other modes than Object Mode have steps of their own, between which none could be undone: there Ctrl Z stays theirs.
    """
    in_window(lambda: bpy.context.mode == "OBJECT" and bpy.ops.ed.undo_push(message=message))


# --- panels ----------------------------------------------------------------------------------------------------------

BESIDE_WORDS = 88.0  # pixels of the sidebar that a label in a box does not have: margins, its icon, the tabs


def wrapped(layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "INFO") -> None:
    """Draw a message, wrapped to the width of the sidebar: Blender cuts off what is wider."""
    scale = context.preferences.system.ui_scale
    room = context.region.width - BESIDE_WORDS * scale if context.region else 300
    blf.size(0, context.preferences.ui_styles[0].widget.points * scale)
    text = said(text)
    letter = max(1.0, blf.dimensions(0, text)[0] / max(1, len(text)))
    for width in range(max(10, int(room / letter)), 9, -1):  # of the mean letter; some lines have wider ones
        lines = textwrap.wrap(text, width) or [""]
        if max(blf.dimensions(0, line)[0] for line in lines) <= room:
            break
    column = layout.column(align=True)
    column.scale_y = 0.85
    for index, line in enumerate(lines):
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
