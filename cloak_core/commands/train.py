"""`cloak train`: colours for a logo, against one or several detectors."""

from __future__ import annotations

import os
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import tyro
from tyro.conf import OmitArgPrefixes, UseAppendAction

from cloak_core.attack.settings import PRESETS, TrainSettings, make_settings
from cloak_core.commands.base import Command, Stopped, open_scene, out
from cloak_core.commands.detector_options import DetectorOptions
from cloak_core.commands.progress import TrainingProgress
from cloak_core.errors import InputError
from cloak_core.scene.exchange import face_ids, read_face_list

DEFAULT_PRESET = "best"
RANK = int(os.environ.get("RANK", 0))
"""Which of torchrun's processes this is; one alone is 0."""


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
    options: OmitArgPrefixes[DetectorOptions] = field(default_factory=DetectorOptions)
    settings: OmitArgPrefixes[TrainSettings] = field(default_factory=lambda: make_settings(DEFAULT_PRESET))

    @classmethod
    def default(cls, arguments: list[str]) -> Train:
        """What the options default to: the preset, then the TOML file, both looked up before the rest is parsed."""
        changes: dict = {}
        config = _value_of("--config", arguments)
        if config is not None:
            changes = _read_toml(Path(config))
        preset = _value_of("--preset", arguments) or changes.pop("preset", DEFAULT_PRESET)
        # --steps and --epochs replace each other, whichever of them the preset has.
        for given, replaced in (("--steps", "epochs"), ("--epochs", "steps")):
            if _value_of(given, arguments) is not None:
                changes |= {given[2:]: 1, replaced: None}
        missing = dict.fromkeys(("scene", "logo", "out"), tyro.MISSING)
        return cls(**missing, settings=make_settings(preset, **changes))

    def run(self) -> dict:
        from cloak_core.attack.training import train
        from cloak_core.scene.backgrounds import open_backgrounds
        from cloak_core.scene.logo import make_logo

        settings = self.settings
        # Of several processes (torchrun) the first one writes, and may have begun to; training itself checks again.
        if self.out.exists() and not self.resume and not RANK:
            raise InputError(f"{self.out}: exists already (continue that run with --resume, or name another folder)")
        bodies = open_scene(self.scene)
        logo = make_logo(bodies, face_ids(read_face_list(self.logo, bodies), bodies))
        specs = self.detector or ("builtin",)
        detectors = self.options.load(specs, settings.device)
        backgrounds = open_backgrounds(self.backgrounds)
        inputs = {"scene": self.scene, "logo": str(self.logo), "backgrounds": self.backgrounds}
        with TrainingProgress(silent=bool(RANK)) as progress:
            result = train(
                settings,
                bodies,
                logo,
                detectors,
                backgrounds,
                self.out,
                resume=self.resume,
                on_event=progress,
                inputs=inputs,
            )
        return result.record()

    def show(self, result: dict) -> None:
        loss = f", loss {result['loss']:.4f}" if "loss" in result else ""
        if not RANK:
            out.print(f"wrote {result['out']}: step {result['step']}{loss}", markup=False)
        if result.get("stopped"):
            raise Stopped(result["stopped"])


def _value_of(flag: str, arguments: list[str]) -> str | None:
    for at, argument in enumerate(arguments):
        if argument == flag and at + 1 < len(arguments):
            return arguments[at + 1]
        if argument.startswith(flag + "="):
            return argument[len(flag) + 1 :]
    return None


def _read_toml(path: Path) -> dict:
    try:
        return {key.replace("-", "_"): value for key, value in tomllib.loads(path.read_text("utf-8")).items()}
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid TOML ({error})") from None


assert DEFAULT_PRESET in PRESETS
