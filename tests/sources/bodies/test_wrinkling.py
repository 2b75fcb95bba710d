from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cloak_core.core.geometry import face_normals
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.bodies.wrinkling import smooth_field, wrinkled
from tests.sources.bodies.solids import sphere as globe


def sphere(poses: int) -> Bodies:
    """A globe of a metre's radius in several sizes."""
    one = globe(16, 12)
    return replace(one, vertices=np.concatenate([one.vertices * (1 + 0.1 * p) for p in range(poses)]), names=())


@settings(max_examples=12)
@given(
    depth=st.floats(0.001, 0.05), draws=st.integers(1, 3), poses=st.integers(1, 2), seed=st.integers(0, 99),
    share=st.floats(0.3, 1.0),
)  # fmt: skip
def test_folds_move_what_is_inside_the_logo_and_nothing_else(depth, draws, poses, seed, share) -> None:
    """Every draw is another; no vertex goes farther than told, inwards least of all; the rest keeps its bits."""
    body = sphere(poses)
    logo = np.arange(int(share * body.face_count))
    folded = wrinkled(body, logo, depth, draws, seed)
    assert folded.pose_count == poses * draws and folded.topology == body.topology
    assert np.array_equal(folded.vertices, wrinkled(body, logo, depth, draws, seed).vertices)
    moved = folded.vertices - np.repeat(body.vertices, draws, axis=0)
    elsewhere = np.unique(body.triangles[~np.isin(body.triangle_face, logo)])
    assert not moved[:, elsewhere].any()
    inside = np.setdiff1d(np.arange(body.vertex_count), elsewhere)
    assert (np.linalg.norm(moved, axis=-1) <= depth * (2 + np.sqrt(3)) * 1.001).all()
    assert (np.abs(moved[:, inside]).max(axis=(1, 2)) > 0.2 * depth).all()
    assert len(np.unique(moved.reshape(len(moved), -1), axis=0)) == len(moved)
    # Cloth lies on skin: outwards on the whole.
    outwards = body.vertices[0, inside] / np.linalg.norm(body.vertices[0, inside], axis=1, keepdims=True)
    assert (moved[:, inside] * outwards).sum(-1).mean() > 0


def test_folds_are_smooth_and_turn_the_normals() -> None:
    """Points a millimetre apart move alike, and the surface leans away from where it stood."""
    random = np.random.default_rng(0)
    points = random.standard_normal((200, 3))
    near, there = (smooth_field(p, np.random.default_rng(5)) for p in (points, points + 0.001))
    assert np.median(np.abs(near - there)) < 0.05 and np.abs(near).max() <= 1 and near.std() > 0.3
    body = sphere(1)
    folded = wrinkled(body, np.arange(body.face_count), 0.05, 1, 0)
    turned = np.degrees(np.arccos((face_normals(folded) * face_normals(body)).sum(1).clip(-1, 1)))
    assert 3 < np.median(turned) < 60
