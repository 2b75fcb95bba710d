"""Step 1: which objects are taken, subdivision, and bodies built from a scene package."""

import bpy
import numpy as np
import pytest
from cloak.blender import faces
from cloak.blender.mesh_arrays import box_of, read, topology
from cloak.body import objects as body
from cloak.body.panel import CLOAK_PT_body
from cloak.exchange.bodies import Bodies
from cloak.files.errors import InputError
from cloak.poses.export import poses_reason
from conftest import drawn, run_job
from made import add_ngons, link, make_egg, set_mode


def error_of(obj) -> str:
    with pytest.raises(InputError) as caught:
        body.require_body(obj)
    return str(caught.value)


def test_objects_that_are_no_body_are_refused_with_what_to_do():
    assert "click the character's mesh" in error_of(None)
    armature = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.collection.objects.link(armature)
    assert "'Rig' is not a mesh (armature)" in error_of(armature)
    worn = make_egg(6, name="Skin")
    worn.parent = armature
    bpy.context.view_layer.update()
    assert "click 'Skin' instead" in error_of(armature)
    assert "has no faces" in error_of(link(bpy.data.meshes.new("Empty"), "Empty"))


def test_shared_meshes_are_refused():
    obj = make_egg(6)
    twin = bpy.data.objects.new("Twin", obj.data)
    assert "shared by 2 objects: Object > Relations > Make Single User" in error_of(obj)
    bpy.data.objects.remove(twin)
    obj.data.use_fake_user = True
    body.require_body(obj)


def test_linked_objects_are_refused(tmp_path):
    make_egg(6, name="Hero")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, target):
        target.objects = ["Hero"]
    hero = target.objects[0]
    bpy.context.collection.objects.link(hero)
    assert "is linked from library.blend" in error_of(hero) and "Make Local" in error_of(hero)


def test_mirrored_and_flattened_bodies_are_refused():
    obj = make_egg(6)
    obj.scale.x = -1
    bpy.context.view_layer.update()
    with pytest.raises(InputError, match=r"negative scale.*apply it"):
        body.require_upright(obj)
    assert "negative scale" in poses_reason(bpy.context)
    obj.scale.x = 0
    bpy.context.view_layer.update()
    with pytest.raises(InputError, match="scaled to nothing"):
        body.require_upright(obj)


# --- subdivision -----------------------------------------------------------------------------------------------------


def count_by_corners(obj) -> dict[int, int]:
    totals, counts = np.unique([len(p.vertices) for p in obj.data.polygons], return_counts=True)
    return dict(zip(totals.tolist(), counts.tolist(), strict=True))


def test_quads_and_ngons_split_as_simple_subdivision_does():
    obj = make_egg(8)
    add_ngons(obj)
    corners = count_by_corners(obj)
    assert set(corners) == {3, 4, 6}
    reference = bpy.data.objects.new("reference", obj.data.copy())
    bpy.context.collection.objects.link(reference)
    modifier = reference.modifiers.new("s", "SUBSURF")
    modifier.subdivision_type, modifier.levels = "SIMPLE", 1
    smooth = reference.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    expected = np.array([v.co[:] for v in smooth.vertices])
    body.subdivide(obj, triangulate=False)
    # Blender's modifier makes three quads of a triangle; four triangles are wanted here, without a middle vertex.
    assert count_by_corners(obj) == {3: 4 * corners[3], 4: 4 * corners[4] + 6 * corners[6]}
    assert len(obj.data.vertices) == len(expected) - corners[3]
    from mathutils.kdtree import KDTree

    tree = KDTree(len(expected))
    for index, point in enumerate(expected):
        tree.insert(point, index)
    tree.balance()
    assert max(tree.find(v.co)[2] for v in obj.data.vertices) < 1e-6


