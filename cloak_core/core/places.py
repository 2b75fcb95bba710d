"""Places on clothes: what an image shows of a garment, whoever wears it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor

from cloak_core.core.geometry import face_areas, face_centres, face_normals
from cloak_core.core.linear import SparseMap
from cloak_core.core.logo import Cover
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.cloth import cloth_coordinates


@dataclass(frozen=True, eq=False)
class Places:
    """P places on clothes that wear L faces: which face each lies on, and how much of a cloth is seen there at once."""

    face: Int64[Tensor, " P"]
    """Position among the L faces that are worn; -1 where none is."""
    at: Float32[Tensor, "2 P"]
    """The middle of the place on a cloth that the clothes are cut of: metres right and down, in the pose for cloth."""
    extent: Float32[Tensor, "2 P"]
    """Width and height of the cloth that is seen at once there, metres: what a sampler averages over."""
    lay: Callable[[], SparseMap]
    """Makes `shares`, which a cloth does not need."""
    lay_own: Callable[[], SparseMap] | None = None
    """Makes `own`; None: own clothing has colours of faces."""

    @cached_property
    def shares(self) -> SparseMap:
        """Each place's shares of the worn faces: places x faces."""
        return self.lay()

    @cached_property
    def own(self) -> SparseMap:
        """Where own clothing is: places x its colours (`BakedView.own`)."""
        return self.shares if self.lay_own is None else self.lay_own()

    def __len__(self) -> int:
        """Count the places."""
        return len(self.face)

    @staticmethod
    def of_faces(count: int, device: torch.device | str = "cpu") -> Places:
        """Make each worn face a place. Where it lies on a cloth is not known."""
        nowhere = torch.full((2, count), torch.nan, device=device)
        return Places(torch.arange(count, device=device), nowhere, nowhere, lambda: SparseMap.identity(count, device))

    @staticmethod
    def on_cloth(face: Int64[Tensor, " P"], cloth: Float32[Tensor, "4 P"], count: int) -> Places:
        """Make places that lie on one of `count` faces each; cloth: `at`, then `extent`."""

        def lay() -> SparseMap:
            return SparseMap(torch.arange(len(face) + 1, device=face.device), face, torch.ones_like(cloth[0]), count)

        return Places(face, cloth[:2], cloth[2:], lay)

    def to(self, device: torch.device | str) -> Places:
        """Copy the places to a device."""
        moved = {name: getattr(self, name).to(device) for name in ("face", "at", "extent")}
        lay_own = None if self.lay_own is None else lambda: self.own.to(device)
        return Places(**moved, lay=lambda: self.shares.to(device), lay_own=lay_own)


def face_places(bodies: Bodies, cover: Cover) -> Places:
    """Lay each worn face on the cloth as a square of its own area, in the pose for cloth."""
    bodies = bodies.for_cloth()
    at = cloth_coordinates(face_centres(bodies)[cover.face_ids], face_normals(bodies)[cover.face_ids])
    width = np.sqrt(face_areas(bodies)[cover.face_ids])
    cloth = torch.from_numpy(np.concatenate([at.T, np.stack([width, width])]).astype(np.float32))
    return Places.on_cloth(torch.arange(len(cover.face_ids)), cloth, len(cover.face_ids))


def corner_places(bodies: Bodies) -> Float[np.ndarray, "2 3 T"]:
    """Find where the triangles' corners lie on the cloth, metres; a face's triangles lie in one panel."""
    bodies = bodies.for_cloth()
    points = bodies.vertices[0][bodies.triangles]  # [T, 3, 3]
    normals = face_normals(bodies)[bodies.triangle_face]
    corners = [cloth_coordinates(points[:, corner], normals) for corner in range(3)]
    return np.stack(corners).transpose(2, 0, 1)
