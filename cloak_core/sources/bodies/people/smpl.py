"""SMPL bodies (and SMPL+H, SMPL-X) from the user's own licensed model file: shape, pose, skinning.

The mathematics is that of "SMPL: A Skinned Multi-Person Linear Model" (2015): blend shapes of the betas, joints
regressed from the shaped body, blend shapes of the joints' rotations, and linear blend skinning along the kinematic
tree.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.reading import MAX_BYTES, read_npz
from cloak_core.files.unpickling import read_pickled_arrays
from cloak_core.sources.bodies.people.smpl_poses import read_poses

BATCH = 32
ARRAYS = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "f")
"""Of a model file; the first five are finite numbers."""
EXPRESSIONS_FROM = 300
"""SMPL-X keeps its expressions behind 300 shape components."""


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
    """Import bodies of one SMPL model in the poses of a file (`people.smpl_poses.read_poses` has its kinds).

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
