"""`cloak train`: colours for a logo, against one or several detectors."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from pathlib import Path

import tyro
from tyro.conf import OmitArgPrefixes, UseAppendAction

from cloak_core.attack.settings import PRESETS, TrainSettings, make_settings
from cloak_core.commands.base import RANK, Command, Stopped, open_scene, out
from cloak_core.commands.detector_options import DetectorOptions
from cloak_core.commands.progress import TrainingProgress
from cloak_core.commands.tensorboard import TensorBoardEvents
from cloak_core.exchange.face_lists import face_ids, read_face_list
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_toml

DEFAULT_PRESET = "best"


@dataclass(kw_only=True)
class Train(Command):
    """Train a logo's face colours until detectors no longer report the rendered person.

    Ctrl-C, or a file named `cancel` in the run folder, ends the run after the current step with everything in place
    (exit code 3); the same command with --resume goes on from there.
    """

    scene: str
    """Bodies to train on: scene folder, .npz, or sample[:train]."""
    logo: Path
    """Face list (.npy), from Blender or `cloak logo`."""
    detector: UseAppendAction[tuple[str, ...]] = ()
    """What to hide from: builtin, darknet:CFG:WEIGHTS[@SIZE], python:FILE.py:FUNCTION ... (default: builtin)."""
    backgrounds: str = "procedural:train"
    """Folder of images without people, or procedural[:train|test][:COUNT[:SEED]]."""
    out: Path
    """Run folder to write; a new one unless --resume."""
    resume: bool = False
    """Go on with the run in --out from its last checkpoint."""
    config: Path | None = None
    """TOML file of settings (the options below, without dashes); options given here win."""
    tensorboard: bool = False
    """Write TensorBoard's files into RUN/tensorboard as well (extra `tensorboard`)."""
    options: OmitArgPrefixes[DetectorOptions] = field(default_factory=DetectorOptions)
    settings: OmitArgPrefixes[TrainSettings] = field(default_factory=lambda: make_settings(DEFAULT_PRESET))

    @classmethod
    def default(cls, arguments: list[str]) -> Train:
        """What the options default to: the preset, then the TOML file, both looked up before the rest is parsed."""
        changes: dict = {}
        config = _value_of("--config", arguments)
        if config is not None:
            changes = {key.replace("-", "_"): value for key, value in read_toml(Path(config)).items()}
        in_file = changes.pop("preset", DEFAULT_PRESET)
        preset = _value_of("--preset", arguments) or in_file
        # --steps and --epochs replace each other, whichever of them the preset has.
        for given, replaced in (("--steps", "epochs"), ("--epochs", "steps")):
            if _value_of(given, arguments) is not None:
                changes |= {given[2:]: 1, replaced: None}
        missing = dict.fromkeys(("scene", "logo", "out"), tyro.MISSING)
        return cls(**missing, settings=make_settings(preset, **changes))

    def run(self) -> dict:
        from cloak_core.attack.training import train
        from cloak_core.scene.backdrops.backgrounds import open_backgrounds
        from cloak_core.scene.logos.logo import make_logo

        settings = self.settings
        listeners = [TrainingProgress(silent=bool(RANK))]
        if self.tensorboard and not RANK:
            listeners.append(TensorBoardEvents(self.out))
        # Of several processes (torchrun) the first one writes, and may have begun to; training itself checks again.
        if self.out.exists() and not self.resume and not RANK:
            raise InputError(f"{self.out}: exists already (continue that run with --resume, or name another folder)")
        bodies = open_scene(self.scene)
        logo = make_logo(bodies, face_ids(read_face_list(self.logo, bodies), bodies))
        specs = self.detector or ("builtin",)
        detectors = self.options.load(specs, settings.device)
        backgrounds = open_backgrounds(self.backgrounds)
        inputs = {"scene": self.scene, "logo": str(self.logo), "backgrounds": self.backgrounds}
        with contextlib.ExitStack() as stack:
            for listener in listeners:
                stack.enter_context(listener)
            result = train(
                settings,
                bodies,
                logo,
                detectors,
                backgrounds,
                self.out,
                resume=self.resume,
                on_event=lambda event: [listener(event) for listener in listeners],
                inputs=inputs,
            )
        return result.record()

    def show(self, result: dict) -> None:
        words = f", loss {result['loss']:.4f}" if "loss" in result else ""
        words += f", {result['enough']}" if "enough" in result else ""
        if result["colors_step"] != result["step"]:
            words += f"; the colours are those of step {result['colors_step']}"
        if not RANK:
            out.print(f"wrote {result['out']}: step {result['step']}{words}")
        if result.get("stopped"):
            raise Stopped(result["stopped"])


def _value_of(flag: str, arguments: list[str]) -> str | None:
    for at, argument in enumerate(arguments):
        if argument == flag and at + 1 < len(arguments):
            return arguments[at + 1]
        if argument.startswith(flag + "="):
            return argument[len(flag) + 1 :]
    return None


assert DEFAULT_PRESET in PRESETS
