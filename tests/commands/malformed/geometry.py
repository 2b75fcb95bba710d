"""Face lists, scenes and meshes."""

import json
import pickle
import struct
from collections.abc import Iterator

import numpy as np

from tests.commands.malformed.making import (
    GIB,
    TRAIN,
    Case,
    Evil,
    archive,
    array,
    bomb,
    glb,
    gltf,
    npy_header,
    put,
    saved,
    scene_arrays,
)


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
        "text": saved(["a"]),
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
    none = saved(np.zeros((0, 3), np.int32))
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
        "flat vertices": scene_arrays(vertices=np.zeros((4, 3), np.float32)),
        "no pose": scene_arrays(vertices=np.zeros((0, 4, 3), np.float32)),
        "colours of other faces": scene_arrays(face_colors=np.zeros((1, 9, 3), np.float32)),
        "a face id of two thousand million": scene_arrays(triangle_face=np.array([0, 1, 2, 2**31 - 1])),
        "loops without totals": scene_arrays(loop_vertices=np.arange(3)),
        "loops that do not add up": scene_arrays(loop_vertices=np.arange(3), loop_total=np.array([2**31 - 1, 3])),
        "a region of numbers": scene_arrays(region_x=np.arange(4)),
        "2^40 poses of nothing": archive(
            {"vertices.npy": array("(1099511627776, 0, 3)", "<f4"), "triangles.npy": none}
        ),
        "two million poses": scene_arrays(vertices=np.zeros((1 << 21, 1, 3), np.float32), triangles=[[0, 0, 0]]),
        "a bomb of just under 1 GiB": bomb(GIB - (1 << 24)),
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
        "a vertex index of 20 digits": "v 0 0 0\nf 1 10000000000000000000 1\n",
        "a vertex index of 5,000 digits": "v 0 0 0\nf 1 " + "1" * 5000 + " 1\n",
        "a vertex index of 10^18": "v 0 0 0\nf 1 1000000000000000000 1\n",
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
    many = gltf()
    many["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}}] * 200_000}]
    unfolding = gltf(count=99_999)
    del unfolding["accessors"][0]["bufferView"]
    unfolding["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}}] * 10_000}]
    documents = {
        "200,000 primitives": many,
        "a thousand million vertices from nothing": unfolding,
        "an integer of 5,000 digits": gltf(count=int("1" * 4000)),
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
