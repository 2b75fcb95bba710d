"""Stamps: text, pictures and the smiley, laid from the front."""

import bpy
import numpy as np
import pytest
from cloak.blender import faces
from cloak.blender.evaluated import read_surface
from cloak.logo import stamp
from made import centers, logo_ids, make_egg, make_grid, set_mode
from mathutils import Matrix


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


# --- dragged over the body -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
def test_laid_on_the_front_it_takes_what_the_stamp_from_the_front_takes(mode):
    obj = make_egg(60)
    settings = bpy.context.scene.cloak
    settings.stamp_kind, settings.stamp_size, settings.stamp_center = "SMILEY", 0.3, 0.6
    set_mode(mode)
    bpy.ops.cloak.logo_stamp()
    bpy.ops.cloak.stamp_drag(place=(0, -0.25, 0.6 * 1.8), direction=(0, 1, 0), height=0.3 * 1.8)
    assert obj.cloak.logo == "Smiley.001" and len(logo_ids(obj, "Smiley")) > 100
    assert np.array_equal(logo_ids(obj, "Smiley"), logo_ids(obj, "Smiley.001"))
    bpy.ops.cloak.stamp_drag(place=(0, -0.25, 1.5), height=0.2, add=True)
    assert len(logo_ids(obj, "Smiley.001")) > len(logo_ids(obj, "Smiley"))


def test_what_lies_behind_something_else_is_not_taken():
    """A body with a plate before it: of what the stamp covers, the plate and what stands beside it."""
    obj = make_egg(40)
    plate = make_grid(500, "Plate")
    plate.matrix_world = Matrix.Translation((0.1, -0.5, 0.6)) @ Matrix.Scale(0.2, 4)
    with bpy.context.temp_override(active_object=obj, selected_editable_objects=[obj, plate]):
        bpy.ops.object.join()
    bpy.context.view_layer.objects.active = obj
    placed = stamp.Placed(read_surface(bpy.context, obj), np.ones((8, 8), bool))
    for x, height in ((-0.1, 0.5), (0.1, 0.7)):
        found = placed.faces(stamp.laid(np.array([x, -0.3, 0.8]), np.array([0, 1, 0]), height, 1.0))
        points = centers(obj)[found]
        on_plate = points[:, 1] < -0.4
        behind = (np.abs(points[:, 0] - 0.1) < 0.19) & (points[:, 2] > 0.61) & (points[:, 2] < 0.99) & ~on_plate
        assert on_plate.any() and (~on_plate).any() and not behind.any()
