"""The asset library that comes with the extension: ready cloths as materials, laid at true size."""

from pathlib import Path

import bpy
import numpy as np
import pytest
from cloak.blender import mesh_arrays, pictures
from cloak.body.samples import ASSETS
from cloths_made import wall

PRINTS = {f"print-{name}" for name in ("balls", "ellipses", "crowd", "dots", "checks", "stripes")}


@pytest.fixture
def library() -> Path:
    """The library's file, found as the Asset Browser finds it."""
    (ours,) = (found for found in bpy.context.preferences.filepaths.asset_libraries if found.name == "Cloak")
    (file,) = Path(ours.path).glob("*.blend")
    return file


def take(file: Path, name: str) -> bpy.types.Material:
    """What dragging an asset onto an object brings into the file."""
    with bpy.data.libraries.load(str(file), assets_only=True) as (there, here):
        here.materials = [name]
    assert name in there.materials
    return here.materials[0]


def test_every_cloth_of_ours_is_an_asset(library):
    with bpy.data.libraries.load(str(library), assets_only=True) as (there, here):
        here.materials = list(there.materials)
    assert {material.name for material in here.materials} == PRINTS | {"transfer-people"}
    for material in here.materials:
        assert material.asset_data.license == "CC0-1.0" and "0.25 m" in material.asset_data.description
        assert tuple(material.preview.image_size) == (128, 128)
        assert np.ptp(np.array(material.preview.image_pixels_float).reshape(-1, 4)[:, :3]) > 0.5, "a picture of it"
    image = pictures.cloth_of(bpy.data.materials["transfer-people"])
    there = pictures.read_picture(ASSETS / "transfer-people" / "cloth.png")
    assert image.packed_file and np.array_equal(pictures.image_pixels(image), there)


def test_a_cloth_is_laid_as_large_as_it_is_printed(library):
    obj = wall(0.5)
    with pytest.raises(RuntimeError, match="drag one from the Asset Browser"):
        bpy.ops.cloak.lay_cloth()
    obj.data.materials.append(take(library, "print-dots"))
    bpy.ops.cloak.lay_cloth()
    uv = mesh_arrays.read(obj.data.uv_layers["cloak.ready_cloth"].uv, "vector", 2)
    assert np.allclose([uv.min(0), uv.max(0)], [[-1, -1], [1, 1]], atol=1e-5), "two pieces of 25 cm along half a metre"
    assert obj.data.uv_layers.active.name == "UVMap", "the user's own"
    (node,) = (n for n in obj.active_material.node_tree.nodes if n.bl_idname == "ShaderNodeUVMap")
    assert node.uv_map == "cloak.ready_cloth"


def test_a_map_of_the_users_is_left_alone(library):
    obj = wall(0.5)
    obj.data.uv_layers.new(name="cloak.ready_cloth").uv.foreach_set("vector", np.full(72, 0.25, np.float32))
    obj.data.materials.append(take(library, "print-dots"))
    bpy.ops.cloak.lay_cloth()
    (node,) = (n for n in obj.active_material.node_tree.nodes if n.bl_idname == "ShaderNodeUVMap")
    assert node.uv_map == "cloak.ready_cloth.001"
    assert np.allclose(mesh_arrays.read(obj.data.uv_layers["cloak.ready_cloth"].uv, "vector", 2), 0.25)
