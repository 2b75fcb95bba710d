"""Pose sequences for SMPL models: AMASS .npz, SURREAL _info.mat, rows of numbers in .npy or .csv."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cloak_core.files.errors import InputError, first_line
from cloak_core.files.reading import read_bytes, read_npy, read_npz

BODY_JOINTS = 22
"""Joints that SMPL (24), SMPL+H (52) and SMPL-X (55) have in common, from the root on."""
HANDS_FROM = {52: 22, 55: 25}
"""Where the 30 finger joints begin in models that have them."""
SHAPES = 10
MAX_POSES = 10_000_000
MAX_POSE_BYTES = 64 << 20
"""Of a table of poses as text or .mat."""


@dataclass(frozen=True, eq=False)
class PoseSequence:
    """P poses: axis-angle [P, 3 J] radians, betas [P, S], translation [P, 3] metres, and which axis is up; float64."""

    poses: np.ndarray
    betas: np.ndarray
    translation: np.ndarray
    up: str = "y"


def read_poses(path: Path, joint_count: int) -> PoseSequence:
    """Read poses for a model of `joint_count` joints.

    .npz: AMASS, `poses` [P, 3 J'] with optional `betas` [S] or [P, S] and `trans` [P, 3]; z is up there.
    .mat: SURREAL's _info files, `pose` [72, P] and `shape` [10, P].
    .npy, .csv: a row per pose, the joints' numbers and then any number of betas, usually 72 + 10.
    A sequence for another model of the family keeps the body's 22 joints, and the fingers where both have them.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file of poses")
    readers = {".npz": read_amass, ".mat": read_surreal, ".npy": read_rows, ".csv": read_rows}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path}: poses are read from {', '.join(readers)}")
    read = reader(path, 3 * joint_count)
    poses = convert_joints(path, read.poses, joint_count)
    betas = read.betas
    if len(betas) == 1:
        betas = np.broadcast_to(betas, (len(poses), betas.shape[1]))
    for name, values in {"poses": poses, "betas": betas, "translation": read.translation}.items():
        if len(values) != len(poses):
            raise InputError(f"{path}: {len(values)} {name} for {len(poses)} poses")
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
            raise InputError(f"{path}: {name} of pose {row} are not finite")
    if not 0 < len(poses) <= MAX_POSES:
        raise InputError(f"{path}: {len(poses)} poses")
    return PoseSequence(
        poses.astype(np.float64), betas.astype(np.float64), read.translation.astype(np.float64), read.up
    )


def read_amass(path: Path, width: int) -> PoseSequence:
    arrays = read_npz(path)
    poses = numbers(path, "poses", arrays.get("poses"))
    betas = np.atleast_2d(numbers(path, "betas", arrays.get("betas", np.zeros((1, SHAPES))), ranks=(1, 2)))
    translation = numbers(path, "trans", arrays.get("trans", np.zeros((len(poses), 3))))
    if translation.shape != (len(poses), 3):
        raise InputError(f"{path}: trans is {translation.shape}, not ({len(poses)}, 3)")
    return PoseSequence(poses, betas, translation, up="z")


def read_surreal(path: Path, width: int) -> PoseSequence:
    from scipy.io import loadmat

    data = read_bytes(path, MAX_POSE_BYTES)
    try:
        arrays = loadmat(io.BytesIO(data), variable_names=["pose", "shape"])
    except Exception as error:  # scipy raises whatever a damaged file leads it into
        raise InputError(f"{path}: not a readable .mat file ({type(error).__name__}: {error})") from None
    pose, shape = (numbers(path, name, arrays.get(name)) for name in ("pose", "shape"))
    return PoseSequence(pose.T, shape.T, np.zeros((pose.shape[1], 3)))


def read_rows(path: Path, width: int) -> PoseSequence:
    if path.suffix.lower() == ".npy":
        rows = np.atleast_2d(numbers(path, "rows", read_npy(path), ranks=(1, 2)))
    else:
        data = read_bytes(path, MAX_POSE_BYTES)
        try:
            rows = np.loadtxt(io.BytesIO(data), delimiter=",", ndmin=2, comments="#")
        except ValueError as error:
            raise InputError(f"{path}: {first_line(error)}") from None
    if rows.shape[1] < width:
        joints = width // 3
        raise InputError(f"{path}: rows of {rows.shape[1]} numbers, but {joints} joints need {width} (and betas)")
    betas = rows[:, width:] if rows.shape[1] > width else np.zeros((1, SHAPES))
    return PoseSequence(rows[:, :width], betas, np.zeros((len(rows), 3)))


def numbers(path: Path, name: str, values: object, ranks: tuple[int, ...] = (2,)) -> np.ndarray:
    if not isinstance(values, np.ndarray):
        raise InputError(f"{path}: no array '{name}' in it")
    if values.ndim not in ranks or values.dtype.kind not in "fiu" or not values.size:
        raise InputError(f"{path}: {name} is {values.dtype} of shape {values.shape}, not a table of numbers")
    return values


def convert_joints(path: Path, poses: np.ndarray, joint_count: int) -> np.ndarray:
    """Convert poses [P, 3 J'] of any model of the family to poses [P, 3 J]."""
    width = poses.shape[1]
    if width == 3 * joint_count:
        return poses
    if width not in (3 * BODY_JOINTS, 72, 156, 165):
        raise InputError(f"{path}: poses of {width} numbers, but {joint_count} joints need {3 * joint_count}")
    body = 3 * min(BODY_JOINTS, joint_count)
    converted = np.zeros((len(poses), 3 * joint_count))
    converted[:, :body] = poses[:, :body]
    source, target = HANDS_FROM.get(width // 3), HANDS_FROM.get(joint_count)
    if source is not None and target is not None:
        converted[:, 3 * target : 3 * target + 90] = poses[:, 3 * source : 3 * source + 90]
    return converted
