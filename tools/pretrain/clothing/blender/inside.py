"""Runs inside Blender (imports nothing of Cloak): drapes one garment over a moving body by Blender's cloth solver.

    python inside.py -- IN.npz OUT.npz        (a Python that has bpy, or blender -b --factory-startup -P inside.py --)

IN: garment [S, V, 3] (where the cloth is held, frame by frame; the first frame is its cut), quads [F, 4], pin [V] and
wide [V] in 0 to 1, body [S, W, 3], body_quads [G, 4], and numbers: time_scale, stiffness, bending, mass, growth. All in
metres, y up. OUT: cloth [S, V, 3].
"""

import os
import sys
import tempfile
import traceback

import bpy
import numpy as np


def main() -> None:
    source, out = sys.argv[sys.argv.index("--") + 1 :]
    with np.load(source, allow_pickle=False) as stored:
        told = {key: stored[key] for key in stored.files}
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, len(told["garment"])
    with tempfile.TemporaryDirectory() as folder:
        moving(told["body"], told["body_quads"], "body", folder).modifiers.new("Collision", "COLLISION")
        body = bpy.data.objects["body"]
        body.collision.thickness_outer, body.collision.cloth_friction = 0.004, 8.0
        garment = moving(told["garment"], told["quads"], "garment", folder)
        sew(garment, told)
        np.savez(out, cloth=played(garment, scene))


def moving(frames: np.ndarray, quads: np.ndarray, name: str, folder: str) -> bpy.types.Object:
    """A mesh object whose vertices follow a PC2 cache."""
    frames = np.stack([frames[..., 0], -frames[..., 2], frames[..., 1]], -1).astype("<f4")
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(frames[0].tolist(), [], quads.tolist())
    mesh.update()
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    path = os.path.join(folder, name + ".pc2")
    with open(path, "wb") as file:
        file.write(b"POINTCACHE2\0" + np.array([1, frames.shape[1]], "<i4").tobytes())
        file.write(np.array([1.0, 1.0], "<f4").tobytes() + np.array([len(frames)], "<i4").tobytes() + frames.tobytes())
    cache = obj.modifiers.new("Motion", "MESH_CACHE")
    cache.cache_format, cache.filepath, cache.frame_start = "PC2", path, 1.0
    return obj


def sew(garment: bpy.types.Object, told: dict[str, np.ndarray]) -> None:
    """The cloth modifier: held where `pin` says, wider than it was cut where `wide` says."""
    for name in ("pin", "wide"):
        group = garment.vertex_groups.new(name=name)
        for index, weight in enumerate(told[name].tolist()):
            group.add([index], weight, "REPLACE")
    cloth = garment.modifiers.new("Cloth", "CLOTH")
    cloth.point_cache.frame_start, cloth.point_cache.frame_end = 1, len(told["garment"])
    made = cloth.settings
    made.quality, made.time_scale, made.mass = 5, float(told["time_scale"]), float(told["mass"])
    made.tension_stiffness = made.compression_stiffness = float(told["stiffness"])
    made.shear_stiffness, made.bending_stiffness = float(told["stiffness"]) / 3, float(told["bending"])
    made.tension_damping = made.compression_damping = 8.0
    made.air_damping = 1.5
    made.vertex_group_mass, made.pin_stiffness = "pin", 20.0 if 0 < told["pin"].min() else 1.0
    made.vertex_group_shrink, made.shrink_min, made.shrink_max = "wide", 0.0, -float(told["growth"])
    cloth.collision_settings.distance_min, cloth.collision_settings.collision_quality = 0.005, 2
    cloth.collision_settings.use_self_collision = False


def played(garment: bpy.types.Object, scene: bpy.types.Scene) -> np.ndarray:
    """The solver walks through the frames in order: positions [S, V, 3], y up."""
    frames = []
    for frame in range(1, scene.frame_end + 1):
        scene.frame_set(frame)
        mesh = garment.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        now = np.empty(len(mesh.vertices) * 3, np.float32)
        mesh.vertices.foreach_get("co", now)
        frames.append(now.reshape(-1, 3))
    cloth = np.stack(frames)
    return np.stack([cloth[..., 0], cloth[..., 2], -cloth[..., 1]], -1)


if __name__ == "__main__":
    code = 0
    try:
        main()
    except Exception:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # Blender as a package may wait for ever at a regular exit
