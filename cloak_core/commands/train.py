"""`cloak train`: colours for a logo, against one or several detectors."""

from __future__ import annotations

import contextlib
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import OmitArgPrefixes, UseAppendAction, arg

from cloak_core.commands.base import RANK, out, warn
from cloak_core.commands.loggers import LOGGERS, Log
from cloak_core.commands.options import Detecting, Photographed
from cloak_core.commands.progress import TrainingProgress
from cloak_core.core.settings import COMPONENTS, PRESETS, Preset, TrainSettings, components_from_record, merge
from cloak_core.core.settings.components import (
    AugmentationSettings,
    ComputeSettings,
    LossSettings,
    OptimizerSettings,
    PatternSettings,
    PeopleSettings,
    QuerySettings,
    RunSettings,
    SurrogateSettings,
    ViewSettings,
)
from cloak_core.files.errors import InputError, Stopped
from cloak_core.files.reading import read_json, read_toml
from cloak_core.files.specs import reach
from cloak_core.files.writing import is_taken, new_folder, write_json, written


@dataclass(kw_only=True)
class Train(Photographed, Detecting):
    """Train a logo's face colours until detectors no longer report the person.

    Ctrl-C, or a file `cancel` in the run folder, stops the run (exit code 3); --resume goes on from there.
    """

    example = "--scene sample:train --logo chest+thighs --detector builtin --out runs/first"
    common = (
        *("scene", "people", "images", "logo", "detector", "backgrounds", "out"),
        *("preset", "config", "resume", "extend", "init"),
        *("steps", "batch", "max-seconds", "angles", "size", "hide", "seed", "device", "threads", "json"),
    )

    scene: str | None = None
    """(default: sample:train without --people)"""
    people: str | None = None
    logo: Path
    detector: UseAppendAction[tuple[str, ...]] = ()
    """(default: builtin)"""
    query_prior: UseAppendAction[tuple[str, ...]] = ()
    """With --black-box-queries: surrogate whose gradients lead the search."""
    technique: UseAppendAction[tuple[str, ...]] = ()
    """Technique of another package, NAME or NAME:TEXT (entry points cloak.techniques): runs its code."""
    backgrounds: str = "procedural:train"
    made_from: str | None = None
    """Scene that --scene was copied from, so that evaluation knows which bodies are unseen."""
    out: Path
    """New folder to write, or the one to --resume."""
    resume: bool = False
    extend: int | None = None
    """Continue the run in --out for this many more updates, as a new run, RUN-STEPS."""
    config: Path | None = None
    """TOML file of settings, named as the options; those on the command line win."""
    log: UseAppendAction[tuple[Log, ...]] = ()
    """Also log to tensorboard (RUN/tensorboard), mlflow or wandb; each is an extra."""
    preset: Preset = "best"
    """Settings to start from: paper (its text), reference (its code), best (these detectors), transfer (others, from
    several), photographs (the default with --people)."""
    length: Annotated[OmitArgPrefixes[RunSettings], arg(name="the run")]
    views: Annotated[OmitArgPrefixes[ViewSettings], arg(name="views")]
    augmentation: Annotated[OmitArgPrefixes[AugmentationSettings], arg(name="augmentation")]
    photographs: Annotated[OmitArgPrefixes[PeopleSettings], arg(name="photographs of people")]
    objective: Annotated[OmitArgPrefixes[LossSettings], arg(name="loss")]
    pattern: Annotated[OmitArgPrefixes[PatternSettings], arg(name="colours and pattern")]
    surrogates: Annotated[OmitArgPrefixes[SurrogateSettings], arg(name="surrogates")]
    optimization: Annotated[OmitArgPrefixes[OptimizerSettings], arg(name="optimiser")]
    queries: Annotated[OmitArgPrefixes[QuerySettings], arg(name="black box")]
    compute: Annotated[OmitArgPrefixes[ComputeSettings], arg(name="computing")]

    @classmethod
    def default(cls, arguments: list[str]) -> Train:
        """Find what the options default to: the preset, as it was when a resumed run began, then the TOML file.

        Not checked before the options replace them.
        """
        preset, config = _value_of("preset", arguments), _value_of("config", arguments)
        if preset is None and config is None and _value_of("people", arguments) is not None:
            preset = "photographs"
        # Any number: the option itself replaces it. Of --steps and --epochs the one that is given counts.
        overrides: dict = {name: 1 for name in ("steps", "epochs") if _value_of(name, arguments) is not None}
        overrides |= {"preset": preset} if preset in PRESETS else {}
        in_file = {} if config is None else read_toml(Path(config))
        begun = _as_begun(arguments, str(overrides.get("preset", in_file.get("preset", "best"))))
        try:
            settings = components_from_record(
                merge({"device": "auto"}, begun, {k.replace("-", "_"): v for k, v in in_file.items()}, overrides)
            )
        except InputError as error:
            raise InputError(f"{config or 'the run'}: {error}") from None
        settings["length"] = settings.pop("run")
        return cls(**dict.fromkeys(("logo", "out"), tyro.MISSING), **settings)

    @classmethod
    def of(cls, settings: TrainSettings, **inputs: object) -> Train:
        """Make the command that trains with these settings; `inputs` are the other options, by name."""
        parts = dict(vars(settings))
        return cls(length=parts.pop("run"), **parts, **inputs)

    @property
    def settings(self) -> TrainSettings:
        """All of them together. InputError: they are out of bounds, or do not go together."""
        parts = {name: getattr(self, name) for name in COMPONENTS if name != "run"}
        return TrainSettings(preset=self.preset, run=self.length, **parts)

    def run(self) -> dict:
        from cloak_core.library.training import train

        _ = self.settings  # checked before anything is done
        if self.extend is not None:
            self._extend()
        if self.resume and self.compute.device == "auto" and _begun_on_the_cpu(self.out):
            self.compute = replace(self.compute, device="cpu")
        self.prepare()
        settings = self.settings
        scene = self.scene or (None if self.people else "sample:train")
        listeners = [TrainingProgress(silent=bool(RANK))]
        listeners += [] if RANK else [LOGGERS[name](self.out) for name in dict.fromkeys(self.log)]
        # Of several processes (torchrun) the first one writes, and may have begun to; training itself checks again.
        if is_taken(self.out) and not self.resume and not RANK:
            raise InputError(f"{self.out}: exists already (continue that run with --resume, or name another folder)")
        if self.preset == "transfer" and len(self.detector) < 2 and not RANK:
            warn(
                "--preset transfer: reaches more detectors through several surrogates; name more than one --detector, "
                "or take colours that were trained on several (cloak zoo list)"
            )
        people = self.load_people()
        detectors = [self.load(spec) for spec in self.detector or ("builtin",)]
        noted = {"made_from": self.made_from, "people": self.people}
        with contextlib.ExitStack() as stack:
            for listener in listeners:
                stack.enter_context(listener)
            result = train(
                scene,
                self.logo,
                detectors,
                self.backgrounds,
                out=self.out,
                settings=settings,
                resume=self.resume,
                on_event=lambda event: [listener(event) for listener in listeners],
                inputs={key: str(value) for key, value in noted.items() if value},
                query_prior=[self.load(spec) for spec in self.query_prior],
                people=people,
                techniques=self.technique,
            )
        return result.record()

    def _extend(self) -> None:
        """Go on in a copy of the run that asks for more steps."""
        if self.resume:
            raise InputError("--extend, --resume: a run that is extended is resumed by the same command with --extend")
        self.out, steps = extended(self.out, self.extend)
        self.length, self.resume = replace(self.length, steps=steps, epochs=None), True

    def show(self, result: dict) -> None:
        words = f", loss {result['loss']:.4f}" if "loss" in result else ""
        if not RANK:
            out.print(f"wrote {result['out']}: step {result['step']}{words}")
        if "queries" in result and not RANK:
            shares = ", ".join(f"{success:.2f} at {queries}" for queries, success in result["curve"])
            out.print(f"{result['queries']} images asked; success on each round's new images: {shares}")
        if result.get("stopped"):
            more = "" if self.extend is not None else " with --resume"
            raise Stopped(f"{result['stopped']}; the same command{more} goes on")

    @property
    def next_why(self) -> str:
        """What evaluation is good for; with people, who they must be where the command cannot name them."""
        if self.people and _other_people(self.people) is None:
            return f"{OTHERS}: people that were not trained on"
        return "on what training never saw"

    def following(self, result: dict) -> tuple[str, ...]:
        judged = ("--people", _other_people(self.people) or OTHERS) if self.people else ()
        judged += ("--images", str(self.images)) if self.people and self.images else ()
        named = [word for spec in self.detector if reach(spec) for word in ("--detector", spec)]
        return ("evaluate", result["out"], *judged, *named)


