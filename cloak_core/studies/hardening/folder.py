"""The folder of one hardening: who writes into it, and what it was begun with.

config.json  events.jsonl  checkpoint/  hardened.* (files of the detector's family)  hardened.licence.txt  cancel
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from cloak_core import __version__
from cloak_core.core.detector.protocol import detector_record
from cloak_core.core.loop import LoopFolder
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_json
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.photographs.fits import people_identity
from cloak_core.sources.photographs.people import People
from cloak_core.studies.hardening.settings import HardenSettings
from cloak_core.studies.hardening.student import Student
from cloak_core.studies.trainings.run_record import environment

FORMAT, EARLIER = "cloak hardening 4", ("cloak hardening 1", "cloak hardening 2", "cloak hardening 3")
"""EARLIER drew other cloaks, with which their checkpoints do not go on."""
FREE = ("max_seconds", "checkpoint_every")
"""Settings that a hardening may be resumed with otherwise."""


@dataclass(frozen=True, eq=False)
class Material:
    """What a detector is hardened on."""

    bodies: Bodies
    backgrounds: Backgrounds
    photographs: Backgrounds | None = None
    """Pictures of which the detector is to report what it reported; no labels."""
    people: People | None = None
    """Those who can be dressed; in cloaks they are to be reported as in their own clothes."""


class HardenFolder(LoopFolder):
    """Paths of a hardening. Make one with `open_folder`."""

    work = "hardening"


def harden_config(settings: HardenSettings, student: Student, material: Material) -> dict:
    """config.json: what decides the result, and where it ran."""
    bodies, photographs, people = material.bodies, material.photographs, material.people
    return {
        "format": FORMAT,
        "cloak": __version__,
        "settings": asdict(settings),
        "detector": {"spec": student.spec} | detector_record(student.teacher),
        "scene": {"name": bodies.name, "poses": list(bodies.names), "identity": bodies.identity},
        "backgrounds": sha256_record(material.backgrounds.identities()),
        "photographs": None if photographs is None else sha256_record(photographs.identities()),
        "people": None if people is None else people_identity(people),
        "environment": environment(),
    }


@contextlib.contextmanager
def open_folder(path: Path, config: dict, resume: bool) -> Iterator[HardenFolder]:
    """Make the folder, or open it to resume; nobody else hardens in it until the block ends.

    InputError: see `LoopFolder.opened`; it was begun with something else, which is named.
    """
    folder = HardenFolder(path)
    start = lambda new: write_json(new / "config.json", config)
    with folder.opened(resume, start, lambda: _check(read_json(folder.config), config, path)):
        yield folder


def _check(recorded: dict, config: dict, path: Path) -> None:
    if recorded.get("format") in EARLIER:
        raise InputError(f"{path}: was begun by an earlier version, which drew other cloaks; begin in another --out")
    if recorded.get("format") != FORMAT:
        raise InputError(f"{path}: not a folder of cloak harden")
    before, now = (
        {f"--{name.replace('_', '-')}": value for name, value in c["settings"].items() if name not in FREE}
        | {"bodies (--scene)": c["scene"]["identity"], "weights of the detector": c["detector"]["sha256"]}
        | {name: _digest(c.get(name)) for name in ("backgrounds", "photographs", "people")}
        for c in (recorded, config)
    )
    for name, value in now.items():
        if before.get(name) != value:
            words = f" = {before.get(name)}, not {value}" if name.startswith("--") else ""
            raise InputError(f"{path}: was begun with other {name}{words}; resume with the same")


def _digest(value: object) -> object:
    """Earlier records list what later ones hash."""
    return sha256_record(value) if isinstance(value, list) else value
