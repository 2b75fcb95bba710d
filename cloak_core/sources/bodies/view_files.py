"""Built views on disk, so that runs with the same bodies and cameras build them once.

One safetensors file for each view, named after the SHA-256 of all that decides it: the pose's vertices, the topology,
camera, light and samples, the code that renders, and whether compiled loops or torch run it. See files/caching.py for
how such files are kept.
"""

from __future__ import annotations

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from cloak_core.core.cameras import Camera
from cloak_core.core.view import View
from cloak_core.core.visibility.compiled import use_loops
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.caching import DiskCache, cache_folder
from cloak_core.files.identity import code_hash, package_versions, sha256_arrays, sha256_record

LIMIT_BYTES = 1 << 30
"""Of all files together: some 2000 views of 416 x 416."""
CODE = ("render", "exchange/bodies.py", "scene/cameras.py", "scene/geometry.py")
"""What decides a view among our sources: another renderer builds all views anew."""
_INDICES = ("pixels", "crow", "face")
_NUMBERS = ("coverage", "specular", "weight")


def view_files() -> DiskCache:
    """Open the views in the user's cache folder."""
    return DiskCache(cache_folder("views"), ".view", LIMIT_BYTES, "views")


class StoredViews:
    """Views of one scene among the files. recipe: all else that decides them (light, samples, device)."""

    def __init__(self, files: DiskCache, bodies: Bodies, recipe: object, textured: bool, device: torch.device) -> None:
        self._files, self._bodies, self._textured, self._device = files, bodies, textured, device
        arrays = [bodies.triangles, bodies.triangle_face, *((bodies.uv, bodies.triangle_uv) if textured else ())]
        packages = package_versions("torch", "numpy", "numba")
        self._common = [code_hash(*CODE), repr(recipe), device.type, torch.backends.cpu.get_cpu_capability(), packages]
        self._common.append(sha256_arrays(*arrays))

    def get(self, pose: int, camera: Camera) -> View | None:
        """Read the view; None where there is none, or a file that is no such view."""
        if not 0 <= pose < self._bodies.pose_count:
            return None
        data = self._files.get(self._name(pose, camera))
        if data is None:
            return None
        try:
            tensors = load(data.tobytes())
        except (SafetensorError, ValueError, KeyError, OverflowError):
            return None
        return self._checked(tensors, camera)

    def put(self, pose: int, camera: Camera, view: View) -> None:
        """Keep a view."""
        tensors = {name: getattr(view, name).to("cpu", torch.int32) for name in _INDICES}
        tensors |= {name: getattr(view, name).cpu() for name in _NUMBERS}
        tensors |= {} if view.uv is None else {"uv": view.uv.cpu()}
        self._files.put(self._name(pose, camera), save({name: value.contiguous() for name, value in tensors.items()}))

    def _checked(self, tensors: dict[str, Tensor], camera: Camera) -> View | None:
        """Nothing that reads a view looks at its indices again, so a foreign file must not get further than this."""
        expected = {*_INDICES, *_NUMBERS, *(("uv",) if self._textured else ())}
        if set(tensors) != expected:
            return None
        count, entries, crow = len(tensors["pixels"]), len(tensors["face"]), tensors["crow"]
        shapes = {"pixels": (count,), "coverage": (count,), "specular": (count,), "crow": (count + 1,)}
        shapes |= {"face": (entries,), "weight": (entries,), "uv": (2, entries)}
        for name, value in tensors.items():
            wanted = torch.int32 if name in _INDICES else torch.float32
            if tuple(value.shape) != shapes[name] or value.dtype != wanted:
                return None
        if crow[0] != 0 or crow[-1] != entries or (crow.diff() < 0).any():
            return None
        limits = {"pixels": camera.height * camera.width, "face": self._bodies.face_count}
        if not all(_within(tensors[name], limit) for name, limit in limits.items()):
            return None
        put = lambda name: tensors[name].to(self._device, torch.int64 if name in _INDICES else torch.float32)
        return View(camera.height, camera.width, **{name: put(name) for name in tensors})

    def _name(self, pose: int, camera: Camera) -> str:
        decisive = [*self._common, self._bodies.pose_hashes[pose], repr(camera), use_loops(self._device)]
        return sha256_record(decisive)


def _within(indices: Tensor, count: int) -> bool:
    return not len(indices) or (int(indices.min()) >= 0 and int(indices.max()) < count)