@pytest.mark.parametrize("triangulate", [True, False])
@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
def test_everything_on_the_mesh_carries_over(mode, triangulate):
    obj = make_egg(8)
    add_ngons(obj)
    mesh = obj.data
    count = len(mesh.polygons)
    rng = np.random.default_rng(3)
    logo, slots = rng.random(count) < 0.3, rng.integers(0, 2, count).astype(np.int32)
    for name in ("skin", "cloth"):
        mesh.materials.append(bpy.data.materials.new(name))
    mesh.polygons.foreach_set("material_index", slots)
    uv = mesh.uv_layers.new(name="UV")
    uv.uv.foreach_set("vector", rng.random(2 * len(mesh.loops)).astype(np.float32))
    faces.write_faces(obj, "chest", logo)
    group = obj.vertex_groups.new(name="all")
    group.add(range(len(mesh.vertices)), 0.75, "REPLACE")
    obj.shape_key_add(name="Basis")
    raised = obj.shape_key_add(name="Raised")
    for point in raised.data:
        point.co.z += 0.5
    hidden = np.zeros(count, bool)
    hidden[:5] = True
    mesh.polygons.foreach_set("hide", hidden)
    areas = read(mesh.polygons, "area")
    corners = np.array([len(polygon.vertices) for polygon in mesh.polygons])
    if mode == "EDIT":
        set_mode("EDIT")
    body.subdivide(obj, triangulate)
    if mode == "EDIT":
        set_mode("OBJECT")
    mesh = obj.data
    parent = read(mesh.attributes["cloak.original_face"].data, "value", dtype=np.int32)
    assert np.array_equal(read(mesh.polygons, "material_index", dtype=np.int32), slots[parent])
    assert np.array_equal(read(mesh.polygons, "hide", dtype=bool), hidden[parent])
    assert np.array_equal(faces.read_faces(obj, "chest"), logo[parent])
    assert len(mesh.uv_layers) == 1 and {m.name for m in mesh.materials} == {"skin", "cloth"}
    assert [key.name for key in mesh.shape_keys.key_blocks] == ["Basis", "Raised"]
    lifted = [b.co.z - a.co.z for a, b in zip(*(k.data for k in mesh.shape_keys.key_blocks), strict=True)]
    assert np.allclose(lifted, 0.5, atol=1e-6)
    weights = [sum(g.weight for g in v.groups) for v in mesh.vertices]
    assert np.allclose(weights, 0.75, atol=1e-6)
    assert "cloak.hidden" not in mesh.attributes
    # Subdivision is simple: a face's pieces together have its area. The n-gons here are folded, so about.
    pieces = np.bincount(parent, read(mesh.polygons, "area"), count)
    assert np.allclose(pieces[corners <= 4], areas[corners <= 4], rtol=1e-4)
    assert np.allclose(pieces, areas, rtol=0.1)


# --- bodies from scenes ----------------------------------------------------------------------------------------------


def made_bodies() -> Bodies:
    """Two quads and a pentagon in three poses."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0], [1.5, 2, 0]], np.float32)
    loops = np.array([0, 1, 2, 3, 1, 4, 5, 2, 3, 2, 5, 6], np.int32)
    return Bodies(
        vertices=np.stack([points, points + 1, points * 2]),
        triangles=np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2], [3, 2, 5], [3, 5, 6]], np.int32),
        triangle_face=np.array([0, 0, 1, 1, 2, 2], np.int32),
        face_colors=np.array(
            [[[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [1, 0, 1]], [[0, 0, 0], [1, 1, 1], [0, 1, 0]]], np.float32
        ),
        regions={"chest": np.array([True, False, True])},
        names=("Ann", "Bob", "Cleo"),
        loop_total=np.array([4, 4, 4], np.int32),
        loop_vertices=loops,
        name="Crowd",
    )


def test_a_scene_becomes_a_body_and_back():
    from cloak.poses.export import export_bodies
    from cloak.poses.poses import PoseChoice

    bodies = made_bodies()
    obj = body.add_from_scene(bpy.context, bodies)
    assert faces.logo_names(obj.data) == ["chest"]
    assert topology(obj) == bodies.topology
    again = export_bodies(bpy.context, obj, PoseChoice("RANGE", 1, 3, 1))[0]
    assert np.allclose(again.vertices, bodies.vertices, atol=1e-6)
    assert np.allclose(again.face_colors, bodies.face_colors, atol=1e-3)
    assert again.topology == bodies.topology


@pytest.mark.parametrize("people", ["BARE", "CLOTHED"])
def test_add_sample_body(stub, people):
    """Beside the cube of a new file, which is no body yet: Try It is offered."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    assert bpy.context.object.name == "Cube" and "cloak.try_it" in drawn(CLOAK_PT_body)
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 3, 500
    bpy.context.scene.frame_set(7)
    bpy.ops.cloak.add_sample_body(people=people)
    job = run_job()
    assert job.state == "done", job.message
    obj = bpy.context.view_layer.objects.active
    assert obj.name == "Sample Body" and "cloak.try_it" not in drawn(CLOAK_PT_body)
    assert obj.cloak.logo == ("chest" if people == "BARE" else "clothes") and "chest" in faces.logo_names(obj.data)
    bpy.context.view_layer.update()
    cube = box_of(bpy.data.objects["Cube"])
    for one in (obj, *obj.children):
        assert (box_of(one)[0] >= cube[1]).any() or (box_of(one)[1] <= cube[0]).any(), "beside the cube, not in it"
    assert [k.name for k in obj.data.shape_keys.key_blocks] == ["Ann", "Bob"]
    settings = bpy.context.scene.cloak
    assert (settings.pose_source, settings.frame_start, settings.frame_end) == ("RANGE", 1, 2)
    scene = bpy.context.scene
    assert (scene.frame_start, scene.frame_end, scene.frame_current) == (3, 500, 7), "the animation stays the user's"
    bpy.context.scene.frame_set(2)
    posed = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    assert max((obj.matrix_world @ v.co).z for v in posed.data.vertices) == pytest.approx(2.2, abs=1e-5)
