# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel of step 5: the trained colours on the model."""

from __future__ import annotations

import bpy

from ..blender import colors
from ..body.garments import is_dressed
from ..body.objects import active_body
from ..session import session
from ..training import run_list
from ..translations import said
from ..ui.drawing import short
from ..ui.panel_parts import CloakPanel, figure, wrapped
from ..ui.thumbnails import icon_of
from .reasons import result_reason
from .render_check import Verdict

PICTURES_A_ROW = 3
KINDS = ("With the cloak", "Without")
SCORE = "The detector's highest score for a person in this render; the open eye: it reports one"


class CLOAK_PT_result(CloakPanel, bpy.types.Panel):
    """Step 5: the trained colours on the model"""

    bl_label = "5. Result"

    def draw(self, context: bpy.types.Context) -> None:
        reason = result_reason(context)
        column = self.gate(context, reason)
        dressed = not reason and is_dressed(active_body(context))
        column.operator("cloak.result_load", icon="IMPORT")
        column.operator("cloak.result_toggle", text="Show Original" if dressed else "Show Cloak", icon="HIDE_OFF")
        column.prop(context.scene.cloak, "look")
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
        if not reason and state is not None and state.checks:
            self._checks(context, state.checks)

    def _checks(self, context: bpy.types.Context, checks: tuple[Verdict, ...]) -> None:
        """The last render check of the chosen run: what came out, and the renders with their scores."""
        told = session.job_of("Render check")  # whose message stands above
        for check in checks if len(checks) > 1 or told is None or told.message != checks[0].describe() else ():
            words = f"{short(check.spec, 30)}: {said(check.describe())}" if len(checks) > 1 else check.describe()
            wrapped(self.layout, context, words, icon="CHECKMARK" if check.holds else "ERROR")
        half = len(checks[0].with_cloak)
        for name, chosen in zip(KINDS, (slice(half), slice(half, None)), strict=True):
            self.layout.label(text=name, icon="RENDER_RESULT")
            grid = self.layout.grid_flow(row_major=True, columns=PICTURES_A_ROW, even_columns=True)
            for number, path in list(enumerate(checks[0].images))[chosen]:
                cell = grid.column(align=True)
                cell.template_icon(icon_of(path), scale=4.0)
                for check in checks:
                    score = check.scores[number]
                    figure(cell, f"{score:.2f}", SCORE, "HIDE_OFF" if score >= check.threshold else "HIDE_ON")
