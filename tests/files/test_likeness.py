"""Near-duplicates: photographs as people keep several copies of them, and bodies moved as a whole."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.files.likeness import picture_look, pose_shape, similar_looks, similar_poses
from cloak_core.sources.backdrops.procedural import draw_scene
from cloak_core.sources.bodies.people.samples import sample_bodies


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
    "cropped on every side": lambda p: trimmed(p, 0.04),
    "cropped on one side": lambda p: p.crop((round(0.08 * p.width), 0, p.width, p.height)),
    "a corner of it": lambda p: p.crop((0, 0, round(0.75 * p.width), round(0.75 * p.height))),
    "brighter": lambda p: Image.fromarray((np.asarray(p, np.float32) * 1.1 + 5).clip(0, 255).astype(np.uint8)),
}


@pytest.mark.slow
@pytest.mark.parametrize("how", COPIES)
def test_copies_of_a_picture_are_found_and_no_other(how: str) -> None:
    pictures = [scene(seed) for seed in range(8)]
    copies = [np.asarray(COPIES[how](Image.fromarray(picture))) for picture in pictures]
    pairs = similar_looks([picture_look(p) for p in pictures], [picture_look(p) for p in copies])
    assert pairs == [(i, i) for i in range(8)]


def turn(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    """Rotation matrix (Rodrigues)."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def test_a_pose_of_which_a_part_moved_is_another() -> None:
    pose = sample_bodies("all").vertices[0]
    lifted = pose.copy()
    lifted[pose[:, 0] > np.quantile(pose[:, 0], 0.9)] += (0, 0.1, 0)  # a forearm
    assert similar_poses([pose_shape(pose)], [pose_shape(lifted)]) == []
    assert similar_poses([], [pose_shape(pose)]) == []


CHANGED = {
    "moved": lambda v, random: v + 0.5,
    "moved by a micrometre": lambda v, random: v + 1e-6,
    "turned": lambda v, random: v @ turn((0, 1, 0), 0.7).T,
    "turned about any axis and far away": lambda v, random: v @ turn((1, 2, -3), 2.0).T + [[3, -1, 40]],
    "a millimetre of noise": lambda v, random: v + random.normal(0, 0.001, v.shape),
    "five per cent larger": lambda v, random: v * 1.05,
    "smaller, turned, with noise, elsewhere": lambda v, random: (
        v @ turn((1, 2, -3), 2.0).T * 0.9 + random.uniform(-0.001, 0.001, v.shape) + 4
    ),
}


@pytest.mark.parametrize("how", CHANGED)
def test_a_pose_that_was_moved_or_changed_a_little_is_found(how: str) -> None:
    random, poses = np.random.default_rng(0), sample_bodies("all").vertices
    shapes = [pose_shape(vertices) for vertices in poses]
    changed = [pose_shape(CHANGED[how](vertices.astype(np.float64), random)) for vertices in poses]
    assert similar_poses(shapes, changed) == [(i, i) for i in range(len(poses))]


@pytest.mark.slow
def test_photographs_and_parts_of_them_are_found_again_and_are_not_alike(shared: Path) -> None:
    random = np.random.default_rng(0)
    looks, copies, parts = [], [], []
    for path in sorted((shared / "data" / "backgrounds").glob("*.jpg")):
        with Image.open(path) as picture:
            picture = picture.convert("RGB").reduce(2)
        size = random.uniform(0.72, 0.97)
        width, height = round(size * picture.width), round(size * picture.height)
        x, y = random.integers(picture.width - width + 1), random.integers(picture.height - height + 1)
        mirrored = trimmed(picture.transpose(Image.Transpose.FLIP_LEFT_RIGHT), 0.01).resize((416, 416))
        for part, of_all in ((mirrored, copies), (picture.crop((x, y, x + width, y + height)), parts)):
            of_all.append(picture_look(np.asarray(jpeg(part, 75))))
        looks.append(picture_look(np.asarray(picture)))
    same = [(i, i) for i in range(len(looks))]
    assert len(looks) > 50 and similar_looks(looks, looks) == similar_looks(looks, copies) == same
    for found in (set(similar_looks(looks, parts)), set(similar_looks(parts, looks))):
        assert set(same) <= found and len(found - set(same)) <= 2  # of 2,756 pairs of different ones


def test_looks_of_earlier_versions_are_compared_as_they_were() -> None:
    looks = [picture_look(scene(seed)) for seed in range(4)]
    before = [look.partition(".")[0] for look in looks]
    assert similar_looks(before, looks) == similar_looks(looks, before) == [(i, i) for i in range(4)]
