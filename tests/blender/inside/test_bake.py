"""Step 5, out of Blender: the cloak as an image on the body's own texture coordinates."""

from contextlib import contextmanager

import bpy
import numpy as np
import pytest
from cloak.blender import colors, occlusion
from cloak.blender.pictures import image_pixels
from cloak.result import bake, outputs
from cloak.ui import bases
from made import make_egg


def dressed_egg() -> tuple[bpy.types.Object, np.ndarray]:
    obj = make_egg(12)
    trained = np.random.default_rng(0).random((len(obj.data.polygons), 3)).astype(np.float32)
    colors.write_face_colors(obj, "colors", trained)
    return obj, trained


def unwrap(obj) -> np.ndarray:
    """Each face in a cell of its own; returns the middles [F, 2]."""
    side = int(np.ceil(len(obj.data.polygons) ** 0.5))
    layer = obj.data.uv_layers.new(name="UV")
    middles = []
    for polygon in obj.data.polygons:
        low = np.array([polygon.index % side, polygon.index // side]) / side
        ring = [(0.1, 0.1), (0.9, 0.1), (0.9, 0.9), (0.1, 0.9)]
        for loop, corner in zip(polygon.loop_indices, ring, strict=False):
            layer.uv[loop].vector = low + np.array(corner) / side
        middles.append(low + np.array([0.5, 0.4]) / side)
    return np.array(middles)


def test_each_face_finds_its_colour_in_the_image():
    obj, trained = dressed_egg()
    middles = unwrap(obj)
    bpy.ops.cloak.bake(size=512)
    image = bpy.data.images["Body cloak"]
    pixels = image_pixels(image)
    x, y = (middles * 512).astype(int).T
    assert np.abs(pixels[y, x, :3] - trained).max() < 1.01 / 255 and (pixels[y, x, 3] == 1).all()
    assert image.packed_file is not None
    material = bpy.data.materials["Body cloak"]
    assert material.asset_data is not None
    obj.data.materials.clear()
    obj.data.materials.append(material)
    assert np.abs(colors.own_face_colors(obj) - trained).max() < 1.01 / 255  # it shows what was baked


@pytest.mark.parametrize(("name", "module"), [("bake", bases), ("export_glb", outputs)])
def test_while_it_bakes_the_mouse_pointer_counts_up(monkeypatch, tmp_path, name, module):
    obj, _ = dressed_egg()
    unwrap(obj)
    told = []

    @contextmanager
    def pointer():
        told.append("begins")
        yield
        told.append("ends")

    monkeypatch.setattr(module, "progress_cursor", pointer)
    monkeypatch.setattr(bake, "show_progress", told.append)
    monkeypatch.setattr(occlusion, "MAX_PAIRS", 10_000)  # as an image of 4096 x 4096 has many times the usual
    options = {} if name == "bake" else {"filepath": str(tmp_path / "body.glb")}
    getattr(bpy.ops.cloak, name)(size=256, **options)
    first, *shares, last = told
    assert (first, last) == ("begins", "ends") and shares == sorted(shares)
    assert np.diff([0, *shares, 1]).max() < 0.2, "never long without a step"


def test_the_nearest_triangle_in_each_cell_is_the_one_that_all_of_them_say():
    """Among them many that are smaller than a cell, as on a fine mesh."""
    rng = np.random.default_rng(2)
    corners = 12 * rng.random((300, 1, 3)) + rng.choice([0.02, 0.8], (300, 1, 1)) * rng.normal(size=(300, 3, 3))
    depth, owner = occlusion.depth_buffer(corners.reshape(-1, 3), np.arange(900).reshape(-1, 3), (12, 10))
    y, x = np.mgrid[:10, :12].reshape(2, -1) + 0.5
    systems = np.concatenate([corners[:, :, :2].transpose(0, 2, 1), np.ones((300, 1, 3))], 1)
    weights = np.linalg.inv(systems) @ np.stack([x, y, np.ones(120)])  # [triangle, corner, cell]
    nearness = np.where((weights >= 0).all(1), (weights * corners[:, :, 2:]).sum(1), -np.inf)
    assert np.allclose(depth.ravel(), nearness.max(0)) and 30 < (owner >= 0).sum() < 120
    assert np.array_equal(owner.ravel(), np.where(np.isfinite(nearness.max(0)), nearness.argmax(0), -1))


def test_a_map_of_its_own_where_there_is_none_or_too_little_room():
    obj, trained = dressed_egg()
    bpy.ops.cloak.bake(size=256)
    pixels = image_pixels(bpy.data.images["Body cloak"])
    assert [layer.name for layer in obj.data.uv_layers] == ["cloak.uv"]
    assert bake.faces_off(obj.data, "cloak.uv", pixels, trained) == 0
    assert np.array_equal(pixels[:, -1], pixels[:, -2]), "what is left over beside the last square has its colour"
    corners = np.array([uv.vector for uv in obj.data.uv_layers["cloak.uv"].uv])
    x, y = (corners * 256).astype(int).T
    own = np.repeat(trained, [len(p.vertices) for p in obj.data.polygons], axis=0)
    assert np.abs(pixels[y, x, :3] - own).max() < 1.01 / 255, "up to its corners"
    other, trained = dressed_egg()
    unwrap(other)
    layer = other.data.uv_layers.active
    for uv in layer.uv:
        uv.vector = uv.vector * 0.01
    done = bake.bake(other, 256)
    assert (done.uv_map, done.off) == ("cloak.uv", 0) and done.off_before > 200
    assert other.data.uv_layers.active.name == "UV", "the user's map stays the active one"
    material = bake.baked_material(done.image, done.uv_map)
    nodes = material.node_tree.nodes
    assert tuple(material.preview.image_size) == (128, 128), "not one that Blender renders meanwhile"
    assert [node.uv_map for node in nodes if node.bl_idname == "ShaderNodeUVMap"] == ["cloak.uv"]


def test_the_body_and_what_it_wears_go_into_a_glb_that_shows_the_colours(tmp_path):
    obj, trained = dressed_egg()
    before = [o.name for o in bpy.data.objects], [slot.name for slot in obj.material_slots]
    bpy.ops.cloak.export_glb(filepath=str(tmp_path / "body.glb"), size=256)
    assert ([o.name for o in bpy.data.objects], [slot.name for slot in obj.material_slots]) == before
    assert (tmp_path / "body.glb").read_bytes().startswith(b"glTF") and bpy.context.object is obj
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "body.glb"))
    (mesh,) = (o for o in bpy.data.objects if o.type == "MESH")
    (image,) = (i for i in bpy.data.images if i.size[0])
    seen = set(map(tuple, (image_pixels(image)[..., :3].reshape(-1, 3) * 255).round().astype(int).tolist()))
    wanted = set(map(tuple, (trained * 255).round().astype(int).tolist()))
    assert len(wanted & seen) > 0.9 * len(wanted) and len(mesh.data.polygons) > 0
