"""Values of a glTF animation at one time."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from cloak_core.scene.meshes.gltf_document import Document


def sample_animation(document: Document, time: float) -> dict[int, dict[str, np.ndarray]]:
    """Sample the first animation at `time` seconds: what it sets of each node.

    Node -> translation, rotation, scale, weights.
    """
    animation = document.list("animations")[0]
    moved: dict[int, dict[str, np.ndarray]] = {}
    for channel in animation["channels"]:
        target, sampler = channel["target"], animation["samplers"][channel["sampler"]]
        if "node" not in target:
            continue
        times = document.accessor(sampler["input"]).astype(float)
        values = document.accessor(sampler["output"]).astype(float)
        kind = sampler.get("interpolation", "LINEAR")
        values = values.reshape(len(times), 3 if kind == "CUBICSPLINE" else 1, -1)
        moved.setdefault(target["node"], {})[target["path"]] = interpolate(
            times, values, time, kind, spherical=target["path"] == "rotation"
        )
    return moved


def interpolate(times: np.ndarray, values: np.ndarray, time: float, kind: str, spherical: bool) -> np.ndarray:
    """Interpolate one channel; values [keys, 1 or 3, n] (cubic splines store in-tangent, value, out-tangent)."""
    middle = values.shape[1] // 2
    key = int(np.searchsorted(times, time, side="right")) - 1
    if key < 0 or key >= len(times) - 1:
        return values[max(key, 0), middle]
    span = times[key + 1] - times[key]
    t = (time - times[key]) / span
    a, b = values[key, middle], values[key + 1, middle]
    if kind == "STEP":
        return a
    if kind == "CUBICSPLINE":
        leave, arrive = span * values[key, 2], span * values[key + 1, 0]
        t2, t3 = t * t, t * t * t
        return (2 * t3 - 3 * t2 + 1) * a + (t3 - 2 * t2 + t) * leave + (3 * t2 - 2 * t3) * b + (t3 - t2) * arrive
    return Slerp([0, 1], Rotation.from_quat([a, b]))(t).as_quat() if spherical else a + t * (b - a)
