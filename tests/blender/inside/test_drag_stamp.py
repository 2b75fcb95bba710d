"""The stamp that is dragged over the body: what it takes where it lies, and how quickly it follows."""

import math

import bpy
import numpy as np
import pytest
from cloak.blender import faces
from cloak.blender.evaluated import read_surface
from cloak.logo import stamp
from made import centers, make_egg, make_grid, set_mode
from mathutils import Matrix


def taken(obj, name: str) -> np.ndarray:
    return faces.read_faces(obj, name)


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
def test_laid_on_the_front_it_takes_what_the_stamp_from_the_front_takes(mode):
    obj = make_egg(60)
    settings = bpy.context.scene.cloak
    settings.stamp_kind, settings.stamp_size, settings.stamp_center = "SMILEY", 0.3, 0.6
    set_mode(mode)
    bpy.ops.cloak.logo_stamp()
    bpy.ops.cloak.stamp_drag(place=(0, -0.25, 0.6 * 1.8), direction=(0, 1, 0), height=0.3 * 1.8)
    assert obj.cloak.logo == "Smiley.001" and taken(obj, "Smiley").sum() > 100
    assert np.array_equal(taken(obj, "Smiley"), taken(obj, "Smiley.001"))
    bpy.ops.cloak.stamp_drag(place=(0, -0.25, 1.5), height=0.2, add=True)
    assert taken(obj, "Smiley.001").sum() > taken(obj, "Smiley").sum()


def test_it_turns_against_the_clock_and_grows():
    obj = make_grid(20_000)
    settings = bpy.context.scene.cloak
    settings.stamp_kind, settings.stamp_text = "TEXT", "L"
    bpy.ops.cloak.stamp_drag(place=(0, 0, 1), height=1.0)
    bpy.ops.cloak.stamp_drag(place=(0, 0, 1), height=1.0, angle=math.radians(90))
    upright, turned = (centers(obj)[taken(obj, name)][:, ::2] - [0, 1] for name in ("L", "L.001"))
    assert np.ptp(upright[:, 1]) == pytest.approx(1.0, abs=0.03) == np.ptp(turned[:, 0])
    # An L's foot points right; turned against the clock it points up, at the right end of the stem that now lies.
    assert upright[upright[:, 0] > 0.2][:, 1].max() < -0.3
    assert turned[turned[:, 1] > 0.2][:, 0].min() > 0.3
    bpy.ops.cloak.stamp_drag(place=(0, 0, 1), height=0.5)
    assert taken(obj, "L.002").sum() == pytest.approx(taken(obj, "L").sum() / 4, rel=0.1)


def test_it_takes_only_what_is_seen_from_its_side():
    obj = make_egg(40)
    bpy.context.scene.cloak.stamp_kind = "SMILEY"
    bpy.ops.cloak.stamp_drag(place=(0, 0.25, 1), direction=(0, -1, 0), height=0.5)
    assert (centers(obj)[taken(obj, "Smiley")][:, 1] > 0).all()
    with pytest.raises(RuntimeError, match="covers no visible face"):
        bpy.ops.cloak.stamp_drag(place=(5, 0, 1), height=0.5)
    bpy.ops.cloak.stamp_drag(place=(0, 0, 1.8), direction=(0, 0, -1), height=0.5)  # from straight above
    assert (centers(obj)[taken(obj, "Smiley.001")][:, 2] > 0.9).all()


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
