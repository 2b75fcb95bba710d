"""Bodies, backgrounds and detectors of an experiment, split into what training sees and what only judges."""

from __future__ import annotations

from dataclasses import dataclass, replace

from cloak_core.core.detector.protocol import Detector, detector_record
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record
from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.photographs.fits import people_identity
from cloak_core.sources.photographs.people import People
from cloak_core.studies.trained_run import EMBEDDED


@dataclass(frozen=True, eq=False)
class DataSplit:
    """Bodies of one topology and backgrounds, for training and unseen; detectors by their specs."""

    bodies: Bodies
    unseen: Bodies
    backgrounds: Backgrounds
    unseen_backgrounds: Backgrounds
    detectors: dict[str, Detector]
    people: People | None = None
    """In photographs: where there are any, training sees them beside the bodies, and `unseen_people` judge."""
    unseen_people: People | None = None

    def __post_init__(self) -> None:
        if self.bodies.topology != self.unseen.topology:
            raise InputError(
                f"scene '{self.unseen.name}': topology {self.unseen.topology}, but training has {self.bodies.topology}"
            )
        if not self.detectors:
            raise InputError("--detector: none given")

    def record(self) -> dict:
        """Describe the split for a configuration: names, counts and content hashes."""
        parts = {"people": self.people, "unseen_people": self.unseen_people}
        return {
            "bodies": bodies_record(self.bodies),
            "unseen": bodies_record(self.unseen),
            "backgrounds": backgrounds_record(self.backgrounds),
            "unseen_backgrounds": backgrounds_record(self.unseen_backgrounds),
            "detectors": {spec: sha256_record(detector_record(d)) for spec, d in self.detectors.items()},
        } | {name: people_record(part) for name, part in parts.items() if part is not None}


def bodies_record(bodies: Bodies) -> dict:
    """Describe a scene: its name, its size and its content hash."""
    return {
        "name": bodies.name,
        "poses": list(bodies.names),
        "outfits": bodies.outfit_count,
        "faces": bodies.face_count,
        "sha256": bodies.identity,
    }


def backgrounds_record(backgrounds: Backgrounds) -> dict:
    """Describe backgrounds: their count and their content hash."""
    return {"count": len(backgrounds), "sha256": sha256_record(backgrounds.identities())}


def people_record(people: People) -> dict:
    """Describe people in photographs: their numbers and the content hash."""
    return {"count": len(people), "photographs": len(people.photographs), "sha256": people_identity(people)}


def open_data_split(
    detectors: dict[str, Detector],
    *,
    scene: str = "sample",
    unseen: str | None = None,
    backgrounds: str = "procedural",
    unseen_backgrounds: str | None = None,
    people: People | None = None,
) -> DataSplit:
    """Open scenes and backgrounds by spec and split them for these detectors.

    Without `unseen`, every second body of `scene` and every second outfit is kept from training; without
    `unseen_backgrounds`, every second background; of `people` in photographs, those of every second photograph.
    Embedded scenes and backgrounds have unseen parts of their own.
    InputError: there is only one body or background to split.
    """
    bodies = _open_bodies(scene, unseen)
    halves = () if people is None else people.halves()
    return DataSplit(*bodies, *_open_backgrounds(backgrounds, unseen_backgrounds), detectors, *halves)


def _open_bodies(scene: str, unseen: str | None) -> tuple[Bodies, Bodies]:
    if unseen is not None:
        return load_scene(scene), load_scene(unseen)
    if scene in EMBEDDED:
        parts = (load_scene(f"{scene}:train"), load_scene(f"{scene}:unseen"))
    else:
        bodies = load_scene(scene)
        if bodies.pose_count < 2:
            raise InputError(f"{scene}: one body cannot be both trained on and unseen; name other bodies with --unseen")
        parts = (bodies.select_poses(range(first, bodies.pose_count, 2)) for first in (0, 1))
    trained, tested = parts
    return _every_second_outfit(trained, 0), _every_second_outfit(tested, 1)


def _every_second_outfit(bodies: Bodies, first: int) -> Bodies:
    """Keep every second outfit, beginning with number `first`; a single outfit stays."""
    if bodies.outfit_count == 1:
        return bodies
    textures = bodies.outfit_textures[first::2]
    return replace(
        bodies, face_colors=bodies.face_colors[first::2], outfit_textures=textures, recorded_topology=bodies.topology
    )


def _open_backgrounds(spec: str, unseen: str | None) -> tuple[Backgrounds, Backgrounds]:
    if unseen is not None:
        return load_backgrounds(spec), load_backgrounds(unseen)
    if spec == "procedural":
        return load_backgrounds("procedural:train"), load_backgrounds("procedural:test")
    backgrounds = load_backgrounds(spec)
    if len(backgrounds) < 2:
        raise InputError(f"{spec}: one background cannot be both trained on and unseen")
    return backgrounds.split(2, 0), backgrounds.split(2, 1)
