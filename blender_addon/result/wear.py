# SPDX-License-Identifier: GPL-3.0-or-later
"""Wear: the run's colours laid onto people in photographs, and what detectors make of them, before and after."""

import json
from dataclasses import dataclass
from pathlib import Path

import bpy

from ..blender.blend_paths import absolute, first_free
from ..body.objects import active_body, refusal
from ..files.errors import InputError
from ..files.reading import read_json
from ..files.writing import write_json
from ..trainer.command_lines import options
from ..trainer.jobs import Job, run_cloak
from ..trainer.progress import finite
from ..training.detectors import judges
from ..training.runs import run_of, side_folder
from ..ui.drawing import icon_of, short
from ..ui.operator import CloakOperator
from ..ui.panel_parts import CloakPanel, settings_column, wrapped
from .evaluations import CONTROLS, kept_back
from .reasons import result_reason

WEAR, ANSWER = "worn by people", "answer.json"
PICTURES = (".png", ".jpg", ".jpeg")
SHOWN, A_ROW = 6, 2  # pictures in the panel


def people_file(path: str) -> Path:
    """The COCO file of people that a folder holds, or that was named. Raises `InputError`."""
    if not path:
        raise InputError("People is empty: choose a people.json, or the folder of photographs that it lies in")
    chosen = Path(absolute(path))
    found = [chosen] if chosen.is_file() else sorted(chosen.glob("*.json"), key=lambda p: (p.name != "people.json", p))
    if not found:
        raise InputError(f"{chosen}: no people.json in it (people as COCO has them, with masks and landmarks)")
    return found[0]


@dataclass(frozen=True)
class Worn:
    """What came out of wearing a run."""

    folder: Path
    people: int
    left_out: int
    rates: dict[str, dict[str, float]]
    """Share of the pictures in which each detector reports nobody, by detector and by what was worn."""
    pictures: tuple[Path, ...]


def last_worn(run: Path) -> Worn | None:
    """That of the latest wearing of a run; None where there is none."""
    places = sorted(side_folder(run).glob(f"{WEAR}*/{ANSWER}"), key=lambda path: path.stat().st_mtime)
    try:
        record, folder = read_json(places[-1]), places[-1].parent
        rates = {spec: _rates(told) for spec, told in record["detectors"].items()}
        left = sum(int(count) for count in (record.get("left_out") or {}).values())
        found = [path for path in folder.rglob("pictures/*/*") if path.suffix.lower() in PICTURES]
        pictures = sorted(found, key=lambda path: (path.parent, not path.stem.startswith("before"), path.name))
        return Worn(folder, int(record["people"]), left, rates, tuple(pictures))
    except (IndexError, InputError, KeyError, TypeError, ValueError, AttributeError):
        return None


def _rates(told: dict) -> dict[str, float]:
    """At the detector's own threshold, where that is known."""
    known = {name: rate for name, rate in told.items() if isinstance(rate, dict)}
    rates = {name: finite(rate.get("success_own", rate.get("success"))) for name, rate in known.items()}
    return {name: rate for name, rate in rates.items() if rate is not None}


def foreign_reason(obj: bpy.types.Object) -> str:
    """Why people in photographs cannot wear a body's run: they are fitted with the faces of Cloak's own people."""
    run = run_of(obj)
    if obj.cloak.made_from or kept_back(run) or (run / "zoo.json").is_file() or (run / "cloth.png").is_file():
        return ""
    return (
        f"People in photographs wear what was trained on Cloak's own people, and '{obj.name}' is none of them: train "
        "on the sample body, or carry the colours over (cloak logo transfer)"
    )


class CLOAK_OT_wear(CloakOperator, label="Wear", trains=True):
    """Lay the run's colours onto the people of photographs, and let the detectors judge them before and after"""

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        settings = context.scene.cloak
        reason = result_reason(context) or refusal(people_file, settings.judging.people) or refusal(judges, settings)
        return reason or foreign_reason(active_body(context))

    def run(self, context: bpy.types.Context) -> str:
        settings, run = context.scene.cloak, run_of(active_body(context))
        people, place = people_file(settings.judging.people), first_free(side_folder(run), WEAR)
        words = ["wear", run, *options(judges(settings), people=people, device=settings.device), "--out", place]

        def ended(job: Job) -> str:
            try:
                record = json.loads(job.outputs[-1])
                count = int(record["people"])
            except (ValueError, KeyError, TypeError):
                raise InputError("Wear: the trainer's answer is not understood; see wear.log") from None
            place.mkdir(exist_ok=True)
            write_json(place / ANSWER, record)
            return f"{count} people wear it"

        waits = run_cloak("Wear", words, side_folder(run), "wear", ended)
        return f"{run.name} is put on by the people of {people.name}{waits}"


class CLOAK_PT_wear(CloakPanel, label="On Photographs", inside="result", trains=True):
    """The cloak on people in photographs"""

    def draw(self, context: bpy.types.Context) -> None:
        judging = context.scene.cloak.judging
        settings_column(self.layout, judging, "people")
        self.layout.operator("cloak.wear", icon="COMMUNITY")
        self.outcome(context, "Wear")
        worn = None if result_reason(context) else last_worn(run_of(active_body(context)))
        if worn is None:
            return
        wrapped(self.layout, context, f"{worn.people} people, {worn.left_out} left out; nobody is reported in:")
        table = self.layout.column(align=True)
        for spec, rates in worn.rates.items():
            table.label(text=short(spec, 40), icon="HIDE_OFF")
            for name, rate in rates.items():
                row = table.split(factor=0.6)
                row.label(text=CONTROLS.get(name, short(name, 24)))
                row.label(text=f"{rate:.0%}")
        grid = self.layout.grid_flow(row_major=True, columns=A_ROW, even_columns=True)
        for path in worn.pictures[:SHOWN]:
            cell = grid.column(align=True)
            cell.template_icon(icon_of(path), scale=7.0)
            cell.label(text=short(path.stem, 24))
        self.layout.operator("cloak.show_made", text="All Pictures", icon="FILE_FOLDER").path = str(worn.folder)
