"""Procedural scenes are what they were: training and test sets of backgrounds, and the images that verify detectors.

`python -m tests.sources.backdrops.test_procedural` writes scenes.npz anew where a change is meant to alter them.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from cloak_core.files.reading import read_npz
from cloak_core.files.writing import write_npz
from cloak_core.sources.backdrops.procedural import draw_scene

FILE = Path(__file__).with_name("scenes.npz")
COUNT = 64
"""Of scenes: of each of the seven kinds there are some."""


def thumbnails() -> Float[np.ndarray, "scenes 8 8 3"]:
    """Mean levels (0 to 255) of scenes in 8 x 8 fields."""
    scenes = np.stack([draw_scene(np.random.default_rng([11, seed]), 96, 128) for seed in range(COUNT)])
    return scenes.reshape(COUNT, 8, 12, 8, 16, 3).mean(axis=(2, 4))


def test_scenes_are_what_they_were() -> None:
    # Another Pillow may round otherwise.
    assert np.abs(thumbnails() - read_npz(FILE)["scenes"]).max() <= 1


if __name__ == "__main__":
    write_npz(FILE, compressed=True, scenes=thumbnails().round().astype(np.uint8))
