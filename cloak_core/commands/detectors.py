"""`cloak detectors ...` and `cloak look`: which families there are, what they see, whether they are read rightly."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional, UseAppendAction

from cloak_core.commands.base import Command, out, warn
from cloak_core.commands.options import Detecting, Photographed, Watched
from cloak_core.commands.progress import counted
from cloak_core.core.settings.values import Angles
from cloak_core.files.errors import InputError
from cloak_core.files.writing import require_new
from cloak_core.sources.bodies.opening import load_scene

if TYPE_CHECKING:
    from cloak_core.studies.look import Looker

LOW = 0.1
"""A best score below this is none."""


@dataclass(kw_only=True)
class Check(Photographed, Detecting):
    """Show what a detector says of a photograph (--image), of renders (--scene, --backgrounds) or of people in
    photographs (--people).

    Of `masked=SIDE:SPEC` also the certified recall: people whom no patch of SIDE pixels can hide.
    """

    example = "builtin --image person.jpg --out seen.png"

    spec: Positional[str]
    image: Path | None = None
    """Photograph to look at."""
    out: Path | None = None
    """Picture to write, with the boxes of --image."""
    threshold: float = 0.6
    """Score above which a person counts as detected."""
    scene: str | None = None
    backgrounds: str | None = None
    angles: Angles = Angles((-10.0, 0.0, 10.0))
    seed: int = 0
    patterns: bool = False
    """With --scene: also show patterned cloth that nobody wears."""

    def run(self) -> dict:
        self.prepare()
        if [self.image, self.scene, self.people].count(None) != 2:
            raise InputError("detectors check: give either --image, or --scene and --backgrounds, or --people")
        if self.image is not None:
            from cloak_core.detectors.check import check_image

            if self.out is not None:
                require_new(self.out)
            if not 0 <= self.threshold < 1:
                raise InputError(f"--threshold: {self.threshold:g} is not in [0, 1)")
            detector = self.load(self.spec)
            return check_image(detector, self.image, threshold=self.threshold, out=self.out)
        if self.people is not None:
            from cloak_core.studies.clean import check_people

            return check_people(self.load(self.spec), self.cast())
        if self.backgrounds is None:
            raise InputError("detectors check: --scene needs --backgrounds")
        from cloak_core.sources.backdrops.backgrounds import load_backgrounds
        from cloak_core.studies.clean import check_scene

        detector = self.load(self.spec)
        bodies, backgrounds = load_scene(self.scene), load_backgrounds(self.backgrounds)
        result = check_scene(detector, bodies, backgrounds, self.angles, seed=self.seed)
        if self.patterns:
            from cloak_core.studies.negatives import pattern_alarms

            result["patterns"] = pattern_alarms(detector, backgrounds, bodies, self.seed)
        return result

    def show(self, result: dict) -> None:
        point = operating_point(result)
        if "max_person" in result:
            out.print(
                f"best person score {result['max_person']:.3f}; the detector reports {result['reported']}, {point}"
            )
            for x1, y1, x2, y2, score in result["boxes"]:
                out.print(f"  {score:.3f}  at {x1:.0f},{y1:.0f} to {x2:.0f},{y2:.0f}")
            if result["operating_point_assumed"] and LOW < result["max_person"] <= result["operating_point"]:
                out.print("its scores are low here: say @conf= where you know from which one it reports")
            self._show_pixels(result)
        else:
            for end, where in (("", "at 0.6"), ("_own", point)):
                names = {
                    "clean recall": "clean_recall",
                    "false alarms": "false_alarms",
                    "certified": "certified_recall",
                }
                figures = [f"{name} {result[key + end]:.3f}" for name, key in names.items() if key + end in result]
                out.print(f"{', '.join(figures)} {where}")
            for kind, figures in result.get("patterns", {}).items():
                alarms = f"{figures['alarms']:.3f} ({figures['plain']:.3f} without it) at 0.6"
                out.print(
                    f"false alarms on cloth that nobody wears, {kind}: {alarms}; {figures['alarms_own']:.3f} {point}"
                )
            for alarm in result.get("alarms", []):
                out.print(f"  {alarm['score']:.3f}  {alarm['background']}: a person where nobody is")

    @staticmethod
    def _show_pixels(result: dict) -> None:
        """Show how the network may want its pixels, where nobody said."""
        if result["max_person"] > result["operating_point"]:  # it sees the person as its pixels are handed over
            return
        undecided = result.get("pixels_undecided", [])
        if len(undecided) > 1:
            out.print(f"one picture cannot tell how it wants its pixels: the first {len(undecided)} are as plausible")
        for options, score in result.get("pixels", {}).items():
            plausible = result["pixels_plausible"][options]
            out.print(f"  {score:.3f}  with pixels as @{options}, plausible by {plausible:.2f}")


def operating_point(report: dict) -> str:
    """Say from which score a detector reports."""
    return f"from {report['operating_point']:g} up{' (assumed)' if report['operating_point_assumed'] else ''}"


@dataclass(kw_only=True)
class Verify(Watched):
    """Check that detectors are read rightly and keep the protocol.

    Exit code 1 where a check fails.
    """

    example = "onnx:net.onnx --images photographs"

    specs: Positional[tuple[str, ...]]
    images: Path | None = None
    """Folder of photographs to ask about, beside the renders."""
    renders: int = 4
    """Renders of sample bodies to ask about."""
    against: str | None = None
    """The same network in another form (default: the file's own runtime, or as trained)."""

    def run(self) -> dict:
        self.prepare()
        if not self.specs:
            raise InputError("detectors verify: which detector?")
        if self.renders < 0 or (self.images is None and not self.renders):
            raise InputError("--renders: some images are needed")
        from cloak_core.studies.clean import verify_specs

        original = None if self.against is None else self.load(self.against)
        with counted("checking", self.events, "steps") as tell:
            reports = verify_specs(self.specs, self.load, self.images, self.renders, original, tell)
        return reports[self.specs[0]] if len(reports) == 1 else reports

    def failures(self, result: dict) -> list[str]:
        failed = [report for report in self.reports(result) if report["failed"]]
        return [f"{report['spec']}: failed: {', '.join(report['failed'])}" for report in failed]

    def show(self, result: dict) -> None:
        for report in self.reports(result):
            kind = "white box" if report["white_box"] else "black box, evaluation alone"
            out.print(f"{report['spec']}: {report['layout']}, {kind}, reports {operating_point(report)}")
            for name, check in report["checks"].items():
                verdict = {True: "ok", False: "FAILED", None: "-"}[check["passed"]]
                out.print(f"  {name:<20} {verdict:<7} {check['words']}")

    @staticmethod
    def reports(result: dict) -> list[dict]:
        return [result] if "checks" in result else list(result.values())


@dataclass(kw_only=True)
class List(Command):
    """List the detector families and defences: what each needs, how each was verified."""

    def run(self) -> dict:
        from cloak_core.detectors.families import list_families

        return list_families()

    def show(self, result: dict) -> None:
        for family in result["families"]:
            uses = " and ".join(use for use, can in (("trains", "trains"), ("evaluates", "evaluates")) if family[can])
            out.print(f"{family['spec']}: {uses}; {family['licence']}; verified: {family['verified']}")
            if not family["installed"]:
                out.print(f"    not installed: {family['install']}")
        for defence in result["defences"]:
            out.print(f"{defence['spec']}: {defence['what']}")


MAX_LINE = 1 << 16
"""Characters of a request."""


@dataclass(kw_only=True)
class Look(Detecting):
    """Render a body from one camera and say where detectors see a person."""

    example = "request.json --detector builtin"

    request: Positional[Path]
    """JSON: scene, out (a folder), and any of logo, colors, cloth, pose, outfit, azimuth, elevation, distance,
    field_of_view, pivot, width, height, backgrounds, background. -: one such object a line from standard input. Answers
    go to OUT/look.json."""
    detector: UseAppendAction[tuple[str, ...]] = ()
    """(default: builtin)"""

    def run(self) -> dict:
        self.prepare()
        from cloak_core.files.reading import read_json
        from cloak_core.studies.look import Look, Looker

        asked = None if self.request == Path("-") else Look.of(read_json(self.request))
        looker = Looker(self.by_spec(self.detector or ("builtin",)))
        return {"looks": answer_lines(looker)} if asked is None else looker.look(asked)

    def show(self, result: dict) -> None:
        for spec, figures in result.get("detectors", {}).items():
            for name, seen in ((name, seen) for name, seen in figures.items() if isinstance(seen, dict)):
                found = "found" if seen["max_person"] > figures["operating_point"] else "hidden"
                out.print(f"{spec}: {name} {found}, best score {seen['max_person']:.3f}")
        if "looks" in result:
            out.print(f"{result['looks']} looks")


def answer_lines(looker: Looker) -> int:
    """Answer the requests of standard input, one a line; how many there were."""
    from cloak_core.files.reading import parse_json
    from cloak_core.files.writing import write_json
    from cloak_core.studies.look import ANSWER, Look

    count = 0
    while line := sys.stdin.readline(MAX_LINE):
        count += bool(line.strip())
        record: dict = {}
        try:
            if line.strip():
                record = parse_json(line.encode(), f"request {count}")
                looker.look(Look.of(record))
        except InputError as error:
            warn(str(error))
            place = record.get("out")  # where the answer is waited for
            if isinstance(place, str) and Path(place).is_dir():
                write_json(Path(place) / ANSWER, {"error": str(error)})
    return count
