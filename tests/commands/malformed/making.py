"""What malformed files are made with, and the sound folder that each case starts from."""

import io
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

GIB = 1 << 30
DETECTOR = "darknet:net.cfg:net.weights"
TRAIN = f"train --scene scene --logo logo.npy --detector {DETECTOR} --backgrounds photos --out new --steps 1 --batch 1 "
TRAIN += "--size 32 --translation 2 --samples 1 --angles 0 --threads 1 "
RESUME = TRAIN.replace("--out new", "--out run") + "--resume"
CHECK = f"detectors check {DETECTOR} --image"


@dataclass(frozen=True)
class Case:
    """`make` writes into the working folder, a copy of the sound one; `line` then reads it."""

    name: str
    make: Callable[[Path], None]
    line: str
    may_pass: bool = False
    """Damage that may leave the file readable, or that Cloak recovers from."""


class Evil:
    """Unpickling it leaves a mark."""

    def __reduce__(self) -> tuple:
        return os.mkdir, ("executed",)


def put(name: str, data: bytes | str) -> Callable[[Path], None]:
    """Write a file."""
    return lambda folder: (folder / name).write_bytes(data.encode() if isinstance(data, str) else data) and None


def npy_header(text: str, rest: bytes = b"") -> bytes:
    """A .npy file with any header."""
    header = text.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + rest


def array(shape: str, descr: str = "<i8", rest: bytes = bytes(64)) -> bytes:
    return npy_header(f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}", rest)


def saved(values: object, **options: object) -> bytes:
    file = io.BytesIO()
    np.save(file, np.array(values, **options), allow_pickle=True)
    return file.getvalue()


def archive(members: dict[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as zipped:
        for name, data in members.items():
            zipped.writestr(name, data)
    return file.getvalue()


def scene_arrays(**changes: object) -> bytes:
    arrays = {
        "vertices": np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]], np.float32),
        "triangles": np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32),
    }
    file = io.BytesIO()
    np.savez(file, **{k: v for k, v in (arrays | changes).items() if v is not None})
    return file.getvalue()


def bomb(size: int, declared: int | None = None) -> bytes:
    """A .npz of a few megabytes whose one array unpacks to `size` zeros; its header may declare another size."""
    chunk = 1 << 24
    head = array(f"({size // 4},)", "<f4", b"")
    head += bytes(128 - len(head) % 128)
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    first = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(bytes(chunk)) + packer.flush(zlib.Z_FULL_FLUSH)
    data = first + block * (size // chunk) + packer.flush()
    name = b"vertices.npy"
    sizes = (0, len(data), size if declared is None else declared)
    local = struct.pack("<4s5H3I2H", b"PK\x03\x04", 20, 0, 8, 0, 33, *sizes, len(name), 0) + name + data
    entry = struct.pack("<4s6H3I5H2I", b"PK\x01\x02", 20, 20, 0, 8, 0, 33, *sizes, len(name), 0, 0, 0, 0, 0, 0) + name
    end = struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, 1, 1, len(entry), len(local), 0)
    return local + entry + end


def png_of(width: int, height: int, mode: int = 0, rows: int = 4) -> bytes:
    """A grey PNG with a transparent colour that declares any size, with a few rows of data."""
    chunk = lambda kind, data: (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data) & 0xFFFFFFFF)
    )
    row = bytes(1 + min(width, 1 << 20))
    parts = [
        chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, mode, 0, 0, 0)),
        chunk(b"tRNS", b"\0\0"),
        chunk(b"IDAT", zlib.compress(row * rows)),
        chunk(b"IEND", b""),
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def glb(document: dict | bytes, binary: bytes = b"") -> bytes:
    text = document if isinstance(document, bytes) else json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def gltf(**accessor: object) -> dict:
    """A triangle in glTF, one of whose accessors is changed."""
    view = {"buffer": 0, "byteOffset": 0, "byteLength": 36}
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64," + "A" * 48}],
        "bufferViews": [view],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"} | accessor],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }


def cfg(**changes: object) -> str:
    net = {"width": 32, "height": 32, "channels": 3}
    layer = {"filters": 30, "size": 1, "stride": 1, "activation": "linear"}
    net |= {k: v for k, v in changes.items() if k in net}
    layer |= {k: v for k, v in changes.items() if k not in net}
    lines = ["[net]", *(f"{k}={v}" for k, v in net.items()), "", "[convolutional]"]
    lines += [f"{k}={v}" for k, v in layer.items()]
    return "\n".join([*lines, "", "[region]", "anchors=1,1, 2,2, 3,3, 4,4, 5,5", "classes=1", "coords=4", "num=5", ""])


WEIGHTS = np.array([0, 2, 0, 0, 0], np.int32).tobytes() + np.zeros(120, np.float32).tobytes()


def sound(folder: Path) -> None:
    """Everything the cases start from: a scene, a logo, a one-layer detector, photographs and a finished run."""
    from cloak_core import cli
    from cloak_core.exchange.face_lists import write_face_list
    from cloak_core.exchange.scenes import read_scene, write_scene

    (folder / "whole.npz").write_bytes(scene_arrays())
    bodies = read_scene(folder / "whole.npz")
    write_scene(folder / "scene", bodies)
    write_face_list(folder / "logo.npy", np.array([3]), bodies.topology)
    (folder / "net.cfg").write_text(cfg())
    (folder / "net.names").write_text("person\n")
    (folder / "net.weights").write_bytes(WEIGHTS)
    (folder / "photos").mkdir()
    Image.new("RGB", (40, 40), "green").save(folder / "photos" / "0.png")
    Image.new("RGB", (40, 40), "green").save(folder / "photo.png")
    (folder / "triangle.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    (folder / "triangle.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    (folder / "triangle.gltf").write_text(json.dumps(gltf()))
    (folder / "settings.toml").write_text("lr = 0.1\n")
    (folder / "grid.toml").write_text("[base]\nscene = 'scene'\nlogo = 'logo.npy'\nsteps = 1\n[grid]\nlr = [0.1]\n")
    (folder / "palette.txt").write_text("0 0 0\n1 1 1\n")
    before = Path.cwd()
    os.chdir(folder)
    try:
        cli.main(TRAIN.replace("--out new", "--out run").replace("--steps 1", "--steps 2").split())
    except SystemExit as end:
        assert not end.code
    finally:
        os.chdir(before)
