"""Runs inside Blender (imports nothing of Cloak): opens a file that Blender reads and writes its meshes as arrays.

    blender -b --factory-startup -P inside.py -- FILE FRAMES OUT.npz        (or a Python that has bpy)

FRAMES moments evenly over the animation, 0 for its first; all visible meshes make one, in Cloak's axes (y up, facing
+z) and metres. What is wrong with the file is one line in OUT.npz.error, with exit code 2.
"""

import os
import sys
import traceback

import bpy
import numpy as np


class Refused(Exception):
    """The file cannot be used; the message says why."""


def main() -> int:
    path, frames, out = sys.argv[sys.argv.index("--") + 1 :]
    try:
        open_file(path)
        np.savez(out, **scene_arrays(int(frames)))
    except (Refused, RuntimeError) as error:  # Blender's operators raise RuntimeError for what they cannot read
        with open(out + ".error", "w", encoding="utf-8") as file:
            file.write(str(error).strip().splitlines()[-1].removeprefix("Error: "))
        return 2
    return 0


def open_file(path: str) -> None:
    """Bring a file into an empty scene; scripts inside a .blend stay asleep."""
    suffix = os.path.splitext(path)[1].lower()
    if suffix == ".blend":
        bpy.ops.wm.open_mainfile(filepath=path, load_ui=False, use_scripts=False)
        return
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if suffix == ".abc":
        bpy.ops.wm.alembic_import(filepath=path, set_frame_range=True, as_background_job=False)
    elif suffix == ".fbx":
        import addon_utils

        addon_utils.enable("io_scene_fbx")
        bpy.ops.import_scene.fbx(filepath=path)
        ends = [action.frame_range for action in bpy.data.actions]
        if ends:
            bpy.context.scene.frame_start = int(min(end[0] for end in ends))
            bpy.context.scene.frame_end = int(max(end[1] for end in ends))
    else:
        bpy.ops.wm.usd_import(filepath=path, set_frame_range=True)


def scene_arrays(frames: int) -> dict[str, np.ndarray]:
    """Read poses [P, V, 3], polygons, their colours and pictures."""
    scene = bpy.context.scene
    objects = [obj for obj in scene.objects if obj.type == "MESH" and obj.visible_get()]
    moments = np.rint(np.linspace(scene.frame_start, scene.frame_end, max(frames, 1))).astype(int)
    poses = []
    first = None
    # How something lies may follow from the frames before: where anything is simulated, every frame is played.
    modifiers = [modifier for obj in objects for modifier in obj.modifiers]
    starts = [m.point_cache.frame_start for m in modifiers if m.type in ("CLOTH", "SOFT_BODY")]
    starts += [scene.frame_start for m in modifiers if m.type == "NODES"]
    ahead = min(starts, default=None)
    for moment in moments.tolist():
        if ahead is not None:
            for frame in range(ahead, moment):
                scene.frame_set(frame)
            ahead = moment + 1
        scene.frame_set(moment)
        graph = bpy.context.evaluated_depsgraph_get()
        parts = [mesh_arrays(obj, graph) for obj in objects]
        parts = [part for part in parts if len(part["loop_total"])]
        if not parts:
            raise Refused(f"no visible mesh in it at frame {moment}")
        joined = join(parts)
        poses.append(joined.pop("vertices"))
        if first is None:
            first = joined
        same = len(poses[-1]) == len(poses[0]) and all(
            np.array_equal(joined[key], first[key]) for key in ("loop_total", "loop_vertices")
        )
        if not same:
            raise Refused(f"frame {moment} has another topology than frame {moments[0]}")
    pictures = {f"picture_{n}": pixels for n, pixels in enumerate(PICTURES.values())}
    return {"poses": np.stack(poses) * scene.unit_settings.scale_length, **first, **pictures}


