"""The sample bodies and the clothed people: what their scenes hold, and that they hold it to the bit."""

import numpy as np
import pytest
from jaxtyping import Bool

from cloak_core.core.geometry import connected_parts, face_areas, face_centres, outward_parts
from cloak_core.core.logo import load_logo, select_region
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_npz
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.bodies.people.clothed import DATA as CLOTHED
from cloak_core.sources.bodies.people.clothed import OBJECTS, clothed_bodies
from cloak_core.sources.bodies.people.samples import DATA, HEADWEAR, sample_bodies
from cloak_core.sources.photographs.rig import body_rig
from cloak_core.sources.photographs.views import logo_positions
from tests.sources.bodies.solids import is_closed

EYES = read_npz(DATA)["part"] == 10
"""By tools/pretrain/body_tables.py."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "identity", "train", "unseen"),
    [
        ("sample", "f6f08258293d8480", 24, 6),
        ("sample-clothed", "7397c1af4bb420c9", 68, 48),
        ("sample-tight", "c4b2da4edd635b85", 68, 48),
    ],
)
def test_scenes_are_what_they_were_and_their_parts_share_nobody(scene, identity, train, unseen) -> None:
    """A pose has the same bits on every machine; the tools that made the files looked at cloth, cycles and shapes."""
    whole, *parts = (load_scene(scene + split) for split in ("", ":train", ":unseen"))
    assert whole.identity.startswith(identity)
    assert [part.pose_count for part in parts] == [train, unseen] and train + unseen == whole.pose_count
    assert {part.topology for part in parts} == {whole.topology}
    assert not set(parts[0].names) & set(parts[1].names)
    with pytest.raises(InputError, match=f"'{scene}:testing'"):
        load_scene(f"{scene}:testing")
    for file in (DATA, CLOTHED):
        assert file.stat().st_size < 4e6


@pytest.mark.slow
def test_sample_bodies_are_closed_and_clothed_whole() -> None:
    bodies = sample_bodies()
    assert is_closed(bodies.triangles) and outward_parts(bodies).all()
    assert np.abs(bodies.vertices[..., 1].min(axis=1)).max() < 1e-4
    cover = sum(bodies.regions[name].astype(int) for name in ("shirt", "trousers", "head", "hands", "feet"))
    assert (cover == 1).all()
    ids = select_region(bodies, "chest+thighs")
    for pose in range(bodies.pose_count):
        areas = face_areas(bodies, pose)
        assert 0.18 < areas[ids].sum() / areas.sum() <= 0.2


@pytest.mark.slow
def test_body_shirt_and_trousers_are_three_objects_numbered_through() -> None:
    bodies = clothed_bodies("unseen")
    owner = np.stack([bodies.regions[name] for name in OBJECTS])
    assert (owner.sum(0) == 1).all() and (np.diff(owner.argmax(0)) >= 0).all()
    quads = bodies.loop_vertices.reshape(-1, 4)
    corners = [set(quads[mask].ravel()) for mask in owner]
    assert not (corners[0] & corners[1] or corners[0] & corners[2] or corners[1] & corners[2])
    for number in (1, 2):  # each garment is one piece of cloth
        assert len(np.unique(connected_parts(quads[owner[number]], bodies.vertex_count)[quads[owner[number], 0]])) == 1
    logo = load_logo(bodies, region="shirt+trousers")
    assert set(logo.face_ids) == set(np.flatnonzero(owner[1] | owner[2]))
    assert 0 < len(select_region(bodies, "chest+thighs")) < len(logo)
    walking = load_scene("sample-tight:unseen[walking*]")
    assert walking.pose_count > 8 and walking.names == load_scene("sample-clothed:unseen[walking*]").names


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
