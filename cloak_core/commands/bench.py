"""`cloak bench ...`: figures measured on this machine, written by the command that measured them.

The measurements that only developers of the rasterizer need stand in `benchmarks/`, in a checkout and in no wheel.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, UseAppendAction, arg

from cloak_core.commands.base import Command, err, out
from cloak_core.commands.options import DetectorOptions, Photographed, keep_freed_memory
from cloak_core.commands.progress import counted
from cloak_core.core.settings.values import Range
from cloak_core.core.visibility.settings import RenderOptions
from cloak_core.files.errors import InputError
from cloak_core.files.writing import require_new
from cloak_core.sources.bodies.opening import load_scene


@dataclass(kw_only=True)
class Bench(Command):
    """A command that measures; it shows the figures as --json has them."""

    def show(self, result: dict) -> None:
        for line in figures(result):
            out.print(line)


def figures(record: dict, indent: str = "") -> Iterator[str]:
    """Write a record's figures, one a line; those of a part below its name, further in."""
    flat = lambda row: ", ".join(f"{name} {_figure(value)}" for name, value in row.items())
    for name, value in record.items():
        if isinstance(value, list) and value and isinstance(value[0], dict):
            yield f"{indent}{name}"
            yield from (f"{indent}  {flat(row)}" for row in value)
        elif isinstance(value, dict) and any(isinstance(part, dict | list) for part in value.values()):
            yield f"{indent}{name}"
            yield from figures(value, f"{indent}  ")
        else:
            yield f"{indent}{name}: {flat(value) if isinstance(value, dict) else _figure(value)}"


