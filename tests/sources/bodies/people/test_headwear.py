"""Regions of headwear, on the sample bodies, the clothed people and the rig."""

import numpy as np
import pytest
from jaxtyping import Bool

from cloak_core.core.geometry import face_centres
from cloak_core.files.reading import read_npz
from cloak_core.sources.bodies.people.clothed import DATA as CLOTHED
from cloak_core.sources.bodies.people.clothed import clothed_bodies
from cloak_core.sources.bodies.people.samples import DATA, HEADWEAR, sample_bodies
from cloak_core.sources.photographs.rig import body_rig
from cloak_core.sources.photographs.views import logo_positions

EYES = read_npz(DATA)["part"] == 10
"""By tools/pretrain/body_tables.py."""


def on_the_rig(topology: str, region: Bool[np.ndarray, " F"]) -> Bool[np.ndarray, " T"]:
    return logo_positions(topology, np.flatnonzero(region)) >= 0


@pytest.mark.parametrize("scene", ["sample", "sample-clothed", "rig of sample", "rig of sample-clothed"])
def test_headwear_covers_what_it_says(scene: str) -> None:
    bodies, eyes, height = sample_bodies(), EYES, face_centres(sample_bodies())[:, 1]
    if scene.endswith("clothed"):
        source = read_npz(CLOTHED)["source_face"]
        bodies, eyes, height = clothed_bodies("unseen"), eyes[source], height[source]
    regions = {name: bodies.regions[name] for name in ("head", *HEADWEAR)}
    if scene.startswith("rig"):
        rig = body_rig()
        regions = {name: on_the_rig(bodies.topology, region) for name, region in regions.items()}
        eyes, height = on_the_rig(bodies.topology, eyes), rig.vertices[rig.triangles, 1].mean(1)
    head, cap, hood, scarf = (regions[name] for name in ("head", "cap", "hood", "scarf"))
    assert head[eyes].all() and not (cap | hood | scarf)[eyes].any() and eyes.sum() > 100
    assert (cap | hood | scarf <= head).all()
    assert height[cap].min() > height[eyes].max() and height[scarf].max() < height[eyes].min()
    # The face that a hood leaves lies between the brow and the chin; neck, crown and nape are covered.
    face = head & ~hood
    tall = height[head].max() - height[head].min()
    assert np.ptp(height[face]) < 0.6 * tall and height[hood].min() == height[head].min()
    assert height[cap].max() == height[head].max()