KEPT = (
    *("material.npz", "logo.npy", "logo.json", "colors.npy", "cloth.png", "events.jsonl"),
    *("checkpoint", "previews", "snapshots"),
)
"""Of a run: what training wrote; what was made of it is made again."""


def extended(run: Path, updates: int) -> tuple[Path, int]:
    """Copy a run into RUN-STEPS, its settings asking for `updates` more; return that folder and STEPS.

    Where it is there already, from an earlier --extend, it is the one that goes on. InputError: no run, or none that
    has a checkpoint; no update more.
    """
    if updates < 1:
        raise InputError(f"--extend {updates}: some updates more are needed")
    if not (run / "config.json").is_file():
        raise InputError(f"{run}: no run to extend (--out names the one that is complete)")
    from cloak_core.core.checkpoints import load_checkpoint

    checkpoint, _ = load_checkpoint(run / "checkpoint")
    if checkpoint is None:
        raise InputError(f"{run}: has no checkpoint to go on from")
    steps = checkpoint.step + updates
    out = run.with_name(f"{run.name}-{steps}")
    if not out.exists():
        config = read_json(run / "config.json")
        config["settings"] = config["settings"] | {"steps": steps, "epochs": None}
        with new_folder(out) as folder, written(folder):
            for part in KEPT:
                if (run / part).is_dir():
                    shutil.copytree(run / part, folder / part)
                elif (run / part).is_file():
                    shutil.copy(run / part, folder / part)
            write_json(folder / "config.json", config)
    return out, steps


