"""Logos and first colours of the cloaks that a detector is hardened against: as many kinds as one can think of.

None of them is a logo that the results are judged on (chest + thighs, shirt + trousers): a draw that comes near one of
those is drawn again, so that what is learned must hold on logos that were never seen.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, Int64

from cloak_core.core.geometry import face_areas, face_centres, face_normals
from cloak_core.core.logo import region_mask
from cloak_core.core.prints import PRINTS
from cloak_core.exchange.bodies import Bodies
from cloak_core.patterns.cloth import ClothPattern
from cloak_core.sources.bodies.people.samples import HEADWEAR
from cloak_core.studies.hardening.decoys import TEXTURE, random_texture

JUDGED = (("chest", "thighs"), ("shirt", "trousers"))
"""Regions of the logos that are kept for judging."""
TOO_ALIKE = 0.7
"""Area in common over area in either, from which a draw counts as one of them."""
LEAST, MOST = 0.05, 1.0
"""Shares of the body's area."""
CANDIDATES = 6
"""Logos of which the one nearest a share drawn evenly is taken; the shapes alone are small three times out of four,
and a detector that saw few large cloaks falls to them."""


def draw_logo(bodies: Bodies, rng: np.random.Generator) -> Int64[np.ndarray, " L"]:
    """Draw the faces of a logo: a few balls about points of the body, a slab of it, or named regions.

    Whole, or one side of it. Large ones are as likely as small ones.
    """
    areas = face_areas(bodies)
    areas = areas / areas.sum()
    wanted = rng.uniform(LEAST, MOST)
    drawn = [_fitting(bodies, areas, rng) for _ in range(CANDIDATES)]
    return np.flatnonzero(min(drawn, key=lambda chosen: abs(areas[chosen].sum() - wanted)))


def _fitting(bodies: Bodies, areas: np.ndarray, rng: np.random.Generator) -> Bool[np.ndarray, " F"]:
    """Draw a random shape, neither too small nor too large nor near one that is judged."""
    for _ in range(1000):
        chosen = _shape(bodies, rng)
        if rng.random() < 0.35:
            angle = rng.uniform(0, 2 * np.pi) if rng.random() < 0.5 else np.pi / 2
            chosen &= face_normals(bodies)[:, [0, 2]] @ np.array([np.cos(angle), np.sin(angle)]) > 0
        share = areas[chosen].sum()
        if LEAST <= share <= MOST and not any(_alike(bodies, chosen, names, areas) for names in JUDGED):
            return chosen
    raise RuntimeError(f"no random logo fits scene '{bodies.name}'")


def _shape(bodies: Bodies, rng: np.random.Generator) -> Bool[np.ndarray, " F"]:
    centres, kind = face_centres(bodies), rng.random()
    if kind < 0.4 or not bodies.regions:
        chosen = np.zeros(len(centres), bool)
        for _ in range(rng.integers(1, 6)):
            about = centres[rng.integers(len(centres))]
            chosen |= ((centres - about) ** 2).sum(1) < rng.uniform(0.1, 0.4) ** 2
        return chosen
    if kind < 0.75:
        low, high = np.sort(rng.uniform(centres[:, 1].min(), centres[:, 1].max(), 2))
        return (centres[:, 1] >= low) & (centres[:, 1] <= high)
    chosen = np.zeros(len(centres), bool)
    # Headwear lies on the head, which is a region already; what dressing it by itself teaches has not been measured.
    names = rng.permutation([name for name in bodies.regions if name not in HEADWEAR])[: rng.integers(1, 4)]
    for name in names:
        chosen |= bodies.regions[str(name)]
    return chosen


def _alike(bodies: Bodies, chosen: np.ndarray, names: tuple[str, ...], areas: np.ndarray) -> bool:
    if not all(name in bodies.regions for name in names):
        return False
    judged = np.zeros(len(chosen), bool)
    for name in names:
        judged |= region_mask(bodies, name)
    return bool(areas[chosen & judged].sum() > TOO_ALIKE * areas[chosen | judged].sum())


def draw_colors(centres: Float32[np.ndarray, "L 3"], rng: np.random.Generator) -> Float32[np.ndarray, "L 3"]:
    """Draw the first colours of a logo: grey, one colour, noise of each face, or blocks of a few centimetres."""
    kind = rng.random()
    if kind < 0.3:
        return np.full(centres.shape, 0.5, np.float32)
    if kind < 0.5:
        return np.tile(rng.random(3), (len(centres), 1)).astype(np.float32)
    if kind < 0.75:
        return rng.random(centres.shape).astype(np.float32)
    cells = np.floor(centres / rng.uniform(0.03, 0.15)).astype(np.int64)
    code = (cells * np.array([73856093, 19349663, 83492791])).sum(1) % 997
    return rng.random((997, 3)).astype(np.float32)[code]


# --- cloths that repeat

WIDTHS = (20.0, 55.0)
"""Centimetres of the piece that repeats; published textures are worn at 25 to 50."""
SQUARE = 1.0
"""Centimetres of what has one colour."""
PRINTED = 0.3
"""Share of the cloths that begin as a plain print; the others begin as a pattern that nobody trained."""


def first_cloth(cloth: ClothPattern, rng: np.random.Generator) -> Float32[np.ndarray, "S 3"]:
    """Draw the first colours of a cloth's squares, which lie row by row."""
    if rng.random() < PRINTED:
        return PRINTS[str(rng.choice(sorted(PRINTS)))].at(cloth.centres)
    texture = random_texture(rng)
    row, column = ((np.arange(count) + 0.5) * TEXTURE / count for count in (cloth.grid.rows, cloth.grid.columns))
    squares = texture[:, row.astype(int)][:, :, column.astype(int)]
    return np.ascontiguousarray(squares.reshape(3, -1).T, np.float32)