def _figure(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def developers_benchmark(name: str) -> ModuleType:
    """Import a module of `benchmarks/`, which stands beside the package. InputError: there is none, as in a wheel."""
    checkout = Path(__file__).parents[2]
    if not (checkout / "benchmarks" / f"{name}.py").is_file():
        raise InputError(
            f"cloak bench {name}: runs in a checkout of Cloak alone; the installed package has no benchmarks"
        )
    if str(checkout) not in sys.path:
        sys.path.append(str(checkout))
    return importlib.import_module(f"benchmarks.{name}")


@dataclass(kw_only=True)
class Timed(Bench):
    """A command whose figures are medians of times."""

    threads: int = 2
    repeats: int = 20
    device: str = "cpu"


@dataclass(kw_only=True)
class Views(Timed):
    """Time visibility, a new view and a cached render, per view."""

    example = "--scene scene"
    then = "bench accuracy --scene {scene} --only bench"

    scene: Path
    samples: Literal[1, 4, 16, 64, "area"] | None = None
    """Samples per pixel, or coverage by area (default: 1, and all in short)."""

    def run(self) -> dict:
        from cloak_core.bench.views import run_bench_views

        return run_bench_views(**self.given(), tell=err.print)


@dataclass(kw_only=True)
class Step(Photographed, Timed):
    """Time a training step beside its floor, the detector alone on a ready batch."""

    example = "--detector builtin"

    detector: UseAppendAction[tuple[str, ...]] = ()
    """(default: builtin)"""
    scene: str = "sample:train"
    people: str | None = None
    backgrounds: str = "procedural:train"
    batch: int = 8
    """Images per update."""
    distance: Range = Range(2.2, 2.2)
    """Camera distance, metres; LOW:HIGH draws one per image."""
    rendering: Annotated[OmitArgPrefixes[RenderOptions], arg(name="rendering")] = field(default_factory=RenderOptions)
    out: Path | None = None
    """New CSV file for the table."""

    def run(self) -> dict:
        from cloak_core.bench.step import run_bench_step, write_table
        from cloak_core.core.settings import make_settings
        from cloak_core.detectors.loading import load_detector
        from cloak_core.sources.backdrops.backgrounds import load_backgrounds

        keep_freed_memory()
        people = self.cast()
        result = run_bench_step(
            load_scene(self.scene),
            [load_detector(spec, device=self.device) for spec in self.detector or ("builtin",)],
            load_backgrounds(self.backgrounds),
            settings=make_settings(
                people.preset(),
                batch=self.batch,
                distance=self.distance,
                device=self.device,
                **vars(self.rendering),
            ),
            people=people,
            threads=self.threads,
            repeats=self.repeats,
            tell=err.print,
        )
        if self.out is not None:
            write_table(result, self.out)
        return result

    def following(self, result: dict) -> tuple[str, ...]:
        return ("bench", "detectors", *_named(self.detector))


def _named(specs: Sequence[str]) -> list[str]:
    return [word for spec in specs or ("builtin",) for word in ("--detector", spec)]


@dataclass(kw_only=True)
class Detectors(Timed):
    """Time detectors as Cloak runs them beside the same models used naively."""

    example = "--detector builtin"

    detector: UseAppendAction[tuple[str, ...]] = ()
    """(default: builtin)"""
    batch: int = 4
    """Images that detectors see at once."""
    repeats: int = 9
    out: Path | None = None
    """New CSV file for the table."""
    options: Annotated[OmitArgPrefixes[DetectorOptions], arg(name="detectors")] = field(default_factory=DetectorOptions)

    def run(self) -> dict:
        from cloak_core.bench.detectors import run_bench_detectors, write_table

        if self.out is not None:
            require_new(self.out)
        how = self.given("detector", "out", "options") | self.options.arguments()
        result = run_bench_detectors(self.detector or ("builtin",), **how, tell=err.print)
        if self.out is not None:
            write_table(result, self.out, self.device)
        return result

    def following(self, result: dict) -> tuple[str, ...]:
        return ("bench", "step", *_named(self.detector))


@dataclass(kw_only=True)
class Accuracy(Bench):
    """Measure speed against error: every way to build a view, and installed peers."""

    example = "--scene sample --only bench"
    then = "bench growth --quick"

    scene: str
    only: UseAppendAction[tuple[str, ...]] = ()
    """Some of bench, distant, close-up, million, shell-5mm, shell-1mm, shell-0.1mm, garment, hair, cards, soup."""
    threads: int = 2
    repeats: int = 10
    out: Path | None = None
    """Folder for the figures; earlier ones stay beside these."""

    def run(self) -> dict:
        return developers_benchmark("accuracy").run_bench_accuracy(
            load_scene(self.scene), tell=err.print, **self.given("scene")
        )


@dataclass(kw_only=True)
class Growth(Photographed, Bench):
    """Measure how time and memory grow; exponents of at most 1.05 are the aim."""

    example = "--only triangles --quick"
    then = "bench stability"

    only: UseAppendAction[tuple[str, ...]] = ()
    """Some of triangles, views, pixels, samples, detectors, squares, people (which needs --people)."""
    people: str | None = None
    most: int | None = None
    """Leave out larger sizes than this."""
    quick: bool = False
    """Leave out the largest sizes."""
    threads: int = 2
    memory: float = 2.0
    """Budget for kept views, GiB."""
    out: Path | None = None
    """Folder for the figures; earlier ones stay beside these."""

    def run(self) -> dict:
        people = (self.people, self.images) if self.people else None
        more = {"only": self.only, "out": self.out, "people": people, "most": self.most}
        run = developers_benchmark("growth").run_bench_growth
        return run(self.threads, int(self.memory * 2**30), self.quick, tell=err.print, **more)


@dataclass(kw_only=True)
class Gpu(Photographed, Bench):
    """Measure on a CUDA device what only one can tell, in one record."""

    example = "--out gpu.json"

    scene: str | None = None
    """(default: a sphere of 55,000 triangles; first pose)"""
    out: Path | None = None
    """JSON file to write."""

    def run(self) -> dict:
        run = developers_benchmark("gpu").run_bench_gpu
        result = run(self.people, self.images, self.scene, self.out, tell=err.print)
        if result["failed"]:
            result["failed"] = "; ".join(f"{name}: {words}" for name, words in result["failed"].items())
        else:
            del result["failed"]
        return result

    def following(self, result: dict) -> tuple[str, ...]:
        return ("bench", "growth", "--quick") if result["measured"] else ("bench", "stability")


@dataclass(kw_only=True)
class Stability(Bench):
    """Check hard cases of visibility against exact integer arithmetic.

    Exit code 1 on any mismatch.
    """

    then = "bench accuracy --scene sample --only bench"

    def run(self) -> dict:
        from cloak_core.bench.stability import run_bench_stability

        with counted("checking", unit="cases") as tell:
            result = run_bench_stability(on_progress=tell)
        if result["mismatches"]:
            result["failed"] = f"{result['mismatches']} mismatches in {result['cases']} cases"
        return result
