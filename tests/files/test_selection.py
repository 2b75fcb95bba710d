"""`SPEC[SELECTION]` takes some bodies of a scene and some images of a folder."""

import numpy as np
import pytest

from cloak_core.files.errors import InputError
from cloak_core.files.specs import select
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.bodies.people.samples import sample_bodies

NAMES = ("standing 1", "standing 2", "walking 1", "waving 1", "running 1")


@pytest.mark.parametrize(
    ("selection", "picked"),
    [
        ("0:2", [0, 1]),
        ("1::2", [1, 3]),
        ("::-1", [4, 3, 2, 1, 0]),
        ("3", [3]),
        ("-1,0", [4, 0]),
        ("wa*", [2, 3]),
        ("standing 2, running*", [1, 4]),
        (":", [0, 1, 2, 3, 4]),
    ],
)
def test_what_is_picked(selection: str, picked: list[int]) -> None:
    assert select(selection, NAMES, "scene") == picked


@pytest.mark.parametrize(
    ("selection", "words"),
    [
        ("5", "no number 5"),
        ("5:", "picks none of 5"),
        ("flying*", "'flying\\*' picks none of 5"),
        ("0:3,2", "picks 'walking 1' twice"),
        ("::0", "step of 0"),
        ("", "picks none"),
    ],
)
def test_a_bad_selection_is_one_line_that_names_it(selection: str, words: str) -> None:
    with pytest.raises(InputError, match=rf"body\.npz: .*{words}"):
        select(selection, NAMES, "body.npz")


def test_some_bodies_of_a_scene() -> None:
    everything = sample_bodies("train")
    some = load_scene("sample:train[walking*]")
    walking = [i for i, name in enumerate(everything.names) if name.startswith("walking")]
    assert 0 < len(walking) < everything.pose_count
    assert np.array_equal(some.vertices, everything.vertices[walking])
    assert some.topology == everything.topology
    assert load_scene("sample[0:3]").pose_count == 3
