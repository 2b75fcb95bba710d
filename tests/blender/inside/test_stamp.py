"""Stamps: text, pictures and the smiley, laid from the front."""

import bpy
import numpy as np
import pytest
from cloak.blender import faces
from cloak.blender.evaluated import read_surface
from cloak.files.errors import InputError
from cloak.logo import stamp
from made import centers, make_egg, make_grid


def test_a_letter_has_its_shape():
    ink = stamp.text_stamp("L")
    height, width = ink.shape
    assert height == stamp.RESOLUTION and 0.3 < width / height < 1
    assert ink[: height // 2, : width // 8].mean() > 0.5  # the stem
    assert ink[-height // 12 :, width // 2 :].mean() > 0.9  # the foot
    assert not ink[: height // 2, width // 2 :].any()  # nothing above it


def test_the_smiley_is_a_smiley():
    ink = stamp.smiley_stamp()
    assert np.array_equal(ink, ink[:, ::-1])

    def at(x: float, y: float) -> bool:
        return ink[int((1 - y) / 2 * len(ink)), int((x + 1) / 2 * len(ink))]

    assert at(0.32, 0.25) and at(0, -0.5) and at(0, 0.9) and not at(0, 0) and not at(0.95, 0.95)


def test_a_picture_gives_its_dark_opaque_pixels():
    image = bpy.data.images.new("picture", 4, 2, alpha=True)
    pixels = np.ones((2, 4, 4), np.float32)
    pixels[0, 0, :3] = 0  # bottom left: black
    pixels[1, 3] = (0, 0, 0, 0)  # top right: black, but transparent
    image.pixels.foreach_set(pixels.ravel())
    ink = stamp.image_stamp(image)
    assert ink.tolist() == [[False] * 4, [True, False, False, False]]
    image.pixels.foreach_set(np.ones(32, np.float32))
    with pytest.raises(InputError, match="no dark, opaque pixels"):
        stamp.image_stamp(image)
    with pytest.raises(InputError, match="No picture chosen"):
        stamp.image_stamp(None)
    with pytest.raises(InputError, match="text is empty"):
        stamp.text_stamp(" ")


def test_a_letter_on_a_wall_reads_the_right_way_round():
    obj = make_grid(20_000)  # 2 m wide, 2 m tall, seen from the front
    settings = bpy.context.scene.cloak
    settings.stamp_text, settings.stamp_size, settings.stamp_center = "L", 0.5, 0.5
    bpy.ops.cloak.logo_stamp()
    points = centers(obj)[faces.read_faces(obj, "L")]
    assert points[:, 2].min() == pytest.approx(0.5, abs=0.02) and points[:, 2].max() == pytest.approx(1.5, abs=0.02)
    low, high = points[points[:, 2] < 0.6], points[points[:, 2] > 1]
    # From the front, x runs to the right: the foot of an L points right.
    assert low[:, 0].max() > high[:, 0].max() + 0.2
    assert abs(points[:, 0].min() + points[:, 0].max()) < 0.04


def covered(obj, ink: np.ndarray, projection: stamp.Projection) -> np.ndarray:
    return stamp.Placed(read_surface(bpy.context, obj), ink).own_mask(projection)


def test_only_faces_that_are_seen_are_taken():
    obj = make_egg()
    wall = np.ones((8, 8), bool)
    projection = stamp.front_projection(obj, 0.5, 0.5, 0.0, 1.0)
    mask = covered(obj, wall, projection)
    assert mask.any() and (centers(obj)[mask][:, 1] < 0).all()
    hidden = np.zeros(len(mask), bool)
    hidden[np.flatnonzero(mask)[:7]] = True
    obj.data.polygons.foreach_set("hide", hidden)
    assert (covered(obj, wall, projection) == mask & ~hidden).all()
