"""`cloak zoo`: trained colours that ship with the project."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional, UseAppendAction

from cloak_core.commands.base import Command, out, table
from cloak_core.commands.options import Computing
from cloak_core.commands.progress import counted
from cloak_core.files.errors import InputError
from cloak_core.files.writing import require_new
from cloak_core.sources.bodies.opening import load_scene

if TYPE_CHECKING:
    from cloak_core.zoo.entry import Entry


@dataclass(kw_only=True)
class List(Command):
    """List the zoo: trained colours that come with Cloak; zoo:NAME stands for a run folder."""

    def run(self) -> dict:
        from cloak_core.zoo.entry import entry, mean_success, shelved

        kept = ("name", "detectors", "logo", "cover", "about", "licence", "faces")
        rows = []
        for record in (entry(name).record for name in shelved()):
            row = {key: record[key] for key in kept}
            row["success"] = mean_success(record["evaluation"])
            row["success_on_people"] = mean_success(record.get("people", {}))
            rows.append(row)
        return {"zoo": rows}

    def show(self, result: dict) -> None:
        from cloak_core.studies.report.words import percent, short_name

        rows = []
        for record in result["zoo"]:
            trained = ", ".join(short_name(spec) for spec in record["detectors"])
            rates = percent(record["success"]), percent(record["success_on_people"])
            rows.append((record["name"], record["logo"], trained, *rates, record["licence"]))
        title = "zoo: mean success over the detectors each was evaluated on (cloak zoo show NAME)"
        heads = ("name", "logo", "trained on", "success", "on people", "licence")
        out.print(table(title, heads, rows, words=3, whole=True))


@dataclass(kw_only=True)
class Show(Command):
    """Show an entry's record: where its colours come from, and what they are worth."""

    example = "builtin-sample"

    name: Positional[str]
    """Name of the entry."""

    def run(self) -> dict:
        from cloak_core.zoo.entry import entry

        return entry(self.name).record

    def show(self, result: dict) -> None:
        from cloak_core.studies.report.words import interval, percent, short_name

        out.print(f"{result['name']}: {result['about']}")
        out.print(f"{result['logo']}, {result['faces']} faces; {result['licence']}; seed {result['seed']}")
        out.print(f"trained on {', '.join(short_name(spec) for spec in result['detectors'])}: {result['command']}")
        rows, figures = [], result["evaluation"]
        boxes = {True: "white", False: "black"}
        for spec, rates in figures["detectors"].items():
            logo, random = rates["logo"], rates.get("random", {})
            shares = percent(logo["success"]), interval(logo["ci95"]), percent(logo["success_own"])
            box = boxes.get(figures["white_box"].get(spec), "?")
            rows.append((short_name(spec), box, *shares, percent(random.get("success")), str(logo["n"])))
        heads = ("judged by", "box", "at 0.6", "95 %", "at its own", "random", "images")
        out.print(table("success on bodies, backgrounds and angles that training never saw", heads, rows, words=2))
        for spec, rates in result.get("people", {}).get("detectors", {}).items():
            logo = rates["logo"]
            shares = f"{percent(logo['success'])} at 0.6, {percent(logo['success_own'])} at its own threshold"
            out.print(f"on {logo['n']} people in photographs, judged by {short_name(spec)}: {shares}")


@dataclass(kw_only=True)
class Reproduce(Computing):
    """Judge entries again as their records say, beside the recorded figures.

    Entries whose detectors, scenes or photographs are missing are left out, and named.
    """

    example = "builtin-sample"

    names: Positional[tuple[str, ...]] = ()
    """Entries (default: all)."""
    files: Path | None = None
    """Folder with the detectors' files and the scenes, by the records' names, at any depth."""
    backgrounds: Path | None = None
    """Folder of the photographs of training; what was seen is left out by content."""
    detector: UseAppendAction[tuple[str, ...]] = ()
    """Your detector of a record's file name, if it runs code: python:PLACE/d2go.py:load@conf=0.5."""
    most_images: int | None = None

    def run(self) -> dict:
        from cloak_core.studies.zoo_reproduction import Files, evaluate_again
        from cloak_core.zoo.entry import entry, shelved

        self.prepare()
        files, rows, left_out = Files(self.files, self.backgrounds, self.detector), [], {}
        for zoo_entry in [entry(name) for name in self.names or shelved()]:
            name = zoo_entry.record["name"]
            try:
                with counted(f"zoo:{name}") as tell:
                    judged = evaluate_again(zoo_entry, files, self.most_images, self.compute.device, tell)
            except InputError as error:
                if self.names:
                    raise
                left_out[name] = str(error)
                continue
            rows.append({"name": name, "detectors": judged})
        return {"zoo": rows, "left_out": left_out}

    def failures(self, result: dict) -> list[str]:
        return [
            f"zoo:{row['name']}: {spec}: not what was recorded, beyond the 95 % intervals"
            for row in result["zoo"]
            for spec, figures in row["detectors"].items()
            if not figures["holds"]
        ]

    def show(self, result: dict) -> None:
        from cloak_core.studies.report.words import interval, percent, short_name

        rows = []
        for row in result["zoo"]:
            for spec, figures in row["detectors"].items():
                old, new = figures["recorded"], figures["again"]
                shares = [percent(rates[key]) for key in ("success", "success_own") for rates in (old, new)]
                shares.insert(2, interval(old["ci95"]))
                rows.append((row["name"], short_name(spec), *shares, str(new["n"])))
        heads = ("name", "judged by", "at 0.6", "again", "95 %", "at its own", "again", "images")
        out.print(table("success as recorded, with its interval, and again", heads, rows, words=2, whole=True))
        for name, why in result["left_out"].items():
            out.print(f"left out: {name}: {why}")


