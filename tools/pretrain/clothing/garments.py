"""Garments cut from the sample mesh: which of its polygons they are made of, and how much wider than the body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Integer
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import dijkstra

from cloak_core.sources.bodies.people.skeleton import Skeleton

Vertices = Float[np.ndarray, "V 3"]

SHIRT_HEM, TROUSER_HEM, SLEEVE = 0.505, 0.05, 0.72
"""Shares of the height, and of the way from shoulder to elbow, at which the garments end."""
SKIN_MARGIN = 0.09
"""Metres that the skin goes on below a collar, a sleeve or a trouser leg before it is dropped."""


@dataclass(frozen=True, eq=False)
class Garment:
    """A piece of the sample mesh."""

    name: str
    faces: Integer[np.ndarray, " F"]
    """Polygons of the sample mesh that it was cut from."""
    vertices: Integer[np.ndarray, " G"]
    """Vertices of the sample mesh."""
    quads: Integer[np.ndarray, "F 4"]
    """Into `vertices`."""
    ease: Float[np.ndarray, " G"]
    """How far from the skin it is cut, metres."""
    pin: Float[np.ndarray, " G"]
    """How firmly it is held where it was cut: 1 at the collar and the waistband."""


def cut(
    rest: Vertices, quads: Integer[np.ndarray, "N 4"], regions: dict[str, np.ndarray], skeleton: Skeleton
) -> list[Garment]:
    """T-shirt and trousers, cut from the average adult at rest (arms 45 degrees down)."""
    low, high = rest[:, 1].min(), rest[:, 1].max()
    level = (rest[:, 1] - low) / (high - low)
    middle = level[quads].mean(1)
    torso = regions["shirt"] & ~regions["arms"] & ~regions["forearms"]
    hips = regions["trousers"] & ~regions["thighs"] & ~regions["shins"]
    along = _along_arm(rest, skeleton)
    sleeves = regions["arms"] & (along[quads].mean(1) < SLEEVE)
    shirt = torso | sleeves | (hips | regions["thighs"]) & (middle > SHIRT_HEM)
    trousers = regions["trousers"] & (middle > TROUSER_HEM)
    # Narrow at the shoulders, wide at the waist; sleeves widen towards the elbow.
    trunk = np.interp(level, [0.50, 0.58, 0.66, 0.74, 0.80, 0.84], [0.036, 0.040, 0.034, 0.023, 0.011, 0.006])
    arm = np.interp(along, [0.0, 0.25, 0.8], [0.008, 0.018, 0.032])
    shirt_ease = np.where(along > 0, np.minimum(arm, 0.04), trunk)
    leg = np.interp(level, [0.05, 0.25, 0.42, 0.52, 0.575], [0.034, 0.026, 0.017, 0.010, 0.005])
    # Thighs touch: between them there is little room for cloth.
    leg *= np.clip(0.25 + np.abs(rest[:, 0]) / 0.09, 0.25, 1.0)
    return [
        _piece("shirt", shirt, quads, shirt_ease, np.clip((level - 0.835) / 0.012, 0, 1) * (along <= 0)),
        _piece("trousers", trousers, quads, leg, np.clip((level - 0.565) / 0.012, 0, 1)),
    ]


def _along_arm(rest: Vertices, skeleton: Skeleton) -> Float[np.ndarray, " V"]:
    """Way from the shoulder (0) to the elbow (1) of the nearer arm; 0 for what lies before the shoulder."""
    along = np.zeros(len(rest))
    for side, sign in (("L", 1), ("R", -1)):
        start, end = (skeleton.heads[skeleton.index[f"{bone}.{side}"]] for bone in ("upperarm01", "lowerarm01"))
        way = ((rest - start) @ (end - start)) / ((end - start) @ (end - start))
        mine = sign * rest[:, 0] > abs(start[0]) * 0.9
        along[mine] = np.clip(way[mine], 0, None)
    return along


def _piece(name: str, chosen: Bool[np.ndarray, " N"], quads: np.ndarray, ease: np.ndarray, pin: np.ndarray) -> Garment:
    faces = np.flatnonzero(_largest(chosen, quads))
    vertices, local = np.unique(quads[faces], return_inverse=True)
    return Garment(name, faces, vertices, local.reshape(-1, 4), ease[vertices], pin[vertices])


def _largest(chosen: Bool[np.ndarray, " N"], quads: np.ndarray) -> Bool[np.ndarray, " N"]:
    """The largest connected part of the chosen polygons: islands are dropped."""
    from cloak_core.core.geometry import connected_parts

    faces = np.flatnonzero(chosen)
    label = connected_parts(quads[faces], int(quads.max()) + 1)[quads[faces, 0]]
    kept = np.zeros(len(chosen), bool)
    kept[faces[label == np.bincount(label).argmax()]] = True
    return kept


def neighbours(quads: Integer[np.ndarray, "F 4"], count: int) -> csr_matrix:
    """Vertices joined by an edge, 1 each."""
    start, end = quads.reshape(-1), np.roll(quads, -1, axis=1).reshape(-1)
    joined = csr_matrix((np.ones(len(start)), (start, end)), shape=(count, count))
    return ((joined + joined.T) > 0).astype(float)


def normals(vertices: Vertices, quads: Integer[np.ndarray, "F 4"]) -> Vertices:
    """Unit vertex normals of a quad mesh."""
    corners = vertices[quads]
    face = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    total = np.zeros_like(vertices)
    for corner in range(4):
        np.add.at(total, quads[:, corner], face)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def tailored(garment: Garment, rest: Vertices, quads: Integer[np.ndarray, "N 4"], extra: np.ndarray) -> Vertices:
    """The garment around one person at rest [G, 3]: away from the skin by its ease and `extra` [G] metres, smoothed so
    that it does not follow every muscle, never nearer than half of its ease."""
    skin, outwards = rest[garment.vertices], normals(rest, quads)[garment.vertices]
    joined = neighbours(garment.quads, len(skin))
    mean = diags(1 / joined.sum(1).A1) @ joined
    for _ in range(6):
        outwards = outwards + mean @ outwards
        outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    sewn = skin + outwards * (garment.ease + extra)[:, None]
    rim, along = rims(garment)
    for _ in range(12):  # the mesh's edges go up and down along an opening in steps
        sewn[rim] = (sewn + along @ sewn)[rim] / 2
    for _ in range(8):
        smooth = mean @ sewn
        smooth[rim] = sewn[rim]
        away = ((smooth - skin) * outwards).sum(1, keepdims=True)
        sewn = smooth + outwards * np.maximum(0.5 * garment.ease[:, None] - away, 0)
    return sewn


def rims(garment: Garment) -> tuple[Bool[np.ndarray, " G"], csr_matrix]:
    """Vertices on the garment's openings, and the matrix [G, G] that takes the mean of their neighbours along them."""
    edges = np.sort(np.stack([garment.quads, np.roll(garment.quads, -1, axis=1)], -1).reshape(-1, 2), axis=1)
    known, count = np.unique(edges, axis=0, return_counts=True)
    start, end = known[count == 1].T
    rim = np.zeros(len(garment.vertices), bool)
    rim[start] = rim[end] = True
    joined = csr_matrix((np.ones(len(start)), (start, end)), shape=(len(rim), len(rim)))
    joined = joined + joined.T
    return rim, diags(1 / np.maximum(joined.sum(1).A1, 1)) @ joined


def bare_faces(rest: Vertices, quads: Integer[np.ndarray, "N 4"], garments: list[Garment]) -> Bool[np.ndarray, " N"]:
    """Polygons of the skin that stay: what no garment covers, and `SKIN_MARGIN` below the openings."""
    covered = np.zeros(len(quads), bool)
    for garment in garments:
        covered[garment.faces] = True
    edges = np.stack([quads.reshape(-1), np.roll(quads, -1, axis=1).reshape(-1)])
    length = np.linalg.norm(rest[edges[0]] - rest[edges[1]], axis=1)
    graph = csr_matrix((length, edges), shape=(len(rest), len(rest)))
    away = dijkstra(graph, directed=False, indices=np.unique(quads[~covered]), min_only=True)
    return ~covered | (away[quads].min(1) < SKIN_MARGIN)
