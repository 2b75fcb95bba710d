"""Which colours a four-colour printer can mix, roughly, and the nearest one that it can.

The model is Neugebauer's: dots of cyan, magenta and yellow fall on each other at random, so a printed colour is a
mean, in linear light, of the eight solid overprints on paper. Their colours here are those usual for offset on coated
paper, as sRGB. A real printer's own profile will differ; this tells what is surely out of reach.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from cloak_core.scene.logos.palette import nearest_in_palette
from cloak_core.scene.meshes.mesh_file import to_linear, to_srgb

# Overprints of (cyan, magenta, yellow), each 0 or 1: paper, Y, M, MY, C, CY, CM, CMY, in sRGB bytes.
OVERPRINTS = np.array([
    [255, 255, 255], [255, 237, 0], [230, 0, 126], [227, 6, 19],
    [0, 158, 224], [0, 150, 64], [49, 39, 131], [38, 35, 33],
])  # fmt: skip
STEPS = 33


def printable() -> Float[np.ndarray, "mixtures 3"]:
    """Mix a dense grid of ink amounts, sRGB in [0, 1]."""
    amount = np.linspace(0, 1, STEPS)
    c, m, y = (axis.reshape(-1, 1) for axis in np.meshgrid(amount, amount, amount, indexing="ij"))
    share = np.concatenate(
        [(c if i & 4 else 1 - c) * (m if i & 2 else 1 - m) * (y if i & 1 else 1 - y) for i in range(8)], axis=1
    )
    return to_srgb(share @ to_linear(OVERPRINTS / 255))


def nearest_printable(colors: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Find the nearest printable colour (sRGB in [0, 1]), itself where it is one; tell whether it is not."""
    nearest, beyond = nearest_in_palette(colors, printable())
    return np.where(beyond[:, None], nearest, colors), beyond
