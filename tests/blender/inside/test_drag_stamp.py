"""The stamp that is dragged over the body: what it takes where it lies, and how quickly it follows."""

import math

import bpy
import numpy as np
import pytest
from cloak.blender import faces
from cloak.blender.occlusion import seen
from cloak.blender.surface import read_surface
from cloak.logo import stamp
from made import centers, make_egg, make_fine_egg, make_grid, set_mode
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


@pytest.mark.parametrize(("kind", "name"), [("LETTER", "G"), ("SMILEY", "Smiley")])
def test_the_papers_stamps_are_presets(kind, name):
    obj = make_egg()
    bpy.ops.cloak.stamp_drag(kind=kind, place=(0, -0.25, 1), height=0.4)
    assert taken(obj, name).any() and obj.cloak.logo == name


def test_a_mirrored_body_is_refused_with_the_reason():
    obj = make_egg()
    obj.scale.x = -1
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match=r"poll\(\).*negative scale"):
        bpy.ops.cloak.stamp_drag(place=(0, -0.25, 1))


def test_moving_over_a_body_hides_what_lies_behind_as_a_fresh_look_does():
    """What is remembered from place to place is what one would see anew; a body with a plate before it."""
    obj = make_egg(40)
    plate = make_grid(500, "Plate")
    plate.matrix_world = Matrix.Translation((0.1, -0.5, 0.6)) @ Matrix.Scale(0.2, 4)
    with bpy.context.temp_override(active_object=obj, selected_editable_objects=[obj, plate]):
        bpy.ops.object.join()
    bpy.context.view_layer.objects.active = obj
    surface, ink = read_surface(bpy.context, obj), stamp.smiley_stamp()
    moving = stamp.Placed(surface, ink)
    for x, height, angle in ((-0.1, 0.3, 0), (0, 0.35, 0.3), (0.1, 0.5, 0.6), (0.05, 0.5, 0.6)):
        placement = stamp.laid(np.array([x, -0.3, 0.9]), np.array([0.2, 1, 0]), height, 1.0, angle)
        fresh = stamp.Placed(surface, ink).faces(placement)
        assert np.array_equal(np.sort(moving.faces(placement)), np.sort(fresh)) and len(fresh) >= 40
    assert (surface.centers[fresh][:, 1] < -0.4).any()


def test_the_preview_looks_at_little_of_300_000_faces(monkeypatch):
    """What makes it quick: what may hide is looked for near by, and from one side no face is asked about twice."""
    obj = make_fine_egg(300_000)
    set_mode("EDIT")
    placed = stamp.Placed(read_surface(bpy.context, obj), stamp.text_stamp("G"))
    asked, hiding = [], []

    def look(centers, own, points, triangles, face):
        asked.extend(own.tolist())
        hiding.append(len(triangles))
        return seen(centers, own, points, triangles, face)

    monkeypatch.setattr(stamp, "seen", look)
    for step in range(5):  # a perspective view: the direction changes with every move
        place, direction = np.array([0.02 * step, -0.25, 1]), np.array([0.02 * step, 1, 0])
        assert len(placed.faces(stamp.laid(place, direction, 0.5, placed.aspect))) > 3000
    assert len(hiding) == 5 and max(hiding) < 300_000 < len(placed.surface.centers) * 2
    asked.clear()
    for step in range(5):  # the mouse wheel and R: it does not
        assert len(placed.faces(stamp.laid(place, direction, 0.5 - 0.01 * step, placed.aspect, 0.1 * step))) > 3000
    assert asked and len(set(asked)) == len(asked) < 30_000
