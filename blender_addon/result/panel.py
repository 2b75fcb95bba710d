# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of step 5: the trained colours on the model, and what they are worth."""

from collections.abc import Iterable
from itertools import groupby
from pathlib import Path

import bpy

from ..blender import colors
from ..body.garments import is_dressed
from ..body.objects import active_body
from ..files.specs import without_folders
from ..session import session
from ..training import run_list
from ..training.runs import run_of
from ..translations import said
from ..ui.bases import CloakPanel, figure, settings_column, wrapped
from ..ui.drawing import icon_of, short
from .evaluations import CONTROLS, KINDS, Rate, Sight, by_detector, last_worn, result_reason
from .operators import ready_cloaks
from .outputs import made
from .render_check import describe, holds

COARSE = "Solid view shows the mean of the cloth on each face, Material Preview the cloth as it is printed"
RENDERS = {"cloak": "With the cloak", "clothing": "Without"}
SCORE = "The detector's highest score for a person in this render; the open eye: it reports one"
SEEN_ICON = {True: "HIDE_OFF", False: "HIDE_ON"}  # an eye, open or shut
HEADS = ("at", "at its own")  # of rates at the common threshold, and at the detector's
LATEST, SHOWN = 4, 6  # most outputs to list, most people in photographs to show
SUCCESS = (
    "Share of the images in which the detector reports no person (from this score on), and the interval that holds the "
    "true share in 95 of 100 such measurements"
)
CONTROL = {
    "logo": "The run's colours on the logo",
    "clothing": "The control: the body in its own clothing, on the same images. A cloak is worth what it has more",
    "grey": "The control: plain grey on the logo's faces, on the same images",
    "random": "The control: random colours on the logo's faces, on the same images",
}


def show_sights(layout: bpy.types.UILayout, sights: Iterable[Sight], columns: int, scale: float) -> None:
    """Draw pictures in rows, each with what every detector made of it."""
    grid = layout.grid_flow(row_major=True, columns=columns, even_columns=True)
    cells: dict[Path, bpy.types.UILayout] = {}
    for sight in sights:
        if sight.picture not in cells:
            cells[sight.picture] = grid.column(align=True)
            cells[sight.picture].template_icon(icon_of(sight.picture), scale=scale)
        figure(cells[sight.picture], f"{sight.score:.2f}", SCORE, SEEN_ICON[sight.found])


def show_rates(layout: bpy.types.UILayout, rates: Iterable[Rate]) -> None:
    """Draw each detector's rates: at the common threshold, and at its own below that; side by side they are clipped."""
    for spec, of_spec in groupby(rates, key=lambda rate: rate.spec):
        layout.label(text=short(without_folders(spec), 36), icon="HIDE_OFF")
        for head, (at, rows) in zip(HEADS, groupby(of_spec, key=lambda rate: rate.threshold), strict=False):
            table = layout.column(align=True)
            figure(table, f"{head} {at:g}", SUCCESS, "NONE")
            for rate in rows:
                split, tip = table.split(factor=0.45), CONTROL.get(rate.name, CONTROL["logo"])
                figure(split.column(), CONTROLS.get(rate.name, short(rate.name, 24)), tip, "NONE")
                split.label(text=rate.describe())


class CLOAK_PT_result(CloakPanel, label="5. Result"):
    """Step 5: the trained colours on the model"""

    def draw(self, context: bpy.types.Context) -> None:
        reason = result_reason(context)
        if ready_cloaks():
            self.layout.operator_menu_enum("cloak.ready_cloak", "cloak", text="Ready Cloaks", icon="MATCLOTH")
        row = self.layout.row(align=True)
        row.operator("cloak.cloth_picture", icon="TEXTURE")
        row.operator("cloak.lay_cloth", text="Lay Cloth", icon="UV")
        column = self.gate(context, reason)
        dressed = not reason and is_dressed(active_body(context))
        column.operator("cloak.result_load", icon="IMPORT")
        column.operator("cloak.result_toggle", text="Show Original" if dressed else "Show Cloak", icon="HIDE_OFF")
        column.prop(context.scene.cloak, "look")
        warning = colors.view_transform_reason(context.scene) or colors.light_reason(context.space_data)
        if warning and not reason:
            box = self.layout.box()
            wrapped(box, context, warning, icon="ERROR")
            box.operator("cloak.use_standard_view")
        shading = getattr(context.space_data, "shading", None)
        if dressed and shading and shading.type == "SOLID" and colors.worn_cloth(active_body(context).data)[0]:
            wrapped(self.layout, context, COARSE, icon="INFO")
        row = column.row(align=True)
        row.operator("cloak.open_report", icon="URL")
        row.operator("cloak.render_check", icon="RENDER_STILL")
        self.outcome(context, "Render check", "Report")
        state = run_list.selected(context)
        if not reason and state is not None and state.checks:
            self._checks(context, state.checks)

    def _checks(self, context: bpy.types.Context, sights: tuple[Sight, ...]) -> None:
        """The last render check of the chosen run: what came out, and the renders with their scores."""
        job, rows = session.job_of("Render check"), by_detector(sights)
        for spec, one in rows.items():
            words = describe(one)
            if len(rows) > 1 or job is None or job.message != words:  # else it stands above
                words = f"{short(spec, 30)}: {said(words)}" if len(rows) > 1 else words
                wrapped(self.layout, context, words, icon="CHECKMARK" if holds(one) else "ERROR")
        for kind, name in RENDERS.items():
            self.layout.label(text=name, icon="RENDER_RESULT")
            show_sights(self.layout, [sight for sight in sights if sight.kind == kind], 3, 4.0)


