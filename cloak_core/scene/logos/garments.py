"""The clothing regions that trainings cover, found under the name that each scene has for them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int64

from cloak_core.exchange.bodies import Bodies
from cloak_core.scene.logos.logo import select_region


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
