"""The logo: the faces of a body that training may colour, and the ways to choose them.

Regions combine like this: `NAME[+NAME...]`, each NAME optionally followed by `-front`, `-back` or `-all`. The faces of
all terms are united. `-front` keeps a region's front-facing faces, `-back` the others, `-all` the whole region; without
one, `chest` and `thighs` mean their front (as in the paper's chest-and-thighs logo), any other region all of itself.
"Front" is the scene's own region of that name where it has one, else the faces whose normal leans forward in the first
pose. Boxes, pictures and areas refer to the first pose, in metres.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int64, Integer

from cloak_core.core.geometry import face_areas, face_centres, face_normals, inner_edges
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.face_lists import face_ids, read_face_list
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays, sha256_record

FRONT_BY_DEFAULT = ("chest", "thighs")
FACETS = ("front", "back", "all")
Facing = Literal["front", "back", "left", "right", "any"]
# The body's own left is at +x.
DIRECTIONS = {"front": (2, 1.0), "back": (2, -1.0), "left": (0, 1.0), "right": (0, -1.0)}


@dataclass(frozen=True, eq=False)
class Cover:
    """A set of faces of one topology: where something is worn."""

    face_ids: np.ndarray
    """[L] int64, sorted, unique."""
    topology: str
    """Hash of the mesh that they belong to."""
    name: str = field(default="", kw_only=True)
    """Its regions, shirt+trousers, or its file's name: for people, and decides nothing."""

    def __len__(self) -> int:
        return len(self.face_ids)

    @cached_property
    def key(self) -> str:
        """SHA-256 (hex) of topology and faces."""
        return sha256_record([self.topology, sha256_arrays(self.face_ids)])


@dataclass(frozen=True, eq=False)
class Logo(Cover):
    """Faces of a body that training may colour, with the edges between them (total variation runs over these)."""

    face_count: int
    """Faces of the whole body."""
    edges: np.ndarray
    """[E, 2] int64 positions in `face_ids`, lower first."""
    edge_lengths: np.ndarray
    """[E] float64 metres, in the first pose."""


def make_logo(bodies: Bodies, face_ids: np.ndarray | Sequence[int], name: str = "") -> Logo:
    """Make a logo of these faces (any order). InputError: none, duplicates, or ids that the body lacks."""
    listed = np.asarray(face_ids)
    if listed.ndim != 1 or not listed.size or listed.dtype.kind not in "iu":
        raise InputError(f"a logo is a row of face ids, not {listed.dtype} of shape {listed.shape}")
    ids = np.unique(listed).astype(np.int64)
    if len(ids) != len(listed):
        raise InputError(f"a logo names each face once; {len(listed) - len(ids)} of {len(listed)} ids are repeated")
    if ids[0] < 0 or ids[-1] >= bodies.face_count:
        beyond = ids[0] if ids[0] < 0 else ids[-1]
        raise InputError(f"face id {beyond} is beyond the {bodies.face_count} faces of scene '{bodies.name}'")
    edges, lengths = inner_edges(bodies, ids)
    return Logo(ids, bodies.topology, bodies.face_count, edges, lengths, name=name)


def load_logo(bodies: Bodies, path: str | os.PathLike | None = None, *, region: str | None = None) -> Logo:
    """Load the logo of a face list (.npy, from Blender or `cloak logo`), or of named regions: `region="chest+thighs"`.

    A path that is no face list's (.npy or .idx) and at which nothing lies names regions, too, as `--logo` takes both.
    Raises `InputError`: the list belongs to another body or is damaged, the body has no such region.
    """
    if (path is None) == (region is None):
        raise TypeError("load_logo takes either the path of a face list, or region=")
    if region is not None:
        return make_logo(bodies, select_region(bodies, region), region)
    if Path(path).suffix in (".npy", ".idx") or Path(path).exists():
        return make_logo(bodies, face_ids(read_face_list(path, bodies), bodies), Path(path).stem)
    try:
        return load_logo(bodies, region=os.fspath(path))
    except InputError as error:
        raise InputError(f"{path}: no such face list; {error}") from None


def area_share(bodies: Bodies, ids: Integer[np.ndarray, " logo"]) -> float:
    """Compute the faces' share of the body's area, 0 to 1, in the first pose."""
    areas = face_areas(bodies)
    return float(areas[ids].sum() / areas.sum())


def front_faces(bodies: Bodies) -> Bool[np.ndarray, " faces"]:
    """Take the scene's region "front", or where it has none the faces that lean forward in the first pose."""
    named = bodies.regions.get("front")
    return named if named is not None else face_normals(bodies)[:, 2] > 0.1


def select_region(bodies: Bodies, expression: str) -> Int64[np.ndarray, " logo"]:
    """Select the faces of named regions, such as "chest+thighs" (this module's head has the rules).

    Raises `InputError` naming the known regions for an unknown one, and for a result without faces.
    """
    chosen = np.zeros(bodies.face_count, bool)
    for term in expression.split("+"):
        chosen |= region_mask(bodies, term.strip())
    return checked(chosen, f"region {expression}")


def region_mask(bodies: Bodies, term: str) -> Bool[np.ndarray, " faces"]:
    """Select the faces of one term of a region expression."""
    name, dash, facet = term.rpartition("-")
    if term in bodies.regions or not dash or facet not in FACETS:
        name = term
        facet = "front" if term in FRONT_BY_DEFAULT else "all"
    if name not in bodies.regions:
        known = ", ".join(bodies.regions) or "none"
        raise InputError(f"region '{term}' is unknown; scene '{bodies.name}' has: {known}")
    region = bodies.regions[name]
    if facet == "all":
        return region
    return region & (front_faces(bodies) if facet == "front" else ~front_faces(bodies))


def select_box(bodies: Bodies, box: Sequence[float | int], facing: Facing = "any") -> Int64[np.ndarray, " logo"]:
    """Select faces whose centre lies in a box and whose normal points the way `facing` says.

    box: x0, x1, y0, y1, z0, z1, metres, first pose. Within 90 degrees; left and right are the body's own.
    """
    limits: Float[np.ndarray, "3 2"] = np.asarray(box, float).reshape(3, 2)
    centres = face_centres(bodies)
    chosen = ((centres >= limits[:, 0]) & (centres <= limits[:, 1])).all(axis=1)
    if facing != "any":
        axis, sign = DIRECTIONS[facing]
        chosen &= face_normals(bodies)[:, axis] * sign > 0
    return checked(chosen, f"box {','.join(f'{value:g}' for value in box)} facing {facing}")


def checked(chosen: Bool[np.ndarray, " faces"], what: str) -> Int64[np.ndarray, " logo"]:
    ids = np.flatnonzero(chosen).astype(np.int64)
    if not len(ids):
        raise InputError(f"{what}: no face of the body is in it")
    return ids


def chest_thighs(bodies: Bodies) -> Int64[np.ndarray, " logo"]:
    """Select the front of chest and thighs: sorted face ids."""
    if "chest_thighs" in bodies.regions and not {"chest", "thighs"} <= bodies.regions.keys():
        return np.flatnonzero(bodies.regions["chest_thighs"]).astype(np.int64)
    return select_region(bodies, "chest+thighs")


def shirt_trousers(bodies: Bodies) -> Int64[np.ndarray, " logo"]:
    """Select shirt and trousers all around, for attacks from every side: sorted face ids."""
    if "shirt_trousers" in bodies.regions:
        return np.flatnonzero(bodies.regions["shirt_trousers"]).astype(np.int64)
    return select_region(bodies, "shirt-all+trousers-all")
