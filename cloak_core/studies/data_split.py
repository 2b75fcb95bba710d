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
from cloak_core.studies.trainings.run_record import scene_counts


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
        record = {
            "bodies": bodies_record(self.bodies),
            "unseen": bodies_record(self.unseen),
            "backgrounds": backgrounds_record(self.backgrounds),
            "unseen_backgrounds": backgrounds_record(self.unseen_backgrounds),
            "detectors": {spec: sha256_record(detector_record(d)) for spec, d in self.detectors.items()},
        }
        if self.people is not None:
            record["people"] = people_record(self.people)
        if self.unseen_people is not None:
            record["unseen_people"] = people_record(self.unseen_people)
        return record


def bodies_record(bodies: Bodies) -> dict:
    """Describe a scene: its name, its size and its content hash."""
    return scene_counts(bodies) | {"sha256": bodies.identity}


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
    if unseen_backgrounds is not None:
        behind = load_backgrounds(backgrounds), load_backgrounds(unseen_backgrounds)
    elif backgrounds == "procedural":
        behind = load_backgrounds("procedural:train"), load_backgrounds("procedural:test")
    else:
        every = load_backgrounds(backgrounds)
        if len(every) < 2:
            raise InputError(f"{backgrounds}: one background cannot be both trained on and unseen")
        behind = every.split(2, 0), every.split(2, 1)
    halves = () if people is None else people.halves()
    return DataSplit(*_open_bodies(scene, unseen), *behind, detectors, *halves)


def _open_bodies(scene: str, unseen: str | None) -> tuple[Bodies, Bodies]:
    if unseen is not None:
        return load_scene(scene), load_scene(unseen)
    if scene in EMBEDDED:
        trained = load_scene(f"{scene}:train")
        tested = load_scene(f"{scene}:unseen")
    else:
        bodies = load_scene(scene)
        if bodies.pose_count < 2:
            raise InputError(f"{scene}: one body cannot be both trained on and unseen; name other bodies with --unseen")
        trained = bodies.select_poses(range(0, bodies.pose_count, 2))
        tested = bodies.select_poses(range(1, bodies.pose_count, 2))
    return _every_second_outfit(trained, 0), _every_second_outfit(tested, 1)


def _every_second_outfit(bodies: Bodies, first: int) -> Bodies:
    """Keep every second outfit, beginning with number `first`; a single outfit stays."""
    if bodies.outfit_count == 1:
        return bodies
    textures = bodies.outfit_textures[first::2]
    return replace(
        bodies, face_colors=bodies.face_colors[first::2], outfit_textures=textures, recorded_topology=bodies.topology
    )
