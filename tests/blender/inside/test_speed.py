"""What makes picking quick on large meshes answers as the plain way does; tools/blender/latencies.py measures."""

import bpy
import numpy as np
import pytest
from cloak.blender import faces, mesh_arrays, occlusion
from cloak.session import session
from made import make_egg, set_mode

FACES = 100_000


def test_selecting_and_moving_an_object_do_not_count_as_changes_of_the_logo():
    obj = make_egg()
    faces.new_logo(obj, "a", np.arange(len(obj.data.polygons)) < 9)
    set_mode("EDIT")
    bpy.context.view_layer.update()
    before = session.mesh_changes
    bpy.ops.mesh.select_all(action="INVERT")
    bpy.context.view_layer.update()
    assert session.mesh_changes == before
    set_mode("OBJECT")
    bpy.context.view_layer.update()
    before = session.mesh_changes
    obj.location.x += 1
    bpy.context.view_layer.update()
    assert session.mesh_changes == before
    obj.data.vertices[0].co.z += 1
    obj.data.update_tag()
    bpy.context.view_layer.update()
    assert session.mesh_changes > before


def test_the_copy_of_an_edited_mesh_ages_with_each_change():
    obj = make_egg()
    faces.new_logo(obj, "a", np.arange(len(obj.data.polygons)) < 9)
    set_mode("EDIT")
    with mesh_arrays.current_mesh(obj) as outer:
        with mesh_arrays.current_mesh(obj) as inner:
            assert inner == outer
        faces.write_faces(obj, "a", np.arange(mesh_arrays.face_count(obj)) < 3)
        assert faces.read_faces(obj, "a").sum() == 3
        faces.write_faces(obj, "a", np.arange(mesh_arrays.face_count(obj)) < 5)
        only = np.arange(mesh_arrays.face_count(obj)) == 7
        faces.write_faces(obj, "a", only, where=only)
        assert faces.read_faces(obj, "a").sum() == 6
    assert not [mesh.name for mesh in bpy.data.meshes if mesh.name.startswith(".cloak")]


@pytest.mark.parametrize("spread", [0.0, 1.0])
def test_what_is_seen_is_what_a_ray_meets_first(spread):
    rng = np.random.default_rng(2)
    corners = rng.random((300, 1, 3)) + rng.normal(0, 0.03 + 0.2 * spread * rng.random((300, 1, 1)), (300, 3, 3))
    points, own = corners.mean(1), np.arange(300)
    visible = occlusion.seen(points, own, corners.reshape(-1, 3), np.arange(900).reshape(-1, 3), own)
    systems = np.concatenate([corners[:, :, :2].transpose(0, 2, 1), np.ones((300, 1, 3))], 1)
    weights = np.linalg.inv(systems) @ np.c_[points[:, :2], np.ones(300)].T  # [triangle, corner, point]
    depth = (weights * corners[:, :, 2:]).sum(1)
    covered = (weights >= 0).all(1) & (depth > points[:, 2]) & ~np.eye(300, dtype=bool)
    assert np.array_equal(visible, ~covered.any(0)) and 10 < visible.sum() < 290
