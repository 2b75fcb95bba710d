"""The textured body as GLB and as OBJ with MTL: one material, one picture, the same look in Blender."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image

from cloak_core.exchange.bodies import Bodies
from cloak_core.files.writing import write_bytes, write_text
from cloak_core.output.baking import Texture
from cloak_core.scene.meshes.polygons import per_corner, polygon_loops


def write_glb(path: Path, bodies: Bodies, texture: Texture) -> None:
    """Write binary glTF of the first pose with the picture inside; vertices split where texture coordinates do."""
    import trimesh

    rows = np.concatenate([bodies.triangles.reshape(-1, 1).astype(np.float64), texture.uv.reshape(-1, 2)], axis=1)
    unique, index = np.unique(rows, axis=0, return_inverse=True)
    material = trimesh.visual.material.PBRMaterial(
        name="cloak",
        baseColorTexture=Image.fromarray(texture.image),
        metallicFactor=0.0,
        roughnessFactor=0.8,
    )
    mesh = trimesh.Trimesh(
        bodies.vertices[0][unique[:, 0].astype(np.int64)],
        index.reshape(-1, 3),
        visual=trimesh.visual.TextureVisuals(unique[:, 1:], material),
        process=False,
    )
    write_bytes(path, mesh.export(file_type="glb"))


def png(image: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG")
    return file.getvalue()


def write_obj(path: Path, bodies: Bodies, texture: Texture, picture: str) -> None:
    """Write OBJ of the first pose with its polygons in their order, and an MTL beside it.

    The MTL names `picture`, a file in the same folder.
    """
    loop_total, loop, _ = polygon_loops(bodies)
    unique, index = np.unique(texture.uv.reshape(-1, 2), axis=0, return_inverse=True)
    corner_uv = per_corner(bodies, index.reshape(-1, 3))
    lines = [f"mtllib {path.stem}.mtl", f"o {bodies.names[0].replace(' ', '_')}"]
    lines += [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in bodies.vertices[0].tolist()]
    lines += [f"vt {u:.8g} {v:.8g}" for u, v in unique.tolist()]
    lines.append("usemtl cloak")
    words = np.char.add(np.char.add((loop + 1).astype(str), "/"), (corner_uv + 1).astype(str)).tolist()
    at = 0
    for count in loop_total.tolist():
        lines.append("f " + " ".join(words[at : at + count]))
        at += count
    write_text(path, "\n".join(lines) + "\n")
    material = f"newmtl cloak\nKd 1 1 1\nKs 0 0 0\nNs 10\nd 1\nillum 1\nmap_Kd {picture}\n"
    write_text(path.with_suffix(".mtl"), material)
