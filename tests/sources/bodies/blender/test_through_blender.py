"""Alembic, USD, FBX and .blend files, with the Blender that tools/setup_blender.sh brings."""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.blender import outside as through_blender
from cloak_core.sources.bodies.meshes.importing import import_bodies
from tests.sources.bodies.solids import is_closed

MAKE = """
import bpy, os, sys
import numpy as np
out = sys.argv[-1]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
bpy.ops.mesh.primitive_uv_sphere_add(segments=12, ring_count=8, radius=0.5, location=(0, 0, 1))
ball = bpy.context.object
red = bpy.data.materials.new("red")
red.use_nodes = True
red.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (1, 0, 0, 1)
ball.data.materials.append(red)
bpy.ops.mesh.primitive_cube_add(size=0.4, location=(1, -0.5, 1))
cube = bpy.context.object
ball.keyframe_insert("location", frame=1)
ball.location.z = 1.5
ball.keyframe_insert("location", frame=11)
scene.frame_start, scene.frame_end = 1, 11
bpy.ops.wm.alembic_export(filepath=out + "/a.abc", as_background_job=False)
bpy.ops.wm.usd_export(filepath=out + "/a.usdc", export_animation=True)
import addon_utils
addon_utils.enable("io_scene_fbx")
bpy.ops.export_scene.fbx(filepath=out + "/a.fbx", bake_anim=True)
image = bpy.data.images.new("halves", 4, 2)
image.pixels.foreach_set(np.tile(np.array([0, 0, 1, 1] * 2 + [0, 1, 0, 1] * 2, np.float32), 2))
image.pack()
skin = bpy.data.materials.new("skin")
skin.use_nodes = True
node = skin.node_tree.nodes.new("ShaderNodeTexImage")
node.image = image
skin.node_tree.links.new(node.outputs["Color"], skin.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
cube.data.materials.append(skin)
for uv in cube.data.uv_layers.active.uv:
    uv.vector = (0.25, 0.5)
bpy.ops.wm.save_as_mainfile(filepath=out + "/a.blend")
fewer = ball.modifiers.new("fewer", "DECIMATE")
fewer.keyframe_insert("ratio", frame=5)
fewer.ratio = 0.5
fewer.keyframe_insert("ratio", frame=6)
bpy.ops.wm.save_as_mainfile(filepath=out + "/b.blend")
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_uv_sphere_add(segments=12, ring_count=8, radius=0.9, location=(0, 0, 0.9))
bpy.ops.mesh.primitive_grid_add(x_subdivisions=6, y_subdivisions=6, size=1, location=(2, 0, 2))
bpy.context.object.modifiers.new("Falls", "CLOTH")
bpy.context.scene.frame_start, bpy.context.scene.frame_end = 1, 11
bpy.ops.wm.save_as_mainfile(filepath=out + "/c.blend")
sys.stdout.flush()
os._exit(0)
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball that rises 0.5 m within frames 1 to 11, and a cube before and beside it."""
    command = through_blender.blender_command("tests")
    out = tmp_path_factory.mktemp("made")
    (out / "make.py").write_text(MAKE)
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    subprocess.run([*command, str(out / "make.py"), "--", str(out)], check=True, capture_output=True, env=environment)
    return out


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a.abc", "a.usdc", "a.fbx", "a.blend"])
def test_animated_scenes(files: Path, name: str) -> None:
    read = import_bodies([files / name], frames=3)
    assert read.pose_count == 3 and is_closed(read.triangles)
    assert read.loop_total is not None and np.bincount(read.loop_total)[3:].tolist() == [24, 78]
    ball = np.ptp(read.vertices[0], axis=0)[0] > 0 and read.vertices[:, :, 0] < 0.7
    for pose, middle in enumerate((1.0, 1.25, 1.5)):
        y = read.vertices[pose, ball[pose], 1]
        assert (y.min() + y.max()) / 2 == pytest.approx(middle, abs=0.01), "y up, the ball rises"
    cube = read.vertices[0][~ball[0]]
    assert np.allclose(cube.mean(axis=0), [1, 1, 0.5], atol=1e-4), "what is before in Blender (-y) is at +z"
    if name != "a.abc":  # Alembic carries no materials
        assert (read.face_colors[0] == [1, 0, 0]).all(axis=1).sum() == 96


@pytest.mark.slow
def test_pictures_packed_in_a_blend_file(files: Path) -> None:
    read = import_bodies([files / "a.blend"])
    assert read.pose_count == 1 and read.outfit_textures == ("a",)
    blue = np.abs(read.face_colors[0] - [0, 0, 1]).max(axis=1) < 0.01
    assert blue.sum() == 6, "the cube's faces, by the picture's left half"


@pytest.mark.slow
def test_a_frame_of_another_topology_is_named(files: Path) -> None:
    with pytest.raises(InputError, match=r"b\.blend: frame 6 has another topology than frame 1"):
        import_bodies([files / "b.blend"], frames=3)


@pytest.mark.slow
def test_cloth_that_was_never_played_falls(files: Path) -> None:
    """Ever faster: Blender lets it lie where frames are jumped to."""
    read = import_bodies([files / "c.blend"], frames=3)
    fallen = -np.diff(read.vertices[:, read.vertices[0, :, 0] > 1, 1].mean(axis=1))
    assert 0.05 < fallen[0] < 0.25 and 2 * fallen[0] < fallen[1] < 0.7


@pytest.mark.slow
def test_what_cannot_be_read(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("no.abc", "no.blend"):
        (files / name).write_bytes(b"nothing of the kind")
        with pytest.raises(InputError, match=f"{name}: ."):
            import_bodies([files / name])
    monkeypatch.setattr(through_blender, "blender_version", lambda command: "")
    monkeypatch.setattr(through_blender.shutil, "which", lambda name: None)
    with pytest.raises(InputError, match=r"a\.abc: \.abc files are read through Blender, and there is no Blender"):
        import_bodies([files / "a.abc"])