@dataclass(kw_only=True)
class Export(Command):
    """Write an entry as a run folder, or as a .glb of a body that wears it."""

    example = "builtin-sample --format glb --out cloak.glb"

    name: Positional[str]
    """Name of the entry."""
    out: Path
    """New folder; of a .glb, the file."""
    format: Literal["run", "glb"] = "run"
    """What to write."""
    scene: str | None = None
    """(default: the entry's, where that ships; first pose)"""
    dpi: int = 150

    def run(self) -> dict:
        from cloak_core.zoo.entry import entry

        zoo_entry = entry(self.name)
        if self.format == "run":
            zoo_entry.write_run(self.out)
        else:
            self._write_glb(zoo_entry)
        return {
            "out": str(self.out),
            "faces": len(zoo_entry.ids),
            "name": zoo_entry.record["name"],
            "format": self.format,
        }

    def _write_glb(self, zoo_entry: Entry) -> None:
        from cloak_core.core.logo import load_logo
        from cloak_core.products.printing import write_worn
        from cloak_core.studies.opening import run_pattern
        from cloak_core.zoo.entry import MARK, run_path

        require_new(self.out)
        if not 10 <= self.dpi <= 600:
            raise InputError(f"--dpi {self.dpi}: one in [10, 600] is needed")
        recorded = zoo_entry.config["inputs"].get("scene") or ""
        scene = self.scene or (recorded if recorded.startswith("sample") else None)
        if not scene:
            raise InputError(f"--scene: say which body wears zoo:{zoo_entry.record['name']} (its own does not ship)")
        bodies = load_scene(scene)
        if bodies.topology != zoo_entry.config["topology"]:
            topology = zoo_entry.config["topology"]
            raise InputError(f"{scene}: topology {bodies.topology}, zoo:{zoo_entry.record['name']} is for {topology}")
        path = run_path(MARK + zoo_entry.record["name"])
        write_worn(self.out, bodies, run_pattern(path, load_logo(bodies, path / "logo.npy"), bodies), self.dpi)

    def show(self, result: dict) -> None:
        out.print(f"wrote {result['out']}: {result['faces']} faces of zoo:{result['name']}")


@dataclass(kw_only=True)
class Add(Command):
    """Make an entry of a finished run and its evaluation."""

    example = "runs/first --name first --about 'Chest'"

    run_folder: Positional[Path]
    """Run folder with its evaluation."""
    name: str
    """Of the entry: small letters, digits, dots, dashes."""
    about: str
    """One line for people."""
    command: str = ""
    """Command that trained it, without folders."""
    licence: str = "CC0-1.0"
    """Of the colours."""
    logo: str | None = None
    """Name of the logo (default: its file or regions)."""
    folder: Path | None = None
    """Folder of entries (default: the one that ships)."""

    def run(self) -> dict:
        from cloak_core.zoo.adding import write_entry
        from cloak_core.zoo.entry import SHELF

        folder = self.folder or SHELF
        words = {"about": self.about, "licence": self.licence, "command": self.command, "logo": self.logo}
        write_entry(folder, self.name, self.run_folder, **words)
        files = [folder / f"{self.name}.{end}" for end in ("npz", "json")]
        return {"files": [str(path) for path in files], "bytes": sum(path.stat().st_size for path in files)}

    def show(self, result: dict) -> None:
        out.print(f"wrote {' and '.join(result['files'])}, {result['bytes']:,} bytes")
