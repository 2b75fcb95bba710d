"""Step 2: logos of what belongs together already."""

import bpy
import numpy as np
import pytest
from cloak.blender import faces
from cloak.logo import operators
from made import centers, make_egg, set_mode


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
@pytest.mark.parametrize(("name", "title"), [("Körper teile", "Körper teile 7"), (".sculpt_face_set", "Face Set 7")])
def test_a_logo_of_a_face_set_or_of_any_integer_attribute(mode, name, title):
    obj = make_egg()
    upper = centers(obj)[:, 2] > 0.9
    with pytest.raises(RuntimeError, match=r"poll\(\).*no face sets"):
        bpy.ops.cloak.logo_from_face_set()
    values = obj.data.attributes.new(name, "INT", "FACE").data
    values.foreach_set("value", np.where(upper, 7, -1).astype(np.int32))
    set_mode(mode)
    assert [value for value, _, _ in operators.face_sets(obj)] == [f"-1 {name}", f"7 {name}"]
    bpy.ops.cloak.logo_from_face_set(face_set=f"7 {name}")
    assert np.array_equal(taken(obj, title), np.flatnonzero(upper))


def test_without_materials_the_button_says_so():
    make_egg()
    with pytest.raises(RuntimeError, match="The body has no materials"):
        bpy.ops.cloak.logo_from_material()
