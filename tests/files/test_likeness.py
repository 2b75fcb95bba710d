"""Near-duplicates: photographs as people keep several copies of them, and bodies moved as a whole."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.files.likeness import picture_look, pose_shape, similar_looks, similar_poses
from cloak_core.scene.backdrops.procedural import draw_scene
from cloak_core.scene.people.samples import sample_bodies


def scene(seed: int, side: int = 160) -> np.ndarray:
    return draw_scene(np.random.default_rng([9, seed]), side, side + 40)


def jpeg(picture: Image.Image, quality: int) -> Image.Image:
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=quality)
    return Image.open(io.BytesIO(file.getvalue())).convert("RGB")


def trimmed(picture: Image.Image, share: float) -> Image.Image:
    x, y = round(share * picture.width), round(share * picture.height)
    return picture.crop((x, y, picture.width - x, picture.height - y))


COPIES = {
    "as JPEG": lambda p: jpeg(p, 40),
    "smaller": lambda p: p.resize((p.width // 2, p.height // 2)),
    "stretched": lambda p: p.resize((120, 120)),
    "mirrored": lambda p: p.transpose(Image.Transpose.FLIP_LEFT_RIGHT),
    "mirrored, smaller, as JPEG": lambda p: jpeg(p.transpose(Image.Transpose.FLIP_LEFT_RIGHT).resize((99, 77)), 60),
    "trimmed": lambda p: trimmed(p, 0.02),
    "brighter": lambda p: Image.fromarray((np.asarray(p, np.float32) * 1.1 + 5).clip(0, 255).astype(np.uint8)),
}


@pytest.mark.parametrize("how", COPIES)
def test_copies_of_a_picture_are_found_and_no_other(how: str) -> None:
    pictures = [scene(seed) for seed in range(8)]
    copies = [np.asarray(COPIES[how](Image.fromarray(picture))) for picture in pictures]
    pairs = similar_looks([picture_look(p) for p in pictures], [picture_look(p) for p in copies])
    assert pairs == [(i, i) for i in range(8)]


@pytest.mark.slow
def test_procedural_scenes_are_not_alike() -> None:
    looks = [picture_look(scene(seed, 32)) for seed in range(30)]
    assert similar_looks(looks, looks) == [(i, i) for i in range(30)]


@pytest.mark.slow
def test_photographs_are_found_again_and_not_alike(shared: Path) -> None:
    looks, copies = [], []
    for path in sorted((shared / "data" / "backgrounds").glob("*.jpg")):
        with Image.open(path) as picture:
            picture = picture.convert("RGB").reduce(2)
        looks.append(picture_look(np.asarray(picture)))
        small = jpeg(trimmed(picture.transpose(Image.Transpose.FLIP_LEFT_RIGHT), 0.01).resize((416, 416)), 75)
        copies.append(picture_look(np.asarray(small)))
    assert len(looks) > 50
    same = [(i, i) for i in range(len(looks))]
    assert similar_looks(looks, looks) == same and similar_looks(looks, copies) == same


def test_what_shows_nothing_is_like_nothing() -> None:
    plain = [picture_look(np.full((40, 50, 3), level, np.uint8)) for level in (0, 128)]
    assert plain == ["", ""] and similar_looks(plain, plain) == []
    strange = ["zz" * 18, "00", "", "é"]
    assert similar_looks(strange, strange) == [] and similar_looks([], [picture_look(scene(0))]) == []


def turn(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    """Rotation matrix (Rodrigues)."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


@pytest.mark.parametrize(
    ("rotation", "shift"),
    [
        (np.eye(3), (0.5, 0.0, 0.0)),
        (np.eye(3), (1e-6, 1e-6, 0.0)),
        (turn((0, 1, 0), 0.7), (0.0, 0.0, 0.0)),
        (turn((1, 2, -3), 2.0), (3.0, -1.0, 40.0)),
    ],
    ids=["moved", "moved by a micrometre", "turned", "turned about any axis and far away"],
)
def test_a_pose_moved_as_a_whole_is_found(rotation: np.ndarray, shift: tuple[float, ...]) -> None:
    poses = sample_bodies("all").vertices
    moved = (poses @ rotation.T + np.array(shift)).astype(np.float32)
    shapes = [pose_shape(vertices) for vertices in poses]
    assert similar_poses(shapes, [pose_shape(vertices) for vertices in moved]) == [(i, i) for i in range(len(poses))]


def test_a_pose_of_which_a_part_moved_is_another() -> None:
    pose = sample_bodies("all").vertices[0]
    lifted = pose.copy()
    lifted[pose[:, 0] > np.quantile(pose[:, 0], 0.95)] += (0, 0.05, 0)  # a hand
    assert similar_poses([pose_shape(pose)], [pose_shape(lifted), pose_shape(pose * np.float32(1.01))]) == []
    assert similar_poses([], [pose_shape(pose)]) == []


def test_shapes_are_short_enough_to_keep_thousands() -> None:
    assert len(repr(pose_shape(sample_bodies("all").vertices[0]))) < 600
