"""Evaluate what people in photographs wear: a run's colours, or others on its logo, on `evaluate_renderer`'s path."""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluation.controls import CLOTHING, LOGO
from cloak_core.core.evaluation.measure import OnProgress, check_asked
from cloak_core.core.evaluation.settings import EvaluateSettings, WearSettings
from cloak_core.exchange.colors import read_colors
from cloak_core.exchange.face_lists import read_face_list
from cloak_core.exchange.profiles import Profile
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays, sha256_record
from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.sources.photographs.fits import fit_people, people_identity, those_who_fit
from cloak_core.sources.photographs.people import People, load_people
from cloak_core.sources.photographs.views import logo_positions
from cloak_core.studies.evaluate import check_folder, evaluate_renderer
from cloak_core.studies.printed_cloth import PrintedCloth
from cloak_core.studies.trained_run import photographs_seen_in_training, read_run, trained_against
from cloak_core.studies.wearing.clothes import CONTROLS, Clothes, LogoClothes, PictureClothes, clothes_of, read_clothes
from cloak_core.studies.wearing.renderer import PeopleRenderer
from cloak_core.studies.wearing.wearing import mean_quality
from cloak_core.zoo.entry import run_path

FOLDER = "evaluation-people"
"""Name of the folder inside a run."""
SETTINGS = ("size", "threshold", "bare", "resamples", "batch", "seed")
"""The evaluation settings that decide figures of photographs."""
_log = logging.getLogger("cloak")


@dataclass(frozen=True, eq=False)
class Dressed:
    """What is evaluated on photographs: people, what they wear, and backgrounds without people."""

    worn: Clothes
    """Called `LOGO`."""
    people: People
    backgrounds: Backgrounds
    position: Int64[np.ndarray, " T"]
    """Of the rig's triangles among the faces of the run's logo; -1 elsewhere."""
    faces: int
    """Of the run's logo."""

    def printed(self, profile: Profile) -> Dressed:
        """Wear the same as it comes out of this printer and camera."""
        worn = self.worn
        if isinstance(worn, PictureClothes):
            sent = profile.to_send(worn.picture.reshape(-1, 3) / 255)
            seen = np.round(255 * profile.photographed(sent).clip(0, 1)).astype(np.uint8)
            return replace(self, worn=replace(worn, picture=seen.reshape(worn.picture.shape)))
        return replace(self, worn=replace(worn, colors=profile.photographed(profile.to_send(worn.colors))))

    def in_colors(self, path: Path, cloth: PrintedCloth | None) -> Dressed:
        """Wear the colours of a file instead, or the cloth that they are of. InputError: another number of faces."""
        return replace(self, worn=clothes_of(LOGO, self.position, read_colors(path, self.faces), cloth))

    @property
    def identity(self) -> str:
        """SHA-256 (hex) of all that is shown: people, what they wear, the backgrounds."""
        worn = {name: sha256_arrays(np.asarray(value)) for name, value in vars(self.worn).items() if name != "name"}
        shown = [people_identity(self.people), worn, self.backgrounds.identities()]
        return sha256_record(shown)


def open_dressed(
    folder: Path,
    config: dict,
    people: People | str | os.PathLike,
    backgrounds: Backgrounds | str | os.PathLike | None = None,
    colors: str | os.PathLike | None = None,
) -> tuple[Dressed, dict | None, str]:
    """Open people in a run's colours, the config.json of the training of these (or None), and their name.

    colors: worn on the run's logo instead of the run's own, whose name is "": a .npy of colours [L, 3], another run,
    zoo:NAME, or a picture (FILE.png@tile=METRES, FILE.png@patch=METRES). InputError: what cannot be read or worn.
    """
    ids = np.asarray(read_face_list(folder / "logo.npy").ids, np.int64)
    position = logo_positions(config["topology"], ids)
    if colors is None:
        worn, trained, name = read_clothes(str(folder)), config, ""
    else:
        worn, trained, name = _other_clothes(colors, position, len(ids))
    people = people if isinstance(people, People) else load_people(people)
    if not isinstance(backgrounds, Backgrounds):
        backgrounds = load_backgrounds(backgrounds or "procedural:test")
    return Dressed(replace(worn, name=LOGO), people, backgrounds, position, len(ids)), trained, name


def _other_clothes(
    colors: str | os.PathLike, position: Int64[np.ndarray, " T"], faces: int
) -> tuple[Clothes, dict | None, str]:
    """Read what is worn on a logo instead of its own colours; see `open_dressed`."""
    path = run_path(colors)
    if path.suffix.lower() == ".npy":
        return LogoClothes(path.stem, position, read_colors(path, faces)), None, path.stem
    worn = read_clothes(str(path))
    if isinstance(worn, LogoClothes) and len(worn.colors) != faces:
        raise InputError(f"{colors}: colours for {len(worn.colors)} faces, but the logo has {faces}")
    return replace(worn, position=position), read_run(path) if path.is_dir() else None, worn.name


def evaluate_dressed(
    dressed: Dressed,
    detectors: dict[str, Detector],
    settings: EvaluateSettings | None = None,
    *,
    training: dict | None = None,
    out: Path | None = None,
    on_progress: OnProgress | None = None,
) -> dict:
    """Measure attack success on people in photographs as contract C9 puts it, with every control on the same people.

    As `evaluate` does on bodies; of the settings, `SETTINGS` and `controls` count. Beside C6's keys the summary has
    people, photographs, left_out, and fit (means over the people's fits).
    """
    settings = settings or EvaluateSettings()
    check_asked(detectors)
    if out is not None:
        check_folder(out)
    controls = _controls(settings)
    unseen, warnings = photographs_seen_in_training(training, dressed.people)
    for warning in warnings:
        _log.warning("%s", warning)
    fits, framing = fit_people(dressed.people), WearSettings(size=settings.size)
    device = next(iter(detectors.values())).device
    renderer = PeopleRenderer(fits, [dressed.worn], dressed.backgrounds, framing, device)
    shown = those_who_fit(dressed.people, fits)
    people = {"people": len(shown), "photographs": len(shown.photographs)}
    circumstances = people | {
        "left_out": shown.left_out,
        "fit": mean_quality(fits),
        "settings": {key: getattr(settings, key) for key in SETTINGS} | {"context": framing.context},
        "inputs": people | {"backgrounds": len(dressed.backgrounds), "identity": dressed.identity},
        "unseen": unseen,
        "white_box": trained_against(training, detectors),
        "warnings": warnings,
    }
    circumstances["settings"] |= {"controls": list(controls[1:])}
    more = {"controls": controls, "out": out, "on_progress": on_progress}
    return evaluate_renderer(renderer, detectors, settings, circumstances, **more)


def _controls(settings: EvaluateSettings) -> tuple[str, ...]:
    """List what is worn, the colours first; `resampled`, which says what dressing alone does, is among the controls."""
    absent = [control for control in settings.controls if control not in (CLOTHING, *CONTROLS)]
    if absent:
        raise InputError(f"--controls: {absent[0]}: people in photographs wear {', '.join((CLOTHING, *CONTROLS))}")
    resampled = ("resampled",) if settings.controls else ()
    return tuple(dict.fromkeys((LOGO, CLOTHING, *settings.controls, *resampled)))
