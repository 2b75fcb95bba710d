"""Step 2: logos of what belongs together already, and the paper's two stamps."""

import bpy
import numpy as np
import pytest
from cloak.blender import faces
from cloak.logo import overlay, pick
from made import centers, make_egg, make_grid, select_only, set_mode


def taken(obj, name: str) -> np.ndarray:
    return np.flatnonzero(faces.read_faces(obj, name))


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
def test_a_logo_of_a_material_counts_what_the_cloak_covers(mode):
    from cloak.blender import colors

    obj = make_egg()
    shirt = centers(obj)[:, 2] > 0.9
    for name in ("skin", "shirt"):
        obj.data.materials.append(bpy.data.materials.new(name))
    obj.data.polygons.foreach_set("material_index", shirt.astype(np.int32))
    colors.write_face_colors(obj, "colors", np.zeros((len(shirt), 3)))
    colors.dress(obj, np.flatnonzero(shirt)[:20])
    set_mode(mode)
    bpy.ops.cloak.logo_from_material(slot="1")
    assert obj.cloak.logo == "shirt" and np.array_equal(taken(obj, "shirt"), np.flatnonzero(shirt))
    bpy.ops.cloak.logo_from_material(slot="0", add=True)
    assert len(taken(obj, "shirt")) == len(shirt)


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
def test_a_logo_of_a_vertex_group_takes_whole_faces(mode):
    obj = make_egg()
    heavy = {v.index for v in obj.data.vertices if v.co.z > 0.9}
    group = obj.vertex_groups.new(name="upper")
    group.add(sorted(heavy), 0.7, "REPLACE")
    group.add([v.index for v in obj.data.vertices if v.index not in heavy], 0.2, "REPLACE")
    set_mode(mode)
    bpy.ops.cloak.logo_from_group(group="0")
    set_mode("OBJECT")
    expected = [p.index for p in obj.data.polygons if set(p.vertices) <= heavy]
    assert (
        taken(obj, "upper.001").tolist() == expected and expected
    )  # Blender keeps names of groups and attributes apart


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
@pytest.mark.parametrize(("name", "title"), [("Körper teile", "Körper teile 7"), (".sculpt_face_set", "Face Set 7")])
def test_a_logo_of_a_face_set_or_of_any_integer_attribute(mode, name, title):
    obj = make_egg()
    upper = centers(obj)[:, 2] > 0.9
    with pytest.raises(RuntimeError, match=r"poll\(\).*no face sets"):
        bpy.ops.cloak.logo_from_face_set()
    values = obj.data.attributes.new(name, "INT", "FACE").data
    values.foreach_set("value", np.where(upper, 7, -1).astype(np.int32))
    set_mode(mode)
    assert [value for value, _, _ in pick.face_sets(obj)] == [f"-1 {name}", f"7 {name}"]
    bpy.ops.cloak.logo_from_face_set(face_set=f"7 {name}")
    assert np.array_equal(taken(obj, title), np.flatnonzero(upper))


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
def test_a_logo_of_the_island_between_seams(mode):
    obj = make_egg()
    middle = 0.9
    for edge in obj.data.edges:
        heights = [obj.data.vertices[v].co.z for v in edge.vertices]
        edge.use_seam = max(abs(h - middle) for h in heights) < 1e-3
    above = centers(obj)[:, 2] > middle
    assert len(np.unique(pick.seam_islands(obj))) == 2
    select_only(obj, [int(np.flatnonzero(above)[0])])
    set_mode(mode)
    bpy.ops.cloak.logo_from_island()
    assert np.array_equal(taken(obj, "Island"), np.flatnonzero(above))


def test_islands_of_a_large_winding_mesh():
    obj = make_grid(60_000)
    assert not pick.seam_islands(obj).any()


def test_without_materials_or_groups_the_button_says_so():
    make_egg()
    with pytest.raises(RuntimeError, match="The body has no materials"):
        bpy.ops.cloak.logo_from_material()
    with pytest.raises(RuntimeError, match="The body has no vertex groups"):
        bpy.ops.cloak.logo_from_group()
    with pytest.raises(RuntimeError, match="No faces selected"):
        faces.select_faces(bpy.context.object, np.zeros(len(bpy.context.object.data.polygons), bool))
        bpy.ops.cloak.logo_from_island()


@pytest.mark.parametrize(("kind", "name"), [("TEXT", "G"), ("SMILEY", "Smiley")])
def test_the_papers_logos_take_the_papers_share_of_the_body(kind, name):
    obj = make_egg(60)
    bpy.ops.cloak.stamp_paper(kind=kind)
    mask = faces.read_faces(obj, name)
    assert overlay.worn_stats(obj, mask).area_share == pytest.approx(0.044, rel=0.1)
    assert (centers(obj)[mask][:, 1] < 0).all()
    assert bpy.context.scene.cloak.stamp_kind == kind
