import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cloak_core.core.cameras import Camera
from cloak_core.core.geometry import face_areas, face_centres
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.meshes.subdivision import projected_areas, resolution, subdivide
from tests.sources.bodies.solids import CUBE, CUBE_FACES, cube, is_closed, sphere


def test_counts_of_the_papers_mesh() -> None:
    """SMPL's quad release under Blender's Simple subdivision: 27,578 vertices and 27,576 quads."""
    body = sphere(columns=12, rows=573)
    assert (np.sum(body.loop_total == 4), np.sum(body.loop_total == 3)) == (6876, 24)
    assert body.vertex_count == 6890
    divided, parent = subdivide(body)
    assert (divided.vertex_count, divided.face_count, divided.triangle_count) == (27578, 27576, 55152)
    assert (divided.loop_total == 4).all()
    assert np.array_equal(np.bincount(parent), body.loop_total)
    assert is_closed(divided.triangles)


def test_colours_regions_and_names_follow_the_parent() -> None:
    top = np.arange(6) == 3
    body = cube(face_colors=np.arange(18, dtype=np.float32).reshape(1, 6, 3) / 18, regions={"top": top}, names=("a",))
    divided, parent = subdivide(body, 2)
    assert divided.face_count == 96
    assert np.array_equal(divided.face_colors, body.face_colors[:, parent])
    assert np.array_equal(divided.regions["top"], top[parent])
    assert np.allclose(face_centres(divided)[divided.regions["top"], 1], 1)
    assert divided.names == ("a",) and divided.topology != body.topology


def test_texture_coordinates_follow_across_a_seam() -> None:
    """Each cube face is mapped on the whole unit square, so every edge is a seam."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    corner = {(face, vertex): i for face, loop in enumerate(CUBE_FACES) for i, vertex in enumerate(loop)}
    body = cube()
    uv = np.tile(square, (6, 1))
    triangle_uv = np.array(
        [[4 * f + corner[f, v] for v in t] for f, t in zip(body.triangle_face, body.triangles.tolist(), strict=True)]
    )
    textured = cube(uv=uv, triangle_uv=triangle_uv)
    divided, parent = subdivide(textured)
    assert divided.uv.shape == (24 + 24 + 6, 2)
    # The map from a face's surface to its square is linear: check it at every corner of every small triangle.
    for face, loop in enumerate(CUBE_FACES):
        origin, u, v = CUBE[loop[0]], CUBE[loop[1]] - CUBE[loop[0]], CUBE[loop[3]] - CUBE[loop[0]]
        of_face = parent[divided.triangle_face] == face
        local = divided.vertices[0][divided.triangles[of_face]] - origin
        assert np.allclose(divided.uv[divided.triangle_uv[of_face]], np.stack([local @ u, local @ v], axis=-1))


@given(columns=st.integers(3, 7), rows=st.integers(1, 5), levels=st.integers(0, 3))
@settings(max_examples=25)
def test_closed_bodies_stay_closed_and_keep_their_corners(columns: int, rows: int, levels: int) -> None:
    body = sphere(columns, rows)
    divided, parent = subdivide(body, levels)
    edges = int(body.loop_total.sum()) // 2
    if levels == 1:
        assert divided.vertex_count == body.vertex_count + edges + body.face_count
    assert is_closed(divided.triangles)
    assert np.array_equal(divided.vertices[:, : body.vertex_count], body.vertices)
    # Euler: a globe stays a globe, no vertex is doubled.
    assert divided.vertex_count - int(divided.loop_total.sum()) // 2 + divided.face_count == 2
    # Children lie side by side, in their parents' order.
    assert (np.diff(parent) >= 0).all() and parent[-1] == body.face_count - 1


def test_triangle_meshes_split_one_to_four() -> None:
    body = cube()
    triangles = Bodies(body.vertices, body.triangles)
    divided, parent = subdivide(triangles)
    assert (divided.vertex_count, divided.face_count) == (8 + 18, 48)
    assert np.array_equal(parent, np.repeat(np.arange(12), 4))
    assert is_closed(divided.triangles)
    assert np.allclose(face_areas(divided), np.repeat(face_areas(triangles) / 4, 4))


def test_the_front_of_a_cube_has_the_area_that_its_distance_gives() -> None:
    camera = Camera(distance=3.0, elevation=0.0, width=400, height=400)
    areas = projected_areas(cube(), camera)
    focal = 200 / math.tan(math.radians(30))
    assert areas[5] == pytest.approx((focal / 2.5) ** 2)  # the front is half a metre nearer than the pivot
    assert np.allclose(areas[[0, 1, 2, 3, 4]], 0)


def test_a_camera_inside_the_body_is_refused() -> None:
    with pytest.raises(InputError, match="behind the camera"):
        resolution(cube(), Camera(distance=0.3))