class CLOAK_PT_evaluation(CloakPanel, label="Evaluation", inside="result", trains=True):
    """What the cloak is worth where training never saw it"""

    def draw(self, context: bpy.types.Context) -> None:
        judging = context.scene.cloak.judging
        column = settings_column(self.layout, judging, "bodies")
        if judging.bodies == "FRAMES":
            settings_column(column, judging, "frame_start", "frame_end", "frame_step", align=True)
        column.prop(judging, "backgrounds")
        settings_column(column, judging, "images", "angle", align=True)
        self.layout.operator("cloak.evaluate", icon="VIEWZOOM")
        self.outcome(context, "Evaluation")
        state = run_list.selected(context)
        evaluation = state.evaluation if state is not None else None
        if evaluation is None:
            return
        if evaluation.outdated:
            wrapped(self.layout, context, "The run has newer colours: evaluate again", icon="ERROR")
        job = session.job_of("Evaluation")
        if job is None or evaluation.describe() not in job.message:  # which stands above
            wrapped(self.layout, context, evaluation.describe().capitalize(), icon="INFO")
        show_rates(self.layout, evaluation.rates)
        self.layout.prop(judging, "ring", text="Ring around the Body")


class CLOAK_PT_take_along(CloakPanel, label="Print, Film, Image", inside="result"):
    """The cloak on paper, on film, in an image"""

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        column.operator("cloak.print_sheets", icon="FILE_BLANK")
        row = column.row(align=True)
        row.operator("cloak.bake", icon="IMAGE_DATA")
        row.operator("cloak.export_glb", text="GLB")
        column.operator("cloak.turntable", icon="CON_ROTLIKE")
        column.operator("cloak.film", icon="VIEW_CAMERA")
        settings_column(self.layout, context.scene.cloak.judging, "film_format", "film_seconds")
        self.outcome(context, "Print Sheets", "Turntable", "Film with Camera")
        if result_reason(context):
            return
        for path in made(run_of(active_body(context)))[:LATEST]:
            row = self.layout.row(align=True)
            row.label(text=path.name, icon="FILE_FOLDER" if path.is_dir() else "FILE_MOVIE")
            row.operator("cloak.show_made", text="Open").path = str(path)


class CLOAK_PT_eye(CloakPanel, label="Detector's Eye", closed=True, trains=True):
    """What the detector makes of the body from where you look"""

    def draw(self, context: bpy.types.Context) -> None:
        judging, watching = context.scene.cloak.judging, session.eye
        open_ = watching is not None
        text = "Close the Eye" if open_ else "Look"
        self.layout.operator("cloak.eye", text=text, icon=SEEN_ICON[open_], depress=open_)
        settings_column(self.layout, judging, "eye_from", "eye_background")
        self.outcome(context, "Detector's Eye")
        if watching is None:
            return
        if watching.seen is None:
            wrapped(self.layout, context, "The detector is getting ready...", icon="INFO")
        row = self.layout.row()
        for kind, (name, _) in KINDS.items() if watching.seen is not None else ():
            if sights := [sight for sight in watching.seen.sights if sight.kind == kind]:
                column = row.column(align=True)
                column.label(text=name)
                show_sights(column, sights, 1, 6.0)


class CLOAK_PT_wear(CloakPanel, label="On Photographs", inside="result", trains=True):
    """The cloak on people in photographs"""

    def draw(self, context: bpy.types.Context) -> None:
        settings_column(self.layout, context.scene.cloak.judging, "people")
        self.layout.operator("cloak.wear", icon="COMMUNITY")
        self.outcome(context, "Wear")
        worn = None if result_reason(context) else last_worn(run_of(active_body(context)))
        if worn is None:
            return
        wrapped(self.layout, context, f"{worn.people} people, {worn.left_out} left out; nobody is reported in:")
        show_rates(self.layout, worn.rates)
        grid = self.layout.grid_flow(row_major=True, columns=2, even_columns=True)
        for path in worn.pictures[:SHOWN]:
            cell = grid.column(align=True)
            cell.template_icon(icon_of(path), scale=7.0)
            cell.label(text=short(path.stem, 24))
        self.layout.operator("cloak.show_made", text="All Pictures", icon="FILE_FOLDER").path = str(worn.folder)
