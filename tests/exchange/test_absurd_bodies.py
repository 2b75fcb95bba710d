"""Bodies given arrays of absurd extents: refused before anything is counted through."""

import time

import numpy as np
import pytest

from cloak_core.exchange.bodies import MAX_FACES, MAX_POSES, Bodies
from cloak_core.files.errors import InputError

TRIANGLE = {"vertices": np.zeros((1, 3, 3), np.float32), "triangles": np.array([[0, 1, 2]])}


def absurd(*shape: int) -> np.ndarray:
    """An array of any shape with an extent of 0, or one number seen many times over: takes no memory."""
    return np.broadcast_to(np.zeros(1, np.float32), shape)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"vertices": absurd(2**40, 0, 3)}, "vertices: float32 of shape"),
        ({"vertices": absurd(MAX_POSES + 1, 1, 3), "triangles": np.zeros((1, 3), int)}, "1048577 poses"),
        ({"triangles": np.zeros((0, 3), int), "face_colors": absurd(2**40, 0, 3)}, "face_colors: float32 of shape"),
        ({"triangles": np.zeros((0, 3), int), "regions": {"a": absurd(2**40, 0)}}, "region_a: float32 of shape"),
        ({"textures": {"a": absurd(2**40, 0, 3)}}, "texture_a: float32 of shape"),
        ({"triangles": np.broadcast_to(np.arange(3, dtype=np.int32), (MAX_FACES + 1, 3))}, "are beyond any mesh"),
    ],
    ids=["vertices", "poses", "colours", "region", "texture", "triangles"],
)
def test_absurd_extents_are_refused_at_once(arrays: dict, words: str) -> None:
    started = time.process_time()
    with pytest.raises(InputError, match=words):
        Bodies(**TRIANGLE | arrays)
    assert time.process_time() - started < 5
