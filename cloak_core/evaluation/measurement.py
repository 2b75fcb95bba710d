"""The raw result of an evaluation: every image's draw and what every detector said, kept so that nothing is re-run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from cloak_core.evaluation.settings import EvaluateSettings
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_npz
from cloak_core.files.writing import write_npz

FORMAT = "cloak measurement 1"


@dataclass(frozen=True, eq=False)
class Trials:
    """What the N images of an evaluation show; every control is rendered into the same ones."""

    pose: Int64[np.ndarray, N]
    angle: Float32[np.ndarray, N]
    """Azimuth, degrees."""
    elevation: Float32[np.ndarray, N]
    """Degrees; nan in files of versions that had one for all images and did not say which."""
    distance: Float32[np.ndarray, N]
    """Metres."""
    background: Int64[np.ndarray, N]
    shift: Int64[np.ndarray, "N 2"]
    """Translation in the image, pixels right and down."""
    outfit: Int64[np.ndarray, N]

    def __len__(self) -> int:
        return len(self.pose)


def draw_trials(
    poses: int, angles: Sequence[float], backgrounds: int, outfits: int, settings: EvaluateSettings
) -> Trials:
    """Every pose at every angle (degrees), elevation and distance, several times (or, of these, `most_images` drawn by
    seed); background, shift and outfit drawn by seed.

    Backgrounds are dealt like cards from a shuffled deck, so all come about equally often.
    """
    rng = np.random.default_rng([settings.seed, 0xE7A1])
    places = (angles, settings.elevations or (settings.elevation,), settings.distances)
    axes = (np.arange(poses), *(np.asarray(values, np.float32) for values in places))
    grid = np.meshgrid(*axes, np.arange(settings.images_per_view), indexing="ij")
    kept = np.arange(grid[0].size)
    if settings.most_images is not None:
        order = np.random.default_rng([settings.seed, 0x3057]).permutation(len(kept))
        kept = np.sort(order[: settings.most_images])
    pose, angle, elevation, distance = (axis.ravel()[kept] for axis in grid[:4])
    count = len(pose)
    decks = [rng.permutation(backgrounds) for _ in range(-(-count // backgrounds))]
    return Trials(
        pose=pose.astype(np.int64),
        angle=angle,
        elevation=elevation,
        distance=distance,
        background=np.concatenate(decks)[:count].astype(np.int64),
        shift=rng.integers(-settings.shift, settings.shift + 1, (count, 2)),
        outfit=rng.integers(0, outfits, count),
    )


@dataclass(frozen=True, eq=False)
class Boxes:
    """Person boxes after non-maximum suppression, those of every detector, control and image in one long list; an
    image's stand together, the surest first."""

    detector: Int64[np.ndarray, K]
    control: Int64[np.ndarray, K]
    image: Int64[np.ndarray, K]
    score: Float32[np.ndarray, K]
    hit: Bool[np.ndarray, K]
    """The best box that overlaps the image's body (IoU at least 0.5); every other one is a false positive."""
    iou: Float64[np.ndarray, K]
    """With the image's true box; nan in files of versions that kept none."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """Scores of D detectors on N images under C controls (the first is the trained logo), and on M bare backgrounds."""

    specs: tuple[str, ...]
    controls: tuple[str, ...]
    body_names: tuple[str, ...]
    background_names: tuple[str, ...]
    trials: Trials
    score: Float32[np.ndarray, "D C N"]
    """The best person score anywhere in the image."""
    score_on: Float32[np.ndarray, "D C N"]
    """The best person score among boxes that overlap the rendered body (IoU with its true box at least 0.5)."""
    bare: Float32[np.ndarray, "D M"]
    """The best person score on backgrounds without any body."""
    boxes: Boxes

    def save(self, path: Path) -> None:
        """Write everything as one compressed .npz."""
        arrays = {"format": np.array(FORMAT)}
        for name in ("specs", "controls", "body_names", "background_names"):
            arrays[name] = np.array(getattr(self, name), np.str_)
        for name in ("score", "score_on", "bare"):
            arrays[name] = getattr(self, name)
        for name, part in (("trials", self.trials), ("boxes", self.boxes)):
            arrays |= {f"{name}_{f.name}": getattr(part, f.name) for f in fields(part)}
        write_npz(path, compressed=True, **arrays)


def read_measurement(path: Path) -> Measurement:
    """Read what `Measurement.save` wrote; InputError names a file that is something else."""
    arrays = read_npz(path)
    if str(arrays.get("format")) != FORMAT:
        raise InputError(f"{path}: not a {FORMAT}")
    try:
        unsaid = {"trials_elevation": np.full(len(arrays["trials_pose"]), np.nan, np.float32)}
        trials = Trials(**{f.name: (unsaid | arrays)[f"trials_{f.name}"] for f in fields(Trials)})
        unsaid = {"boxes_iou": np.full(len(arrays["boxes_score"]), np.nan)}
        boxes = Boxes(**{f.name: (unsaid | arrays)[f"boxes_{f.name}"] for f in fields(Boxes)})
        return Measurement(
            **{k: tuple(map(str, arrays[k])) for k in ("specs", "controls", "body_names", "background_names")},
            **{k: arrays[k] for k in ("score", "score_on", "bare")},
            trials=trials,
            boxes=boxes,
        )
    except KeyError as error:
        raise InputError(f"{path}: {error} is missing") from None
