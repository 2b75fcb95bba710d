"""The brush: strokes as lists of places, in both modes; and the surface that it asks."""

import bpy
import numpy as np
import pytest
from cloak.blender import faces
from cloak.blender.evaluated import read_surface
from made import add_ngons, centers, logo_ids, make_egg, set_mode, stroke
from mathutils import Matrix, Vector

FRONT = (0.1, -0.24, 0.95)
"""A place on the egg's front, on one side."""


def paint(*dabs, **options) -> None:
    bpy.ops.cloak.logo_paint("EXEC_DEFAULT", True, stroke=stroke(*dabs), **options)


def on_egg(obj, x: float, z: float) -> tuple[float, float, float]:
    """Where a ray from the front meets the body."""
    return tuple(read_surface(bpy.context, obj).hits(np.array([x, -9, z]), np.array([0, 1, 0]))[0])


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
def test_a_stroke_makes_a_logo_adds_to_it_and_takes_from_it(mode):
    obj = make_egg()
    set_mode(mode)
    place = on_egg(obj, 0.1, 0.95)
    paint((place, 0.15))
    distance = np.linalg.norm(centers(obj) - place, axis=1)
    first = logo_ids(obj)
    assert np.array_equal(first, np.flatnonzero((distance <= 0.15) & (centers(obj)[:, 1] < 0))) and len(first) > 10
    paint((on_egg(obj, -0.2, 1.2), 0.1), (on_egg(obj, -0.2, 1.3), 0.1))
    both = logo_ids(obj)
    assert set(first) < set(both)
    paint((place, 0.15), action="REMOVE")
    assert set(logo_ids(obj)) == set(both) - set(first)
    assert obj.mode == mode and obj.cloak.logo == "Logo"


def test_a_brush_smaller_than_a_face_paints_the_face_it_touches():
    obj = make_egg(6)
    place = on_egg(obj, 0.07, 0.95)
    paint((place, 0.001))
    (only,) = logo_ids(obj)
    assert only == obj.closest_point_on_mesh(place)[3]


def test_what_looks_the_other_way_is_not_painted():
    """A sheet of two sides, closer to each other than the brush is wide."""
    obj = make_egg(40)
    obj.scale.y = 0.02
    bpy.context.view_layer.update()
    paint((on_egg(obj, 0.0, 0.9), 0.1))
    assert (centers(obj)[logo_ids(obj)][:, 1] < 0).all() and len(logo_ids(obj)) > 9


def test_a_mirrored_stroke_paints_both_sides_of_a_turned_body():
    obj = make_egg()
    obj.matrix_world = Matrix.Translation((3, 1, 2)) @ Matrix.Rotation(0.7, 4, "Z") @ Matrix.Scale(1.3, 4)
    bpy.context.view_layer.update()
    place = obj.matrix_world @ Vector(obj.data.polygons[int(np.argmax(centers(obj)[:, 0]))].center)
    paint((tuple(place), 0.2), mirror=True)
    logo = faces.read_faces(obj, "Logo")
    places = np.round(centers(obj)[logo], 3) + 0.0  # no negative zeros
    assert (places[:, 0] > 0).sum() == (places[:, 0] < 0).sum() > 3
    assert set(map(tuple, places.tolist())) == set(map(tuple, (places * [-1, 1, 1] + 0.0).tolist()))


def test_hidden_faces_and_posed_bodies():
    obj = make_egg()
    place = on_egg(obj, 0.1, 0.95)
    hidden = np.linalg.norm(centers(obj) - place, axis=1) < 0.08
    obj.data.polygons.foreach_set("hide", hidden)
    paint((place, 0.15))
    assert not faces.read_faces(obj, "Logo")[hidden].any() and len(logo_ids(obj)) > 5
    obj.data.polygons.foreach_set("hide", np.zeros(len(hidden), bool))
    obj.shape_key_add(name="Basis")
    key = obj.shape_key_add(name="Up")
    for point in key.data:
        point.co.z += 5
    key.value = 1
    bpy.ops.cloak.logo_remove()
    paint(((place[0], place[1], place[2] + 5), 0.15))
    assert len(logo_ids(obj)) > 10


def test_refusals():
    obj = make_egg()
    with pytest.raises(RuntimeError, match="has no logo"):
        paint((FRONT, 0.1), action="REMOVE")
    with pytest.raises(RuntimeError, match="touched no face"):
        paint()
    with pytest.raises(RuntimeError, match="touched no face"):
        paint(((9, 9, 9), 0.1))
    assert not faces.logo_names(obj.data)
    bpy.data.objects.remove(obj)
    with pytest.raises(RuntimeError, match="No active object"):
        paint((FRONT, 0.1))


def test_rays_meet_what_blender_says_they_meet():
    obj = make_egg(9)
    add_ngons(obj)
    obj.location = (2000, 0, 0)
    bpy.context.view_layer.update()
    surface = read_surface(bpy.context, obj)
    rng = np.random.default_rng(3)
    met = 0
    for _ in range(60):
        origin = np.array([2000, 0, 0.9]) + 2 * rng.normal(size=3)
        direction = np.array([2000, 0, 0.9]) + 0.4 * rng.normal(size=3) - origin
        hits = surface.hits(origin, direction)
        local = obj.matrix_world.inverted()
        found, place, _, face = obj.ray_cast(local @ Vector(origin), (local.to_3x3() @ Vector(direction)).normalized())
        assert found == bool(len(hits))
        if found:
            met += 1
            ngon = len(obj.data.polygons[face].vertices) > 4  # a fan of one that is not flat lies a little beside
            assert ngon or np.allclose(hits[0], obj.matrix_world @ place, atol=1e-3)
            assert ngon or surface.around(hits[0], 0.0).tolist() == [face]
    assert 10 < met < 60
