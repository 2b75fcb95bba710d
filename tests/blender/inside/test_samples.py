"""Cloak's own people: clothed ones come as body and garments that wear one logo."""

import bpy
import numpy as np
import pytest
from cloak.blender import colors, faces
from cloak.blender.mesh_arrays import topology
from cloak.body import garments
from cloak.body.objects import CLOTHES, add_people
from cloak.exchange.bodies import Bodies
from cloak.exchange.face_lists import read_face_list
from cloak.exchange.scenes import read_scene
from cloak.logo import operators as heat
from cloak.poses import export as scene_export
from cloak.poses.poses import PoseChoice
from cloak.result.judging import check_reason
from made import made_run

QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]], np.int32)
"""Of a box whose corners are numbered in binary, z last."""


def made_clothed() -> Bodies:
    """A box two metres tall, a wider one around its upper half and one around its lower, in two poses and outfits."""
    corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
    boxes = [
        corners * size + low
        for size, low in (((0.4, 2, 0.3), 0), ((0.6, 1, 0.5), (-0.1, 1, -0.1)), ((0.5, 0.9, 0.4), -0.05))
    ]
    loops = np.concatenate([QUADS + 8 * part for part in range(3)])
    owner = np.repeat(np.arange(3), 6)
    vertices = np.concatenate(boxes)
    regions = {name: owner == part for part, name in enumerate(("body", "shirt", "trousers"))}
    chest = regions["shirt"] & (np.arange(18) % 6 < 2)
    return Bodies(
        vertices=np.stack([vertices, vertices + np.array([0, 0.1, 0])]),
        triangles=np.stack([loops[:, [0, 1, 2]], loops[:, [0, 2, 3]]], 1).reshape(-1, 3),
        triangle_face=np.repeat(np.arange(18), 2).astype(np.int32),
        face_colors=np.random.default_rng(0).random((2, 18, 3)).astype(np.float32),
        regions={**regions, "chest": chest, "head": regions["body"] & (np.arange(18) == 3)},
        names=("walking-00", "walking-01"),
        loop_total=np.full(18, 4, np.int32),
        loop_vertices=loops.ravel(),
    )


@pytest.fixture
def clothed() -> bpy.types.Object:
    obj = add_people(bpy.context, made_clothed(), True, "Sample Body")
    obj.cloak.logo = CLOTHES
    settings = bpy.context.scene.cloak
    settings.pose_source, settings.frame_start, settings.frame_end = "RANGE", 1, 2
    bpy.context.view_layer.update()
    return obj


def exported(obj, tmp_path) -> scene_export.Export:
    return scene_export.export(bpy.context, obj, CLOTHES, PoseChoice("RANGE", 1, 2, 1), tmp_path / "run.input")


def test_body_and_garments_are_objects_with_names_and_logos_of_their_own(clothed):
    shirt, trousers = garments.worn_by(clothed)
    assert (clothed.name, shirt.name, trousers.name) == ("Sample Body", "Shirt", "Trousers")
    assert bpy.context.object == clothed and clothed.select_get() and not shirt.select_get()
    assert [len(o.data.polygons) for o in (clothed, shirt, trousers)] == [6, 6, 6]
    assert set(faces.logo_names(clothed.data)) == {CLOTHES, "shirt", "trousers", "chest", "head"}
    assert set(faces.logo_names(shirt.data)) == {CLOTHES, "shirt", "chest"}
    assert faces.read_faces(shirt, "chest").sum() == 2 and not faces.read_faces(clothed, "chest").any()
    for obj in (clothed, shirt, trousers):
        assert [key.name for key in obj.data.shape_keys.key_blocks] == ["walking-00", "walking-01"]


def test_an_export_has_the_faces_colours_and_poses_of_the_clothed_people(clothed, tmp_path):
    wanted, done = made_clothed(), exported(clothed, tmp_path)
    bodies = read_scene(done.scene)
    assert bodies.topology == wanted.topology and done.topology == topology(clothed) != wanted.topology
    assert np.allclose(bodies.vertices, wanted.vertices, atol=1e-6)
    assert np.allclose(bodies.face_colors, wanted.face_colors, atol=1e-3), "garments change with the body's outfits"
    assert read_face_list(done.face_list, bodies).ids.tolist() == list(range(6, 18))


def test_garments_alone_wear_the_cloak_and_take_it_off(clothed, tmp_path):
    exported(clothed, tmp_path)
    grey = np.full((12, 3), 0.75, np.float32)
    clothed.cloak.run = str(made_run(tmp_path, clothed, range(6, 18), grey, made_clothed().topology, "run"))
    bpy.ops.cloak.result_load()
    shirt = bpy.data.objects["Shirt"]
    assert garments.is_dressed(clothed) and not colors.is_dressed(clothed)
    assert np.allclose(colors.written_colors(shirt), 0.75, atol=1e-5)
    assert not check_reason(bpy.context)
    heat.show_heat(clothed, np.linspace(0, 1, 6))
    bpy.ops.cloak.heatmap_toggle()
    assert clothed.data.color_attributes.active_color_name == "cloak.colors", "what its clothing wears is shown again"
    bpy.ops.cloak.result_toggle()
    assert not garments.is_dressed(clothed)
    assert shirt.data.color_attributes.active_color_name == "cloak.outfit", (
        "or Solid shading would still show the cloak"
    )
