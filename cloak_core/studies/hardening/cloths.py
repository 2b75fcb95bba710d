"""Cloths that repeat, among the cloaks that a detector is hardened against."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from cloak_core.core.prints import PRINTS
from cloak_core.core.worn import Worn
from cloak_core.studies.hardening.decoys import TEXTURE, random_texture

WIDTHS = (20.0, 55.0)
"""Centimetres of the piece that repeats; published textures are worn at 25 to 50."""
SQUARE = 1.0
"""Centimetres of what has one colour."""
PRINTED = 0.3
"""Share of the cloths that begin as a plain print; the others begin as a pattern that nobody trained."""


def draw_pattern(rng: np.random.Generator) -> dict[str, str | float]:
    """Draw settings of a cloth that repeats."""
    return {"pattern": "tile", "tile_cm": float(rng.uniform(*WIDTHS)), "feature_cm": SQUARE}


def first_cloth(worn: Worn, rng: np.random.Generator) -> Float32[np.ndarray, "S 3"]:
    """Draw the first colours of a cloth's squares, which lie row by row."""
    if rng.random() < PRINTED:
        return PRINTS[str(rng.choice(sorted(PRINTS)))].at(worn.centres)
    texture, cloth = random_texture(rng), worn.cloth.cloth
    row, column = ((np.arange(count) + 0.5) * TEXTURE / count for count in (cloth.rows, cloth.count))
    squares = texture[:, row.astype(int)][:, :, column.astype(int)]
    return np.ascontiguousarray(squares.reshape(3, -1).T, np.float32)
