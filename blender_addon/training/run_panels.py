# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels of what was trained: the runs, side by side, and the colours of the chosen one on the model."""

from __future__ import annotations

import bpy

from ..body.objects import active_body
from ..body.reasons import body_reason
from ..files.specs import without_folders
from ..session import session
from ..translations import said
from ..ui.panel_parts import CLOSED, CloakPanel, figure, settings_column, wrapped
from . import run_list
from .run_states import DONE, FAILED, RUNNING, STOPPED, RunState

RUN_ICONS = {RUNNING: "PLAY", DONE: "CHECKMARK", STOPPED: "PAUSE", FAILED: "ERROR"}


class CLOAK_UL_runs(bpy.types.UIList):
    """The runs that were found, the latest first"""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index) -> None:
        state = session.runs.get(item.path)
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
        if not body_reason(context):
            settings_column(self.layout).prop(active_body(context).cloak, "run")

    def _chosen(self, context: bpy.types.Context, state: RunState) -> None:
        of = f" of '{state.object}', logo '{state.logo}'" if state.object else ""
        against = f", against {', '.join(map(without_folders, state.detectors))}" if state.detectors else ""
        reached = f" at {state.progress.describe()}" if state.progress.steps else ""
        words = f"{state.state.capitalize()}{reached}{of}{against}"
        wrapped(self.layout, context, f"{words}: {state.why}" if state.why else words, icon=RUN_ICONS[state.state])


class CLOAK_PT_compare(CloakPanel, bpy.types.Panel):
    """The runs side by side: success in training, and of the evaluation on bodies and backgrounds it never saw"""

    bl_label = "Compare"
    bl_parent_id = "CLOAK_PT_runs"
    bl_options = CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        shown = [state for state in session.runs.values() if state.progress.success is not None][:COMPARED]
        if not shown:
            wrapped(self.layout, context, "No run has figures yet")
            return
        for state in shown:
            column = self.layout.column(align=True)
            column.label(text=state.title, icon=RUN_ICONS[state.state])
            grid = column.grid_flow(row_major=True, columns=2, even_columns=True)
            for (name, tip), rate in zip(COLUMNS.items(), _compared(state), strict=True):
                figure(grid, f"{said(name)} {rate}", tip)
        if not any(state.unseen for state in shown):
            wrapped(self.layout, context, "Unseen: Evaluate, in step 5, measures it, beside its controls")


COMPARED = 8
"""Runs, the latest ones."""
COLUMNS = {
    "In training": "Share of the last training images in which the detector does not report the body, a running mean",
    "Unseen": "The same on bodies and backgrounds that training never saw, measured by Evaluate, of several detectors "
    "the worst",
    "Own clothing": "The control: the body in its own clothing, on the same images. A cloak is worth what it has more",
    "Random": "The control: random colours on the logo's faces, on the same images",
}


def _compared(state: RunState) -> tuple[str, ...]:
    """Success in per cent, by the columns."""
    rates = (state.progress.success, *(state.unseen.get(name) for name in ("logo", "clothing", "random")))
    return tuple("–" if rate is None else f"{100 * rate:.0f} %" for rate in rates)