OTHERS = "OTHERS.json"
"""Stands for people who were not trained on, where all of a file were."""
_OTHER_HALF = {"0::2": "1::2", "::2": "1::2", "1::2": "0::2"}


def _other_people(people: str) -> str | None:
    """Name the photographs that `people` leaves out of its file, where they can be told from it; None: nobody."""
    from cloak_core.files.specs import split_selection

    file, selection = split_selection(people)
    return f"{file}[{_OTHER_HALF[selection]}]" if selection in _OTHER_HALF else None


def _begun_on_the_cpu(run: Path) -> bool:
    """Tell whether a run was begun on the CPU: it goes on there, also where there is a GPU by now."""
    recorded = run / "config.json"
    environment = read_json(recorded).get("environment") if recorded.is_file() else None
    return isinstance(environment, dict) and environment.get("device") == "cpu"


def _as_begun(arguments: list[str], preset: str) -> dict[str, object]:
    """Read what `preset` stood for when the run that is resumed began: it may be another in this version."""
    recorded = Path(_value_of("out", arguments) or "") / "config.json"
    goes_on = "--resume" in arguments or _value_of("extend", arguments) is not None
    if not goes_on or preset not in PRESETS or not recorded.is_file():
        return {}
    config = read_json(recorded)
    settings = config.get("settings") if isinstance(config, dict) else None
    if not isinstance(settings, dict) or settings.get("preset") != preset:
        return {}
    return {name: settings[name] for name in PRESETS[preset] if name in settings}


def _value_of(name: str, arguments: list[str]) -> str | None:
    """Find what the last --NAME in the arguments was given."""
    value = None
    for argument, following in zip(arguments, [*arguments, None][1:], strict=True):
        if argument == f"--{name}":
            value = following
        elif argument.startswith(f"--{name}="):
            value = argument.partition("=")[2]
    return value
