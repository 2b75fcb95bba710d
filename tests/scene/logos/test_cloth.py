"""Cloth that repeats: what lies a tile apart is the same square."""

import numpy as np
import pytest

from cloak_core.scene.geometry import face_centres, face_normals
from cloak_core.scene.logos.garment_colors import cloth_coordinates, tile_of_face
from cloak_core.scene.logos.logo import load_logo
from cloak_core.scene.opening import load_scene


def test_panels_keep_lengths_and_are_seen_from_outside():
    points = np.array([[0.1, 1.0, 0.2], [0.1, 1.0, -0.2], [0.3, 1.0, 0.1], [-0.3, 1.0, 0.1]])
    normals = np.array([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [-1.0, 0, 0]])
    # From the front the body's left is to the right, from behind to the left; from her left, the front is to the left.
    assert np.allclose(cloth_coordinates(points, normals), [[0.1, -1], [-0.1, -1], [-0.1, -1], [0.1, -1]])


@pytest.mark.slow
def test_faces_a_tile_apart_share_a_square():
    bodies = load_scene("sample[0:1]")
    logo = load_logo(bodies, region="shirt+trousers")
    tile, cell = 0.4, 0.05
    patch = tile_of_face(bodies, logo, tile, cell)
    assert 40 < len(np.unique(patch)) == patch.max() + 1 <= 64
    places = cloth_coordinates(face_centres(bodies)[logo.face_ids], face_normals(bodies)[logo.face_ids])
    inside = np.floor(places / cell).astype(int) % 8
    for square in range(0, patch.max() + 1, 7):
        assert len(np.unique(inside[patch == square], axis=0)) == 1


@pytest.mark.slow
def test_training_a_tile_gives_its_faces_one_colour(tmp_path):
    from cloak_core.attack.settings import make_settings
    from cloak_core.attack.training import train
    from tests.attack.fakes import TinyDetector, box_bodies, front_logo, noise_backgrounds

    bodies = box_bodies()
    logo = front_logo(bodies)
    settings = make_settings(
        "best", steps=3, batch=2, size=64, translation=5, samples=1, pattern="tile", tile_cm=50, feature_cm=25
    )
    result = train(settings, bodies, logo, [TinyDetector()], noise_backgrounds(), tmp_path / "run")
    patch = tile_of_face(bodies, logo, 0.5, 0.25)
    for square in np.unique(patch):
        assert np.ptp(result.colors[patch == square], axis=0).max() < 1e-6
    assert np.abs(result.colors - 0.5).max() > 1e-4
