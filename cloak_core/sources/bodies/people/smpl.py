"""SMPL bodies (and SMPL+H, SMPL-X) from the user's own licensed model file: shape, pose, skinning.

Poses come from AMASS .npz, SURREAL _info.mat, or rows of numbers in .npy or .csv.

The mathematics is that of "SMPL: A Skinned Multi-Person Linear Model" (2015): blend shapes of the betas, joints
regressed from the shaped body, blend shapes of the joints' rotations, and linear blend skinning along the kinematic
tree.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError, first_line
from cloak_core.files.reading import MAX_BYTES, read_bytes, read_npy, read_npz
from cloak_core.files.unpickling import read_pickled_arrays

BATCH = 32
ARRAYS = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "f")
"""Of a model file; the first five are finite numbers."""
EXPRESSIONS_FROM = 300
"""SMPL-X keeps its expressions behind 300 shape components."""
BODY_JOINTS = 22
"""Joints that SMPL (24), SMPL+H (52) and SMPL-X (55) have in common, from the root on."""
HANDS_FROM = {52: 22, 55: 25}
"""Where the 30 finger joints begin in models that have them."""
SHAPES = 10
MAX_POSES = 10_000_000
MAX_POSE_BYTES = 64 << 20
"""Of a table of poses as text or .mat."""


@dataclass(frozen=True, eq=False)
class SmplModel:
    """A model of V vertices, F triangles, J joints and S shape components; metres, y up, facing +z."""

    template: np.ndarray
    """[3, V]: x, y and z of the vertices; float32, as the other arrays of vertices."""
    shape_basis: np.ndarray
    """[3, V, S]."""
    pose_basis: np.ndarray
    """[3, V, 9 * (J - 1)]."""
    joints: np.ndarray
    """[3 * J] float64, of the template."""
    joint_basis: np.ndarray
    """[S, 3 * J] float64: how the betas move the joints (the regressor applied to the shape basis)."""
    weights: np.ndarray
    """[V, J]."""
    parents: np.ndarray
    """[J] int64, -1 for the root; parents come before children."""
    triangles: np.ndarray
    """[F, 3] int64."""
    uv: np.ndarray | None = None
    """[U, 2] texture coordinates, v up, in files that have them (SMPL-X's `vt` and `ft`)."""
    triangle_uv: np.ndarray | None = None
    """[F, 3]."""


def read_smpl(path: str | Path) -> SmplModel:
    """Read a model file, .npz or the original .pkl (through a restricted unpickler, see `files.unpickling`).

    Raises `InputError` naming arrays that are missing or of the wrong shape.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such model file")
    arrays = read_npz(path) if path.suffix.lower() == ".npz" else read_pickled_arrays(path)
    missing = [name for name in ARRAYS if not isinstance(arrays.get(name), np.ndarray)]
    if missing:
        raise InputError(f"{path}: not an SMPL model, it lacks {', '.join(missing)}")
    v, j, s = arrays["v_template"].shape[0], arrays["weights"].shape[-1], arrays["shapedirs"].shape[-1]
    expected = {
        "v_template": (v, 3),
        "shapedirs": (v, 3, s),
        "posedirs": (v, 3, 9 * (j - 1)),
        "J_regressor": (j, v),
        "weights": (v, j),
        "kintree_table": (2, j),
        "f": (len(arrays["f"]), 3),
    }
    wrong = [f"{n} is {arrays[n].shape}, not {shape}" for n, shape in expected.items() if arrays[n].shape != shape]
    if wrong:
        raise InputError(f"{path}: {'; '.join(wrong)}")
    for name in ARRAYS[:5]:
        if arrays[name].dtype.kind not in "fiu" or not np.isfinite(arrays[name]).all():
            raise InputError(f"{path}: {name} is not all finite numbers")
    parents = arrays["kintree_table"][0].astype(np.int64)
    parents[0] = -1
    triangles = arrays["f"].astype(np.int64)
    if not ((parents[1:] >= 0) & (parents[1:] < np.arange(1, j))).all():
        raise InputError(f"{path}: kintree_table: a joint's parent does not come before it")
    if triangles.min(initial=0) < 0 or triangles.max(initial=0) >= v:
        raise InputError(f"{path}: f names vertices beyond {v}")

    by_axis = lambda name: np.ascontiguousarray(np.moveaxis(arrays[name], 1, 0), np.float32)
    regressor, shapes = arrays["J_regressor"].astype(np.float64), arrays["shapedirs"].astype(np.float64)
    return SmplModel(
        template=by_axis("v_template"),
        shape_basis=by_axis("shapedirs"),
        pose_basis=by_axis("posedirs"),
        joints=(regressor @ arrays["v_template"]).reshape(-1),
        joint_basis=(regressor @ shapes.reshape(v, -1)).reshape(3 * j, -1).T,
        weights=arrays["weights"].astype(np.float32),
        parents=parents,
        triangles=triangles,
        uv=arrays.get("vt") if "ft" in arrays else None,
        triangle_uv=arrays.get("ft") if "vt" in arrays else None,
    )


def pose_smpl(
    model: SmplModel,
    poses: Float[np.ndarray, "poses angles"],
    betas: Float[np.ndarray, "poses shapes"],
    translation: Float[np.ndarray, "poses 3"] | None = None,
) -> Float[np.ndarray, "poses vertices 3"]:
    """Pose the model: vertices in metres, float32.

    poses: axis-angle of every joint [P, 3 J] in radians; betas: [P, S'] with S' at most the model's S.
    """
    count, j = len(poses), len(model.parents)
    if poses.shape[1] != 3 * j:
        raise InputError(f"poses of {poses.shape[1]} numbers, but {j} joints need {3 * j}")
    if betas.shape[1] > min(len(model.joint_basis), EXPRESSIONS_FROM):
        raise InputError(f"{betas.shape[1]} betas, but the model has {len(model.joint_basis)} shape components")
    turned = Rotation.from_rotvec(poses.reshape(-1, 3).astype(np.float64)).as_matrix().reshape(count, j, 3, 3)
    out = np.empty((count, len(model.weights), 3), np.float32)
    for start in range(0, count, BATCH):
        part = slice(start, start + BATCH)
        out[part] = pose_batch(model, turned[part], betas[part])
    return out if translation is None else (out + translation[:, None]).astype(np.float32)


def pose_batch(model: SmplModel, turned: np.ndarray, betas: np.ndarray) -> np.ndarray:
    """Pose rotations [B, J, 3, 3]: vertices [B, V, 3].

    Sums run coordinate by coordinate over [V, B], as large matrix products.
    """
    count, j = turned.shape[:2]
    joints = (betas @ model.joint_basis[: betas.shape[1]] + model.joints).reshape(count, j, 3)
    # World rotation and position of every joint along the tree, then the map of the rest pose into it.
    world, place = turned.copy(), joints.copy()
    for joint in range(1, j):
        parent = model.parents[joint]
        bone = joints[:, joint] - joints[:, parent]
        world[:, joint] = world[:, parent] @ turned[:, joint]
        place[:, joint] = place[:, parent] + (world[:, parent] @ bone[..., None])[..., 0]
    offset = place - (world @ joints[..., None])[..., 0]
    maps = np.concatenate([world, offset[..., None]], axis=3).transpose(2, 3, 1, 0).astype(np.float32)
    feature = (turned[:, 1:] - np.eye(3)).reshape(count, -1).T.astype(np.float32)
    shape = betas.T.astype(np.float32)
    posed = [
        model.template[axis, :, None]
        + model.shape_basis[axis, :, : len(shape)] @ shape
        + model.pose_basis[axis] @ feature
        for axis in range(3)
    ]
    out = np.empty((count, len(model.weights), 3), np.float32)
    for row in range(3):
        moved = model.weights @ maps[row, 3]
        for axis in range(3):
            moved += (model.weights @ maps[row, axis]) * posed[axis]
        out[..., row] = moved.T
    return out


def import_smpl(
    model_path: str | Path, poses_path: str | Path, name: str = "smpl", every: int = 1, limit: int | None = None
) -> Bodies:
    """Import bodies of one SMPL model in the poses of a file (`read_poses` has its kinds).

    every, limit: take each n-th pose, at most `limit`. Raises `InputError` for what does not fit together or would not
    fit into memory.
    """
    if every < 1 or (limit is not None and limit < 1):
        raise InputError(f"every {every}, limit {limit}: both are at least 1")
    model = read_smpl(model_path)
    sequence = read_poses(Path(poses_path), len(model.parents))
    poses, betas, moves = (x[::every][:limit] for x in (sequence.poses, sequence.betas, sequence.translation))
    if len(poses) * len(model.weights) * 12 > MAX_BYTES:
        raise InputError(f"{poses_path}: {len(poses)} poses need more than {MAX_BYTES >> 30} GiB; use a limit")
    vertices = pose_smpl(model, poses, betas, moves)
    if sequence.up == "z":
        vertices = vertices[..., [0, 2, 1]] * np.array([1, 1, -1], np.float32)
    stem = Path(poses_path).stem
    names = tuple(f"{stem} {index:04}" for index in range(len(vertices)))
    try:
        return Bodies(vertices, model.triangles, uv=model.uv, triangle_uv=model.triangle_uv, names=names, name=name)
    except InputError as error:
        raise InputError(f"{model_path}: {error}") from None


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