def mesh_arrays(obj: bpy.types.Object, graph: bpy.types.Depsgraph) -> dict[str, np.ndarray]:
    """Read one object as it is evaluated now."""
    evaluated = obj.evaluated_get(graph)
    mesh = evaluated.to_mesh()
    vertices = read(mesh.vertices, "co", np.float32, 3).astype(np.float64)
    matrix = np.array(evaluated.matrix_world)
    world = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    loop_total = read(mesh.polygons, "loop_total", np.int32, 1)
    slots = read(mesh.polygons, "material_index", np.int32, 1)
    uv = np.full((len(mesh.loops), 2), np.nan, np.float32)
    if mesh.uv_layers.active:
        uv = read(mesh.uv_layers.active.uv, "vector", np.float32, 2)
    colors = np.full((len(loop_total), 3), 0.2140, np.float32)  # mid-grey on a display
    picture = np.full(len(loop_total), -1, np.int32)
    used = [slot.material for slot in evaluated.material_slots]
    for index, material in enumerate(used):
        has_material = slots == index
        if material is not None and has_material.any():
            colors[has_material], picture[has_material] = look(material)
    painted = mesh.color_attributes.active_color
    if painted is not None and not any(used):
        values = read(painted.data, "color", np.float32, 4)[:, :3]
        if painted.domain == "POINT":
            values = values[read(mesh.loops, "vertex_index", np.int32, 1)]
        starts = np.cumsum(loop_total) - loop_total
        colors = np.add.reduceat(values, starts, axis=0) / loop_total[:, None] if len(loop_total) else colors
    result = {
        "vertices": world[:, [0, 2, 1]] * [1, 1, -1],
        "loop_total": loop_total,
        "loop_vertices": read(mesh.loops, "vertex_index", np.int32, 1),
        "linear_colors": colors,
        "corner_uv": uv,
        "picture_of": picture,
    }
    evaluated.to_mesh_clear()
    return result


def read(items: object, name: str, kind: type, width: int) -> np.ndarray:
    values = np.empty(len(items) * width, kind)
    items.foreach_get(name, values)
    return values if width == 1 else values.reshape(-1, width)


PICTURES: dict[str, np.ndarray] = {}
"""Image name -> uint8 [H, W, 3], row 0 at the top."""


def look(material: bpy.types.Material) -> tuple[tuple[float, ...], int]:
    """Find a material's base colour, scene-linear, and the number of its picture (-1: none)."""
    for node in material.node_tree.nodes if material.node_tree else ():
        source = node.inputs.get("Base Color") or node.inputs.get("Color")
        if node.type not in ("BSDF_PRINCIPLED", "BSDF_DIFFUSE", "EMISSION") or source is None:
            continue
        linked = source.links[0].from_node if source.is_linked else None
        if linked is not None and linked.type == "TEX_IMAGE" and linked.image is not None:
            return tuple(material.diffuse_color[:3]), picture_number(linked.image)
        if not source.is_linked:
            return tuple(source.default_value[:3]), -1
    return tuple(material.diffuse_color[:3]), -1


def picture_number(image: bpy.types.Image) -> int:
    if image.name not in PICTURES:
        width, height = image.size
        if not width or not height:
            return -1
        pixels = np.empty(width * height * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
        pixels = pixels.reshape(height, width, image.channels)[::-1]
        pixels = pixels[..., :3] if image.channels >= 3 else np.repeat(pixels[..., :1], 3, axis=-1)
        PICTURES[image.name] = np.rint(np.clip(pixels, 0, 1) * 255).astype(np.uint8)
    return list(PICTURES).index(image.name)


def join(parts: list[dict]) -> dict[str, np.ndarray]:
    """Join all objects into one mesh."""
    starts = np.cumsum([0] + [len(part["vertices"]) for part in parts])
    joined = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    loops = [part["loop_vertices"] + start for part, start in zip(parts, starts, strict=False)]
    return joined | {"loop_vertices": np.concatenate(loops)}


if __name__ == "__main__":
    try:
        code = main()
    except Exception:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # Blender as a package may wait for ever at a regular exit
