"""The textured body as GLB and as OBJ with MTL: one material, one picture, the same look in Blender."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path

import numpy as np

from cloak_core.output.baking import Texture
from cloak_core.scene.exchange import Bodies
from cloak_core.scene.polygons import polygon_loops


def write_glb(path: Path, bodies: Bodies, texture: Texture, pose: int = 0) -> None:
    """Binary glTF with the picture inside; vertices are split where texture coordinates are."""
    uv = texture.uv.reshape(-1, 2)
    rows = np.concatenate([bodies.triangles.reshape(-1, 1).astype(np.float64), uv], axis=1)
    unique, index = np.unique(rows, axis=0, return_inverse=True)
    arrays = [
        bodies.vertices[pose][unique[:, 0].astype(np.int64)].astype("<f4"),
        (unique[:, 1:] * [1, -1] + [0, 1]).astype("<f4"),  # glTF counts v downwards
        index.reshape(-1).astype("<u4"),
    ]
    chunks = [array.tobytes() for array in arrays] + [png(texture.image)]
    views, at = [], 0
    for chunk in chunks:
        views.append({"buffer": 0, "byteOffset": at, "byteLength": len(chunk)})
        at += -(-len(chunk) // 4) * 4
    binary = b"".join(chunk + b"\0" * (-len(chunk) % 4) for chunk in chunks)
    kinds = (("VEC3", 5126), ("VEC2", 5126), ("SCALAR", 5125))
    accessors = [
        {"bufferView": i, "componentType": component, "count": len(array), "type": kind}
        for i, (array, (kind, component)) in enumerate(zip(arrays, kinds, strict=True))
    ]
    accessors[0] |= {"min": arrays[0].min(axis=0).tolist(), "max": arrays[0].max(axis=0).tolist()}
    document = {
        "asset": {"version": "2.0", "generator": "cloak"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": bodies.names[pose]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [
            {
                "name": "cloak",
                "pbrMetallicRoughness": {
                    "baseColorTexture": {"index": 0},
                    "metallicFactor": 0.0,
                    "roughnessFactor": 0.8,
                },
            }
        ],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071}],
        "images": [{"bufferView": 3, "mimeType": "image/png"}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body)


def png(image: np.ndarray) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG")
    return file.getvalue()


def write_obj(path: Path, bodies: Bodies, texture: Texture, picture: str, pose: int = 0) -> None:
    """OBJ with its polygons in their order, and an MTL beside it that names `picture`, a file in the same folder."""
    loop_total, loop, face = polygon_loops(bodies)
    unique, index = np.unique(texture.uv.reshape(-1, 2), axis=0, return_inverse=True)
    # A corner is named by its polygon and vertex; every triangle of the polygon says the same of it, chart by chart.
    base = bodies.vertex_count
    key = (bodies.triangle_face.astype(np.int64)[:, None] * base + bodies.triangles).reshape(-1)
    known, first = np.unique(key, return_index=True)
    wanted = np.repeat(face, loop_total) * base + loop
    corner_uv = index.reshape(-1)[first[np.searchsorted(known, wanted)]]
    lines = [f"mtllib {path.stem}.mtl", f"o {bodies.names[pose].replace(' ', '_')}"]
    lines += [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in bodies.vertices[pose].tolist()]
    lines += [f"vt {u:.8g} {v:.8g}" for u, v in unique.tolist()]
    lines.append("usemtl cloak")
    words = np.char.add(np.char.add((loop + 1).astype(str), "/"), (corner_uv + 1).astype(str)).tolist()
    at = 0
    for count in loop_total.tolist():
        lines.append("f " + " ".join(words[at : at + count]))
        at += count
    path.write_text("\n".join(lines) + "\n")
    material = f"newmtl cloak\nKd 1 1 1\nKs 0 0 0\nNs 10\nd 1\nillum 1\nmap_Kd {picture}\n"
    path.with_suffix(".mtl").write_text(material)
