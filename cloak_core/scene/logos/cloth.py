"""Cloth on a body: where each point of the surface lies on a flat piece of cloth that repeats."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int64

from cloak_core.exchange.bodies import Bodies
from cloak_core.scene.geometry import face_centres, face_normals
from cloak_core.scene.logos.logo import Logo


def cloth_coordinates(points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 2"]:
    """Map points to metres right and down on the cloth, as seen from outside.

    Clothes are cut from flat panels: front and back are projected along z, the sides along x.
    """
    sideways = np.abs(normals[:, 0]) > np.abs(normals[:, 2])
    across = np.where(normals[:, 2] < 0, -points[:, 0], points[:, 0])
    across = np.where(sideways, -points[:, 2] * np.sign(normals[:, 0]), across)
    return np.stack([across, -points[:, 1]], axis=1)


def tile_of_face(bodies: Bodies, logo: Logo, tile: float, cell: float) -> Int64[np.ndarray, " L"]:
    """Number the square of a repeating cloth under each face's centre, from 0, in the first pose.

    tile: width and height of what repeats, metres; cell: of a square, metres, rounded so that a whole number fits.
    """
    count = max(1, round(tile / cell))
    places = cloth_coordinates(face_centres(bodies)[logo.face_ids], face_normals(bodies)[logo.face_ids])
    column, row = (np.floor(places / tile * count).astype(np.int64) % count).T
    return np.unique(row * count + column, return_inverse=True)[1].astype(np.int64)
