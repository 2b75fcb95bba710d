"""`cloak harden`: a detector that cloaks no longer hide from, made of one that they do."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from cloak_core.commands.base import out, warn
from cloak_core.commands.options import Computing, Photographed
from cloak_core.commands.progress import TrainingProgress
from cloak_core.files.errors import InputError
from cloak_core.files.writing import is_taken
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.studies.hardening.settings import HardenSettings

if TYPE_CHECKING:
    from cloak_core.studies.hardening.hardening import HardenMaterial
    from cloak_core.studies.hardening.student import Student


MOST_HOURS = 10_000


@dataclass(kw_only=True)
class Harden(Photographed, Computing):
    """Harden a detector against cloaks, by adversarial fine-tuning without labels.

    The result has the same format. Give --photos and --people: renders alone teach less. Ctrl-C, or a file `cancel` in
    --out, stops it (exit code 3); --resume goes on.
    """

    example = "builtin --steps 300 --out hardened"
    next_why = "cloaks that are trained against it anew judge it"

    spec: Positional[str]
    out: Path
    """New folder to write, or the one to --resume."""
    resume: bool = False
    hours: float | None = None
    """Hours to take, without cards: --steps is set by timing a few updates."""
    scene: str = "sample:train"
    backgrounds: str = "procedural:train"
    photos: str | None = None
    """Folder of photographs, with people or without, in which the detector keeps its answers."""
    people: str | None = None
    assess: bool = True
    """Make no robustness cards before and after in OUT/cards (twenty minutes)."""
    settings: Annotated[OmitArgPrefixes[HardenSettings], arg(name="hardening")] = field(default_factory=HardenSettings)

    def run(self) -> dict:
        from cloak_core.detectors.naming import full_spec
        from cloak_core.sources.backdrops.backgrounds import load_backgrounds
        from cloak_core.studies.hardening.hardening import HardenMaterial, harden
        from cloak_core.studies.hardening.pictures import check_places
        from cloak_core.studies.hardening.students import open_student

        self.prepare()
        if is_taken(self.out) and not self.resume:
            raise InputError(f"{self.out}: exists already (--resume goes on with it)")
        self.spec = full_spec(self.spec)
        if self.hours is not None and not 0 < self.hours < MOST_HOURS:
            raise InputError(f"--hours {self.hours:g}: is not in (0, {MOST_HOURS})")
        student, bodies = open_student(self.spec, self.compute.device), load_scene(self.scene)
        backgrounds = load_backgrounds(self.backgrounds)
        if not self.backgrounds.startswith("procedural"):
            check_places(backgrounds, student.teacher, self.settings.size, self.backgrounds)
        photographs = None if self.photos is None else load_backgrounds(self.photos)
        material = HardenMaterial(bodies, backgrounds, photographs, self.cast())
        settings = self._planned(student, material)
        with TrainingProgress(label="hardening") as progress:
            result = harden(settings, student, material, self.out, resume=self.resume, on_event=progress)
        stopped = f"stopped at step {result.step}: {result.stopped}" if result.stopped else ""
        skipped = stopped or ("" if self.assess else "--no-assess: nobody asked for them")
        cards = {"before": None, "after": None, "no_cards": skipped} if skipped else self._cards(result.spec)
        record = cards | {
            "out": str(self.out),
            "spec": result.spec,
            "step": result.step,
            "steps": result.steps,
            "seconds": round(result.seconds, 1),
            "judge": self._commands(result.spec),
        }
        return record | ({"stopped": stopped} if stopped else {})

    def _planned(self, student: Student, material: HardenMaterial) -> HardenSettings:
        """Settings with the counts that --hours asks for; those of the record where a hardening goes on."""
        from cloak_core.studies.hardening.planning import measure_pace, plan, recorded_plan

        if self.hours is None:
            return self.settings
        if self.resume and self.out.exists():
            return recorded_plan(self.settings, self.out)
        with TrainingProgress(label="timing updates") as progress:
            pace = measure_pace(self.settings, student, material, progress)
        settings, planned, warning = plan(self.settings, pace, self.hours)
        out.print(planned)
        if warning:
            warn(warning)
        return settings

    def _cards(self, spec: str) -> dict:
        """Make the cards of the detector before and after, and the page that compares them."""
        from cloak_core.commands.assess import Assess

        specs = (self.spec, spec)
        made = Assess(specs=specs, out=self.out / "cards", quick=True, compute=self.compute).run()
        before, after = (made["cards"][one] for one in specs)
        return {"before": before, "after": after, "files": made["files"]}

    def _commands(self, spec: str) -> list[str]:
        """List the commands that judge the result by new cloaks on logos that it never saw."""
        both = ["--detector", self.spec, "--detector", spec]
        proof = ["reproduce", "hardened", *both, "--out", str(self.out / "proof")]
        cards = ["assess", self.spec, spec, "--quick", "--out", str(self.out / "cards")]
        return [shlex.join(["cloak", *words]) for words in (proof, cards)]

    def show(self, result: dict) -> None:
        out.print(f"wrote {result['spec']}: step {result['step']} of {result['steps']}, {result['seconds']:.0f} s")
        if result["before"] is not None:
            from cloak_core.studies.card.words import headline, lede

            for name in ("before", "after"):
                out.print(f"{name}: {headline(result[name])}")
                out.print(f"  {lede(result[name])}")
            for path in result["files"]:
                out.print(f"wrote {path}")

    def following(self, result: dict) -> tuple[str, ...]:
        return tuple(shlex.split(result["judge"][0])[1:])
