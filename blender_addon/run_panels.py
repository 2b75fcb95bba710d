# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels of what was trained: the runs, side by side, and the colours of the chosen one on the model."""

from __future__ import annotations

import bpy

from . import colors, jobs, run_list, steps
from .body import active_body
from .garments import is_dressed
from .panel_parts import CLOSED, CloakPanel, figure, settings_column, wrapped
from .render_check import THRESHOLD, Verdict
from .run_states import DONE, FAILED, RUNNING, STOPPED, RunState
from .thumbnails import icon_of

PICTURES_A_ROW = 3
RUN_ICONS = {RUNNING: "PLAY", DONE: "CHECKMARK", STOPPED: "PAUSE", FAILED: "ERROR"}


class CLOAK_UL_runs(bpy.types.UIList):
    """The runs that were found, the latest first"""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index) -> None:
        state = run_list.states.get(item.path)
        if state is None:
            return
        split = layout.split(factor=0.55)
        split.label(text=state.title, icon=RUN_ICONS[state.state])
        figures = split.row()
        figures.label(text=f"{state.progress.step:,}")
        success = state.progress.success
        figures.label(text="" if success is None else f"{success:.0%}")


class CLOAK_PT_runs(CloakPanel, bpy.types.Panel):
    """Every training there is: beside the file, in the output folder, worn by a body"""

    bl_label = "Runs"

    def draw(self, context: bpy.types.Context) -> None:
        run_list.is_drawn()
        window = context.window_manager.cloak
        row = self.layout.row()
        row.template_list("CLOAK_UL_runs", "", window, "runs", window, "run_index", rows=4)
        side = row.column(align=True)
        side.operator("cloak.run_attach", text="", icon="LINKED")
        side.operator("cloak.run_stop", text="", icon="PAUSE")
        side.separator()
        side.operator("cloak.run_delete", text="", icon="TRASH")
        state = run_list.selected(context)
        if state is not None:
            self._chosen(context, state)
        if not steps.body_reason(context):
            settings_column(self.layout).prop(active_body(context).cloak, "run")

    def _chosen(self, context: bpy.types.Context, state: RunState) -> None:
        of = f" of '{state.object}', logo '{state.logo}'" if state.object else ""
        against = f", against {', '.join(state.detectors)}" if state.detectors else ""
        words = f"{state.state.capitalize()} at {state.progress.describe()}{of}{against}"
        wrapped(self.layout, context, f"{words}: {state.why}" if state.why else words, icon=RUN_ICONS[state.state])


class CLOAK_PT_compare(CloakPanel, bpy.types.Panel):
    """The runs side by side: success in training, and of the evaluation on bodies and backgrounds it never saw"""

    bl_label = "Compare"
    bl_parent_id = "CLOAK_PT_runs"
    bl_options = CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        shown = [state for state in run_list.states.values() if state.progress.success is not None][:COMPARED]
        if not shown:
            wrapped(self.layout, context, "No run has figures yet")
            return
        table = self.layout.column(align=True)
        split, cells = _line(table)
        split.label(text="Success")
        for name, tip in COLUMNS.items():
            figure(cells, name, tip, "NONE")
        for title, *rates in map(_compared, shown):
            split, cells = _line(table)
            split.label(text=title)
            for rate in rates:
                cells.label(text=rate)
        if not any(state.unseen for state in shown):
            wrapped(self.layout, context, "New: Evaluate, in step 5, measures it, beside its controls")


COMPARED = 8
"""Runs, the latest ones."""
COLUMNS = {
    "Old": "Share of the last training images in which the detector does not report the body, a running mean",
    "New": "The same on bodies and backgrounds that training never saw, measured by `cloak evaluate`, of several "
    "detectors the worst",
    "Own": "The control: the body in its own clothing, on the same images. A cloak is worth what it has more",
    "Rnd": "The control: random colours on the logo's faces, on the same images",
}
SCORE = f"The detector's highest score for a person in this render; from {THRESHOLD} on it counts as detected"


def _line(table: bpy.types.UILayout) -> tuple[bpy.types.UILayout, bpy.types.UILayout]:
    """A place for a name and one for figures."""
    split = table.split(factor=0.36)
    return split.column(), split.row()


def _compared(state: RunState) -> tuple[str, ...]:
    """A line of the table."""
    rates = (state.progress.success, *(state.unseen.get(name) for name in ("logo", "clothing", "random")))
    return state.title, *("–" if rate is None else f"{rate:.0%}" for rate in rates)


class CLOAK_PT_result(CloakPanel, bpy.types.Panel):
    """Step 5: the trained colours on the model"""

    bl_label = "5. Result"

    def draw(self, context: bpy.types.Context) -> None:
        reason = steps.result_reason(context)
        column = self.gate(context, reason)
        dressed = not reason and is_dressed(active_body(context))
        column.operator("cloak.result_load", icon="IMPORT")
        column.operator("cloak.result_toggle", text="Show Original" if dressed else "Show Cloak", icon="HIDE_OFF")
        warning = colors.view_transform_reason(context.scene)
        if warning and not reason:
            box = self.layout.box()
            wrapped(box, context, warning, icon="ERROR")
            box.operator("cloak.use_standard_view")
        row = column.row(align=True)
        row.operator("cloak.open_report", icon="URL")
        row.operator("cloak.render_check", icon="RENDER_STILL")
        self.progress(context, "Render check", "Report")
        state = run_list.selected(context)
        if not reason and state is not None and state.check is not None:
            self._check(context, state.check)

    def _check(self, context: bpy.types.Context, check: Verdict) -> None:
        """The last render check of the chosen run: what came out, and the renders with their scores."""
        if jobs.current is None or jobs.current.label != "Render check":
            wrapped(self.layout, context, check.describe(), icon="CHECKMARK" if check.holds else "ERROR")
        half = len(check.with_cloak)
        for name, chosen in (("With the cloak", slice(half)), ("Without", slice(half, None))):
            self.layout.label(text=name, icon="RENDER_RESULT")
            grid = self.layout.grid_flow(row_major=True, columns=PICTURES_A_ROW, even_columns=True)
            for path, score in zip(check.images[chosen], check.scores[chosen], strict=False):
                cell = grid.column(align=True)
                cell.template_icon(icon_of(path), scale=4.0)
                figure(cell, f"{score:.2f}", SCORE, "HIDE_OFF" if score >= THRESHOLD else "HIDE_ON")


CLASSES = (CLOAK_UL_runs, CLOAK_PT_runs, CLOAK_PT_compare, CLOAK_PT_result)
