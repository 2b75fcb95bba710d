"""Files that strangers might send, each with the command line that reads it. Made by hand, and by seeded damage."""

import io
import json
import os
import pickle
import random
import shutil
import struct
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterator
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
    from cloak_core.scene.exchange import read_scene, write_face_list, write_scene

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


# --- by hand ---------------------------------------------------------------------------------------------------------


def face_lists() -> Iterator[Case]:
    bad = {
        "empty file": b"",
        "pickled object": saved([Evil()], dtype=object),
        "bare pickle": pickle.dumps(Evil()),
        "a huge shape": array("(1000000000000,)"),
        "a shape that overflows": array("(4294967296, 4294967296, 4294967296)"),
        "a negative shape": array("(-5,)"),
        "a shape of no numbers": array("('a',)"),
        "an unknown dtype": array("(1,)", "<q9"),
        "an object dtype": array("(1,)", "|O"),
        "code in the header": npy_header("__import__('os').mkdir('executed')"),
        "a deep header": npy_header("(" * 60000),
        "a header without keys": npy_header("{}"),
        "a long header": b"\x93NUMPY\x02\x00" + struct.pack("<I", 0xFFFFFFF0),
        "version 9": b"\x93NUMPY\x09\x00" + bytes(80),
        "truncated": array("(50,)", rest=bytes(30)),
        "duplicates": saved([1, 1]),
        "negative": saved([-1]),
        "floats": saved([0.5]),
        "text": saved(["a"]),
        "no faces": saved([], dtype=np.int64),
        "two rows": saved([[1, 2], [2, 3]]),
        "beyond the mesh": saved([99]),
        "beyond any mesh": saved([2**40]),
        "beyond int64": saved([2**63], dtype=np.uint64),
        "records": saved([(1, 2)], dtype=[("a", "i4"), ("b", "i4")]),
        "a zip": scene_arrays(),
    }
    for name, data in bad.items():
        yield Case(f"face list: {name}", put("bad.npy", data), TRAIN.replace("logo.npy", "bad.npy"))
    sidecars = {
        "another topology": '{"format": "cloak face list", "version": 1, "topology": "00"}',
        "another version": '{"format": "cloak face list", "version": 99}',
        "a foreign record": '{"format": "x"}',
        "a list": "[]",
        "deep": "[" * 200000,
        "not JSON": "{",
        "not text": b"\xff\xfe",
        "a strange index": '{"format": "cloak face list", "version": 1, "index_of": ["x"]}',
    }
    for name, data in sidecars.items():
        yield Case(f"face list's sidecar: {name}", put("logo.json", data), TRAIN)


