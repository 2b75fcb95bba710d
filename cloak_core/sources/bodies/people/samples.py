"""The sample bodies that come with Cloak: posed adults of one topology in plain clothes (CC0).

`tools/pretrain/bake_bodies.py` made them; `data/README.md` tells from what.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from cloak_core.core.geometry import face_centres
from cloak_core.core.polygons import triangulate
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_npz

DATA = Path(__file__).parents[1] / "data" / "bodies.npz"
HEADWEAR = {
    "cap": lambda x, y, z: y > 1.634,
    "hood": lambda x, y, z: (z < 0.045) | ((x / 0.064) ** 2 + ((y - 1.567) / 0.075) ** 2 > 1),
    "scarf": lambda x, y, z: y < 1.556,
}
"""What of the head headwear covers, by the faces' middles in the first pose, which looks straight ahead (metres): above
the brow; all around the oval of the face; below the nose."""


def sample_bodies(split: str = "all") -> Bodies:
    """Load the sample bodies: 24 to train on, 6 "unseen" ones to test on, or "all" 30.

    The unseen ones have other shapes and poses.

    All have one topology (13,486 quads), stand on y = 0, and share twelve outfits and the regions of
    `core.logo.select_region`. A pose's name begins with its motion: standing, walking, running or waving.
    """
    if split not in ("all", "train", "unseen"):
        raise InputError(f"scene 'sample:{split}': the sample bodies come as sample, sample:train and sample:unseen")
    bodies, unseen = load()
    return bodies if split == "all" else bodies.select_poses(np.flatnonzero(unseen == (split == "unseen")))


@lru_cache(maxsize=1)
def load() -> tuple[Bodies, np.ndarray]:
    """Load all sample bodies, and which of the poses [P] are kept unseen."""
    data = read_npz(DATA)
    # Stored as differences of 16-bit steps along the vertex order; the sum wraps around as the differences did.
    steps = np.cumsum(data["vertex_steps"], axis=1, dtype=np.uint16)
    vertices = (data["origin"][:, None] + steps * data["step"][:, None]).astype(np.float32)
    quads = data["quads"].astype(np.int32)
    loop_total = np.full(len(quads), 4, np.int32)
    corners, triangle_face = triangulate(vertices[0], loop_total, quads.reshape(-1))
    bodies = Bodies(
        vertices=vertices,
        triangles=quads.reshape(-1)[corners],
        triangle_face=triangle_face,
        face_colors=(data["outfits"][:, data["part"]] / np.float32(255)).astype(np.float32),
        regions={key.removeprefix("region_"): mask for key, mask in data.items() if key.startswith("region_")},
        names=tuple(str(name) for name in data["names"]),
        loop_total=loop_total,
        loop_vertices=quads.reshape(-1),
        name="samples",
    )
    head = bodies.regions["head"]
    headwear = {name: head & covers(*face_centres(bodies).T) for name, covers in HEADWEAR.items()}
    return replace(bodies, regions=bodies.regions | headwear), data["unseen"]