def scenes() -> Iterator[Case]:
    nan = np.full((1, 4, 3), np.nan, np.float32)
    bad = {
        "empty": b"",
        "pickle": pickle.dumps(Evil()),
        "no arrays": archive({}),
        "a pickled array": archive({"vertices.npy": saved([Evil()], dtype=object)}),
        "a zip bomb": bomb(6 * GIB // 2),
        "a zip bomb that declares little": bomb(6 * GIB // 2, declared=1000),
        "a huge array": archive({"vertices.npy": array("(1000000000000,)", "<f4")}),
        "no triangles": scene_arrays(triangles=None),
        "triangles of text": scene_arrays(triangles=np.array([["a", "b", "c"]])),
        "triangles beyond": scene_arrays(triangles=np.array([[0, 1, 9]])),
        "negative triangles": scene_arrays(triangles=np.array([[0, 1, -1]])),
        "vertices that are no numbers": scene_arrays(vertices=nan),
        "flat vertices": scene_arrays(vertices=np.zeros((4, 3), np.float32)),
        "no pose": scene_arrays(vertices=np.zeros((0, 4, 3), np.float32)),
        "colours out of range": scene_arrays(face_colors=np.full((1, 4, 3), 7, np.float32)),
        "colours of other faces": scene_arrays(face_colors=np.zeros((1, 9, 3), np.float32)),
        "a face id of two thousand million": scene_arrays(triangle_face=np.array([0, 1, 2, 2**31 - 1])),
        "loops without totals": scene_arrays(loop_vertices=np.arange(3)),
        "loops that do not add up": scene_arrays(loop_vertices=np.arange(3), loop_total=np.array([2**31 - 1, 3])),
        "names of nobody": scene_arrays(names=np.array(["a", "b"])),
        "coordinates of nothing": scene_arrays(uv=np.zeros((4, 2), np.float32)),
        "a region of numbers": scene_arrays(region_x=np.arange(4)),
    }
    for name, data in bad.items():
        yield Case(f"scene: {name}", put("bad.npz", data), "scene info bad.npz")
    dots = archive({"../../outside.npy": saved([1]), "vertices.npy": saved([1])})
    yield Case("scene: a member called ../../outside.npy", put("bad.npz", dots), "scene info bad.npz")
    records = {
        "no record": "",
        "deep": '{"a":' * 100000,
        "another topology": '{"format": "cloak scene", "version": 1, "topology": "00"}',
        "a version of text": '{"format": "cloak scene", "version": "1"}',
    }
    for name, data in records.items():
        yield Case(f"scene.json: {name}", put("scene/scene.json", data), "scene info scene")


def meshes() -> Iterator[Case]:
    objects = {
        "nothing": "",
        "a pickle": pickle.dumps(Evil()).decode("latin1"),
        "faces of no vertices": "f 1 2 3\n",
        "a vertex index of 10^18": "v 0 0 0\nf 1 1000000000000000000 1\n",
        "a negative index beyond": "v 0 0 0\nf -9 -9 -9\n",
        "vertices of text": "v a b c\nf 1 1 1\n",
        "an endless number": "v " + "9" * 100000 + " 0 0\nf 1 1 1\n",
        "a material library outside": "mtllib ../../../../etc/passwd\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    }
    for name, data in objects.items():
        may = "library" in name
        yield Case(f"OBJ: {name}", put("bad.obj", data), "scene import bad.obj --out new", may)
    head = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    faces = "element face {}\nproperty list uchar int vertex_indices\nend_header\n"
    polygons = {
        "10^12 vertices": head.format("ascii", 10**12) + faces.format(1) + "0 0 0\n",
        "10^12 binary vertices": head.format("binary_little_endian", 10**12) + faces.format(1) + "0",
        "10^12 binary faces": head.format("binary_little_endian", 1) + faces.format(10**12) + "\0" * 12,
        "a negative count": head.format("ascii", -4) + faces.format(1),
        "an unknown format": head.format("gzip", 1) + faces.format(1),
        "no end of the header": head.format("ascii", 1),
        "an unknown type": "ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n0\n",
        "nothing": "ply\n",
    }
    for name, data in polygons.items():
        yield Case(f"PLY: {name}", put("bad.ply", data), "scene import bad.ply --out new")
    outside = gltf()
    outside["buffers"][0]["uri"] = "../../../../etc/passwd"
    loop = gltf()
    loop["nodes"] = [{"mesh": 0, "children": [0]}]
    buffers = gltf()
    buffers["buffers"][0]["byteLength"] = 10**13
    documents = {
        "10^12 vertices": gltf(count=10**12),
        "a negative count": gltf(count=-3),
        "an unknown component": gltf(componentType=9),
        "a view of nothing": gltf(bufferView=7),
        "an offset beyond": gltf(byteOffset=10**10),
        "a sparse accessor of 10^9": gltf(sparse={"count": 10**9, "indices": {"bufferView": 0}, "values": {}}),
        "a buffer outside": outside,
        "a node that holds itself": loop,
        "a buffer of 10^13 bytes": buffers,
        "nothing": {},
        "meshes that are a number": {"asset": {"version": "2.0"}, "meshes": 3},
    }
    for name, data in documents.items():
        may = name in ("a node that holds itself", "a buffer of 10^13 bytes")
        yield Case(f"glTF: {name}", put("bad.gltf", json.dumps(data)), "scene import bad.gltf --out new", may)
        yield Case(f"GLB: {name}", put("bad.glb", glb(data)), "scene import bad.glb --out new", may)
    yield Case("GLB: deep", put("bad.glb", glb(b"[" * 100000)), "scene import bad.glb --out new")
    yield Case("GLB: a chunk beyond", put("bad.glb", glb({})[:12] + b"\xff\xff\xff\x7fJSON"),
               "scene import bad.glb --out new")  # fmt: skip
    smpl = "scene import-smpl bad.pkl --out new"
    yield Case("SMPL: a pickle that runs code", put("bad.pkl", pickle.dumps(Evil())), smpl)
    yield Case("SMPL: a pickle of nothing", put("bad.pkl", pickle.dumps({})), smpl)
    yield Case("SMPL: a pickle that repeats itself", put("bad.pkl", b"]" + b"2a" * 50 + b"."), smpl)


def detectors() -> Iterator[Case]:
    texts = {
        "nothing": "",
        "a picture": png_of(8, 8),
        "a width of 10^9": cfg(width=10**9),
        "a negative width": cfg(width=-32),
        "a width of text": cfg(width="x"),
        "10^7 filters": cfg(filters=10**7),
        "no filters": cfg(filters=0),
        "a kernel of 99999": cfg(size=99999),
        "a stride of zero": cfg(stride=0),
        "groups that do not divide": cfg(groups=7),
        "an unknown activation": cfg(activation="exec"),
        "a hundred layers of 9000 filters": cfg().replace(
            "[region]", "[convolutional]\nfilters=9000\nsize=3\nstride=1\nactivation=linear\n" * 100 + "[region]"
        ),
        "a route to nowhere": cfg().replace("[region]", "[route]\nlayers=-40\n[region]"),
        "a route to itself": cfg().replace("[region]", "[route]\nlayers=1\n[region]"),
        "a shortcut to nowhere": cfg().replace("[region]", "[shortcut]\nfrom=-40\n[region]"),
        "upsampling by 10^6": cfg().replace("[region]", "[upsample]\nstride=1000000\n[region]"),
        "anchors that are no numbers": cfg().replace("1,1,", "nan,x,"),
        "10^9 anchors": cfg().replace("num=5", "num=1000000000"),
        "10^9 classes": cfg().replace("classes=1", "classes=1000000000"),
        "no end": cfg().replace("[region]", ""),
        "an unknown section": cfg().replace("[region]", "[exec]"),
        "keys without values": "[net]\nwidth\n",
        "a million lines": "[net]\n" + "\n" * 1_100_000,
    }
    for name, data in texts.items():
        yield Case(f"cfg: {name}", put("net.cfg", data), CHECK + " photo.png")
    weights = {
        "nothing": b"",
        "a header alone": WEIGHTS[:20],
        "half of it": WEIGHTS[:300],
        "a byte more": WEIGHTS + b"0",
        "twice": WEIGHTS + WEIGHTS[20:],
        "a pickle": pickle.dumps(Evil()),
        "not numbers": WEIGHTS[:20] + b"\xff" * 480,
        "infinite": WEIGHTS[:20] + np.full(120, np.inf, np.float32).tobytes(),
    }
    for name, data in weights.items():
        yield Case(f"weights: {name}", put("net.weights", data), CHECK + " photo.png")
    for spec in ("darknet:net.cfg", "darknet::", "darknet:scene:photos", "nonsense:x", "onnx:photo.png", "onnx:scene"):
        yield Case(f"detector {spec}", put("x", ""), f"detectors check {spec} --image photo.png")
    torch_file = "torchvision:ssdlite320_mobilenet_v3_large:evil.pth"
    evil = {"pickle": pickle.dumps(Evil()), "zip": archive({"archive/data.pkl": pickle.dumps(Evil()),
            "archive/version": b"3"}), "nothing": b""}  # fmt: skip
    for name, data in evil.items():
        yield Case(f"checkpoint of torchvision: {name}", put("evil.pth", data),
                   f"detectors check {torch_file} --image photo.png")  # fmt: skip


def pictures() -> Iterator[Case]:
    bad = {
        "nothing": b"",
        "text": b"not a picture",
        "a pickle": pickle.dumps(Evil()),
        "60000 x 60000": png_of(60000, 60000),
        "2^31 x 2^31": png_of(2**31 - 1, 2**31 - 1),
        "13000 x 13000, transparent": png_of(13000, 13000, rows=13000),
        "truncated": png_of(64, 64)[:60],
        "an SVG that asks for a file": b"<svg><image href='file:///etc/passwd'/></svg>",
        "PostScript": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n(x) run\n",
        "a zip": archive({"a": b"b"}),
    }
    for name, data in bad.items():
        # A large picture is no bad one: it may be read, within the memory there is.
        may = "transparent" in name
        yield Case(f"photograph: {name}", put("bad.png", data), CHECK + " bad.png", may)
        yield Case(f"background: {name}", put("photos/0.png", data), TRAIN, may)
        stamp = "logo project --scene sample:train[0:1] --mask bad.png --out x.npy"
        yield Case(f"stamp: {name}", put("bad.png", data), stamp, may)


def settings() -> Iterator[Case]:
    bad = {
        "nothing known": "colour = 1\n",
        "not TOML": "lr = = 1\n",
        "not text": b"\xff\xfe\x00",
        "deep": "lr = " + "[" * 50000,
        "a table": "[lr]\nx = 1\n",
        "a date": "lr = 2020-01-01\n",
        "not a number": "lr = nan\n",
        "infinite": "lr = inf\n",
        "a huge number": "batch = 99999999999999999999999999\n",
        "a preset that is a list": "preset = ['best']\n",
        "a preset that is a number": "preset = 1\n",
        "an inverted range": "distance = '3:1'\n",
        "no angles": "angles = ''\n",
        "10^9 angles": "angles = '0:360:0.0000001'\n",
        "a size of 10^9": "size = 1000000000\n",
        "both lengths": "steps = 1\nepochs = 1\n",
        "a truth": "batch = true\n",
        "a device of dots": "device = '../../x'\n",
        "a palette of dots": "palette = '../../../../etc/passwd'\n",
        "large": "# " + "x" * (2 << 20) + "\n",
    }
    line = TRAIN.replace(" --steps 1", "") + "--config bad.toml"
    for name, data in bad.items():
        yield Case(f"settings: {name}", put("bad.toml", data), line)
    grids = {
        "nothing": "",
        "a pickle": pickle.dumps(Evil()),
        "deep": "[grid]\nlr = " + "[" * 50000,
        "10^10 runs": "[base]\nscene='a'\nlogo='b'\n[grid]\n"
        + "".join(f"{k} = {[*range(1, 100)]}\n" for k in ("seed", "batch", "lr", "steps", "size")),
        "lists within lists": "[base]\nscene='a'\nlogo='b'\n[grid]\nlr = [[1]]\n",
        "a scene outside": "[base]\nscene='../../..'\nlogo='b'\n[grid]\nlr = [1]\n",
    }
    for name, data in grids.items():
        yield Case(f"grid: {name}", put("bad.toml", data), "sweep bad.toml --out new")
    palettes = {"nothing": "", "words": "red\n", "not numbers": "nan nan nan\n", "a pickle": pickle.dumps(Evil())}
    for name, data in palettes.items():
        yield Case(f"palette: {name}", put("bad.txt", data), TRAIN + "--palette bad.txt --nps-weight 1")


def latest(folder: Path) -> Path:
    return max((folder / "run" / "checkpoint").iterdir())


def in_checkpoint(name: str, data: bytes) -> Callable[[Path], None]:
    return lambda folder: (latest(folder) / name).write_bytes(data) and None


def signed(data: bytes) -> Callable[[Path], None]:
    """State with a record that vouches for it."""

    def make(folder: Path) -> None:
        import hashlib

        record = json.loads((latest(folder) / "state.json").read_text())
        record["sha256"] = hashlib.sha256(data).hexdigest()
        (latest(folder) / "state.json").write_text(json.dumps(record))
        (latest(folder) / "state.safetensors").write_bytes(data)

    return make


def tensors(header: dict | bytes, rest: bytes = b"") -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + rest


def runs() -> Iterator[Case]:
    resume = RESUME.replace("--steps 1", "--steps 2")
    huge = {"parameter": {"dtype": "F32", "shape": [10**6, 10**6], "data_offsets": [0, 4 * 10**12]}}
    states = {
        "nothing": b"",
        "a pickle": pickle.dumps(Evil()),
        "a header of 2^60 bytes": struct.pack("<Q", 1 << 60) + b"{}",
        "a tensor of 4 TB": tensors(huge, bytes(100)),
        "a deep header": tensors(b"[" * 50000),
        "another run's": tensors({"parameter": {"dtype": "F32", "shape": [1], "data_offsets": [0, 4]}}, bytes(4)),
        "twisted offsets": tensors({"parameter": {"dtype": "F32", "shape": [3], "data_offsets": [8, 4]}}, bytes(12)),
        "no parameter": tensors({}),
    }  # fmt: skip
    for name, data in states.items():
        yield Case(f"checkpoint: {name}", in_checkpoint("state.safetensors", data), resume, True)
        yield Case(f"checkpoint with a fitting record: {name}", signed(data), resume, True)
    records = {"nothing": b"", "deep": b"[" * 100000, "a pickle": pickle.dumps(Evil()), "a number": b"1",
               "a step of text": b'{"format": "cloak checkpoint", "version": 1, "step": "2", "time": 1}',
               "a huge step": b'{"format": "cloak checkpoint", "version": 1, "step": 1e400, "time": 1}'}  # fmt: skip
    for name, data in records.items():
        yield Case(f"checkpoint's record: {name}", in_checkpoint("state.json", data), resume, True)
        yield Case(f"config.json: {name}", put("run/config.json", data), resume)
        yield Case(f"config.json in an evaluation: {name}", put("run/config.json", data),
                   "evaluate run --scene scene --backgrounds photos --angles 0", True)  # fmt: skip
    yield Case(
        "config.json: inputs of dots", config(inputs={"scene": "../../../etc", "logo": "x"}), "print run --out new"
    )
    yield Case("config.json: inputs of numbers", config(inputs={"scene": 5}), "print run --out new")
    yield Case("config.json: inputs that are a list", config(inputs=[1]), "print run --out new")
    events = {
        "nothing": b"",
        "a pickle": pickle.dumps(Evil()),
        "a long line": b'{"type": "step", "x": "' + b"x" * (3 << 20),
        "deep": b"[" * 100000 + b"\n",
        "numbers of text": b'{"type": "step", "step": "a", "time": [], "loss": {}}\n',
        "not numbers": b'{"type": "step", "step": 1, "time": NaN, "loss": Infinity}\n',
        "not text": bytes(range(256)) * 10,
    }
    for name, data in events.items():
        yield Case(f"events: {name}", put("run/events.jsonl", data), resume, True)
        yield Case(f"events in a report: {name}", put("run/events.jsonl", data), "report run", True)
    colors = {
        "nothing": b"",
        "a pickle": saved([Evil()], dtype=object),
        "too many": saved(np.zeros((9, 3), np.float32)),
        "out of range": saved(np.full((1, 3), 9, np.float32)),
        "huge": array("(1000000000000, 3)", "<f4"),
    }
    for name, data in colors.items():
        yield Case(
            f"colours: {name}",
            put("run/colors.npy", data),
            "evaluate run --scene scene --backgrounds photos --angles 0",
        )


def config(**changes: object) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        record = json.loads((folder / "run" / "config.json").read_text())
        (folder / "run" / "config.json").write_text(json.dumps(record | changes))

    return make


# --- by seeded damage ------------------------------------------------------------------------------------------------

TARGETS = {
    "logo.npy": TRAIN,
    "logo.json": TRAIN,
    "whole.npz": "scene info whole.npz",
    "scene/scene.json": "scene info scene",
    "triangle.obj": "scene import triangle.obj --out new",
    "triangle.ply": "scene import triangle.ply --out new",
    "triangle.gltf": "scene import triangle.gltf --out new",
    "net.cfg": CHECK + " photo.png",
    "net.weights": CHECK + " photo.png",
    "photo.png": CHECK + " photo.png",
    "settings.toml": TRAIN + "--config settings.toml",
    "palette.txt": TRAIN + "--palette palette.txt",
    "run/config.json": RESUME.replace("--steps 1", "--steps 2"),
    "run/events.jsonl": "report run",
    "run/colors.npy": "print run --out new",
}


def damage(name: str, seed: int) -> Callable[[Path], None]:
    """Bytes flipped, cut, doubled or replaced, as the seed has it."""

    def make(folder: Path) -> None:
        draw = random.Random(f"{name} {seed}")
        data = bytearray((folder / name).read_bytes())
        for _ in range(draw.randint(1, 4)):
            at = draw.randrange(len(data) + 1)
            how = draw.randrange(5)
            if how == 0 and at < len(data):
                data[at] ^= 1 << draw.randrange(8)
            elif how == 1:
                del data[at:]
            elif how == 2:
                data[at:at] = draw.randbytes(draw.randint(1, 20))
            elif how == 3:
                data[at : at + 9] = draw.choice([b"-1", b"99999999999999999999", b"nan", b"\xff" * 9, b"[" * 300, b""])
            else:
                data[at:at] = data[at : at + draw.randint(1, 40)]
        (folder / name).write_bytes(data)

    return make


def cases(damaged: int) -> list[Case]:
    """All by hand, and `damaged` of each target."""
    by_hand = [*face_lists(), *scenes(), *meshes(), *detectors(), *pictures(), *settings(), *runs()]
    seeded = [
        Case(f"{name}, damaged by seed {seed}", damage(name, seed), line, True)
        for name, line in TARGETS.items()
        for seed in range(damaged)
    ]
    return by_hand + seeded


# --- the process that reads them -------------------------------------------------------------------------------------


def read_all(root: Path, chosen: list[Case]) -> list[dict]:
    """Run each case's command in this process; one record each: what went wrong, "" for nothing."""
    import contextlib
    import importlib
    import resource
    import time
    import traceback

    from cloak_core import cli

    # What is mapped before the limit does not count: every library that the commands import.
    for name in ("torchvision", "onnxruntime", "trimesh", "xatlas", "matplotlib.pyplot", "torch._dynamo"):
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    for place in cli.COMMANDS.values():
        importlib.import_module(f"cloak_core.commands.{place.partition(':')[0]}")
    importlib.import_module("cloak_core.attack.sweeps")
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    limit = int(status["VmSize"].split()[0]) * 1024 + 2 * GIB
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    records = []
    for case in chosen:
        here = root / "case"
        shutil.copytree(root / "sound", here)
        case.make(here)
        os.chdir(here)
        before = {str(path.relative_to(root)) for path in root.rglob("*")}
        out, err, wrong, code = io.StringIO(), io.StringIO(), "", 0
        started = time.perf_counter()
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                cli.err.file, cli.out.file = err, out
                cli.main(case.line.split())
        except SystemExit as end:
            code = end.code or 0
        except BaseException:
            wrong = "traceback: " + traceback.format_exc(limit=-3)
        said = err.getvalue()
        made = {str(path.relative_to(root)) for path in root.rglob("*")} - before
        outside = [path for path in made if not path.startswith(("case/new", "case/run", "case/x."))]
        if code not in ((0, 2) if case.may_pass else (2,)) and not wrong:
            wrong = f"exit code {code}: {said}"
        elif code == 2 and (len(said.strip().splitlines()) > 20 or "Traceback" in said):
            wrong = f"not a line: {said[:500]}"
        if any("executed" in path for path in made):
            wrong = "code was executed"
        elif outside:
            wrong = wrong or f"written outside: {outside}"
        print(f"{time.perf_counter() - started:6.1f} s  {case.name}  {wrong[-600:]}", file=sys.stderr, flush=True)
        records.append({"name": case.name, "code": code, "said": said.strip(), "wrong": wrong,
                        "seconds": time.perf_counter() - started})  # fmt: skip
        os.chdir(root)
        shutil.rmtree(here)
    return records


if __name__ == "__main__":
    folder, first, last, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
    print(json.dumps(read_all(folder, cases(count)[first:last])))
