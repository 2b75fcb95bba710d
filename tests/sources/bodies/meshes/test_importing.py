import base64
import json
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.core.geometry import face_centres
from cloak_core.exchange.scenes import write_scene
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.meshes.gltf import read_gltf
from cloak_core.sources.bodies.meshes.importing import import_bodies
from tests.commands.malformed.making import glb, gltf, png_of
from tests.sources.bodies.solids import CUBE, CUBE_FACES, cube, is_closed, sphere

TRIANGLES = cube().triangles


def write_obj(path: Path, vertices: np.ndarray, faces: list, extra: str = "") -> Path:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += ["f " + " ".join(str(v + 1) for v in face) for face in faces]
    path.write_text(extra + "\n".join(lines) + "\n")
    return path


def test_obj_keeps_polygons_and_order_across_materials(tmp_path: Path) -> None:
    """Triangles among quads, materials alternating: the case that general readers reorder."""
    body = sphere(8, 4)
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl half\nKd 0.21404 0.21404 0.21404\n")
    loops = np.split(body.loop_vertices, np.cumsum(body.loop_total)[:-1])
    order = np.random.default_rng(0).permutation(len(loops))
    lines = ["mtllib m.mtl"] + [f"v {x!r} {y!r} {z!r}" for x, y, z in body.vertices[0].tolist()]
    for n, i in enumerate(order):
        lines += [f"usemtl {'red' if n % 2 else 'half'}", "f " + " ".join(str(v + 1) for v in loops[i])]
    (tmp_path / "globe.obj").write_text("\n".join(lines))
    read = import_bodies([tmp_path / "globe.obj"])
    assert np.array_equal(read.loop_total, body.loop_total[order])
    assert np.array_equal(read.loop_vertices, np.concatenate([loops[i] for i in order]))
    assert np.allclose(face_centres(read), face_centres(body)[order], atol=1e-6)
    # Kd is scene-linear, as Blender writes it: 0.214 there is mid-grey on a display.
    assert np.allclose(read.face_colors[0, 1::2], [1, 0, 0])
    assert np.allclose(read.face_colors[0, ::2], 0.5, atol=1e-3)
    assert is_closed(read.triangles)


def test_obj_texture_coordinates_vertex_colours_and_odd_lines(tmp_path: Path) -> None:
    text = (
        "# made by hand\r\no thing\ng part\ns off\nvn 0 0 1\n"
        "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 1 1 0 0 0 1\nv 0 1 0 0 0 1\n"
        "vt 0 0\nvt 1 0 0\nvt 1 1\nvt 0 1\n"
        "f 1/1/1 2/2/1 3/3/1 \\\n4/4/1  # a quad over two lines\n"
    )
    (tmp_path / "a.obj").write_text(text)
    read = import_bodies([tmp_path / "a.obj"])
    assert read.loop_total.tolist() == [4]
    assert np.allclose(read.face_colors, [[[0.5, 0, 0.5]]])
    assert np.allclose(read.uv[read.triangle_uv], read.vertices[0][read.triangles][..., :2])


def test_poses_share_the_first_files_triangles(tmp_path: Path) -> None:
    """Folding a quad moves its shorter diagonal; the triangles stay as in the first pose."""
    folded = CUBE * [1, 1, 1]
    folded[7] += [1.5, 1.5, 0]
    paths = [write_obj(tmp_path / "a.obj", CUBE, CUBE_FACES), write_obj(tmp_path / "b.obj", folded, CUBE_FACES)]
    read = import_bodies(paths, "pair")
    alone = import_bodies(paths[1:])
    assert (read.pose_count, read.name, read.names) == (2, "pair", ("a", "b"))
    assert import_bodies([paths[0], paths[0]]).names == ("a", "a 2")
    assert np.array_equal(read.triangles, import_bodies(paths[:1]).triangles)
    assert not np.array_equal(read.triangles, alone.triangles) and read.topology == alone.topology
    assert np.allclose(read.vertices[1], folded)


def test_a_material_file_outside_the_folder_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "secret.mtl").write_text("newmtl a\nKd 1 0 0\n")
    (tmp_path / "in").mkdir()
    head = f"mtllib ../secret.mtl\nmtllib {tmp_path}/secret.mtl\nmtllib missing.mtl\nusemtl a\n"
    read = import_bodies([write_obj(tmp_path / "in" / "a.obj", CUBE, CUBE_FACES, head)])
    assert (read.face_colors == 0.5).all()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("v 0 0 0\n", "no faces"),
        ("v 0 0\n", "line 1: a vertex has three"),
        ("v 0 0 0\nv 1 0 0\nf 1 2\n", "line 3: a face has three"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n", "line 4: index 0"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n", "line 4: index -4"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "face 0 names vertex 8, beyond 3"),
        ("v 0 0 0\nv 1 0 0\nv 0 inf 0\nf 1 2 3\n", "vertex 2 is not finite"),
        ("v 0 0 0\nv 170 0 0\nv 0 171 0\nf 1 2 3\n", "scale 0.01"),
        ("v 0 0 0\nv 0.01 0 0\nv 0 0.017 0\nf 1 2 3\n", "scale 100"),
    ],
)
def test_bad_obj_files_are_refused_by_name(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "bad.obj").write_text(text)
    with pytest.raises(InputError, match=says) as caught:
        import_bodies([tmp_path / "bad.obj"])
    assert "bad.obj" in str(caught.value) and "\n" not in str(caught.value)


def test_another_topology_is_refused_with_both_hashes(tmp_path: Path) -> None:
    turned = [CUBE_FACES[1], CUBE_FACES[0], *CUBE_FACES[2:]]
    paths = [write_obj(tmp_path / "a.obj", CUBE, CUBE_FACES), write_obj(tmp_path / "b.obj", CUBE, turned)]
    with pytest.raises(InputError) as caught:
        import_bodies(paths)
    hashes = [import_bodies([path]).topology for path in paths]
    assert all(word in str(caught.value) for word in (*hashes, "b.obj", "a.obj"))


def test_files_that_are_no_meshes(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_text("x")
    for path, says in ((tmp_path / "a.stl", "not a mesh"), (tmp_path / "gone.obj", "no such file")):
        with pytest.raises(InputError, match=says):
            import_bodies([path])
    with pytest.raises(InputError, match="no mesh file"):
        import_bodies([])


def test_scene_packages_and_meshes_mix(tmp_path: Path) -> None:
    body = cube(regions={"top": np.arange(6) == 3}, names=("first",))
    scene = write_scene(tmp_path / "scene", body)
    read = import_bodies([scene, write_obj(tmp_path / "b.obj", CUBE + 1, CUBE_FACES)])
    assert read.names == ("first", "b") and read.regions["top"].sum() == 1
    both = import_bodies([scene / "bodies.npz", scene])
    assert both.pose_count == 2 and both.topology == body.topology


def ply(kind: str, faces: list, colors: np.ndarray | None = None) -> bytes:
    """A cube; its faces behind another element that readers have to step over."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[kind]
    head = f"ply\nformat {kind} 1.0\ncomment by hand\nelement vertex 8\n"
    head += "property float x\nproperty double y\nproperty float z\n"
    if colors is not None:
        head += "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    head += "element edge 2\nproperty int vertex1\nproperty list uchar short more\n"
    head += f"element face {len(faces)}\nproperty uchar flag\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [[*xyz, *(colors[i] if colors is not None else [])] for i, xyz in enumerate(CUBE.tolist())]
    edges = [[5, 0], [6, 2, 7, 8]]
    loops = [[1, len(face), *face] for face in faces]
    if not order:
        text = "\n".join(" ".join(f"{value:g}" for value in row) for row in rows + edges + loops)
        return (head + text + "\n").encode()
    shape = order + "fdf" + ("BBB" if colors is not None else "")
    data = b"".join(struct.pack(shape, *row) for row in rows)
    data += b"".join(struct.pack(f"{order}iB{len(row) - 2}h", *row) for row in edges)
    data += b"".join(struct.pack(f"{order}BB{len(row) - 2}i", *row) for row in loops)
    return head.encode() + data


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("mixed", [False, True])
def test_ply_keeps_polygons(tmp_path: Path, kind: str, mixed: bool) -> None:
    faces = CUBE_FACES if not mixed else [*CUBE_FACES[:3], [2, 3, 7], [2, 7, 6], *CUBE_FACES[4:]]
    colors = np.tile([255, 0, 51], (8, 1))
    (tmp_path / "c.ply").write_bytes(ply(kind, faces, colors))
    read = import_bodies([tmp_path / "c.ply"])
    assert read.loop_total.tolist() == [len(face) for face in faces]
    assert read.loop_vertices.tolist() == [v for face in faces for v in face]
    assert np.array_equal(read.vertices[0], CUBE)
    assert np.allclose(read.face_colors, [1, 0, 0.2])


def test_bad_ply_files(tmp_path: Path) -> None:
    whole = ply("binary_little_endian", CUBE_FACES)
    damaged = {
        "cut": whole[:-9],
        "head": b"plx" + whole[3:],
        "none": whole.replace(b"vertex_indices", b"vertex_numbers"),
        "huge": whole.replace(b"element vertex 8", b"element vertex 99999999999"),
        "word": ply("ascii", CUBE_FACES).replace(b"1 4 0", b"1 4 what"),
        "two": ply("ascii", [[0, 1], *CUBE_FACES]),
        "beyond": ply("ascii", [[0, 1, 8], *CUBE_FACES]),
    }
    for name, data in damaged.items():
        (tmp_path / f"{name}.ply").write_bytes(data)
        with pytest.raises(InputError, match=f"{name}.ply"):
            import_bodies([tmp_path / f"{name}.ply"])


class Gltf:
    """Builds a glTF file piece by piece."""

    def __init__(self, **record: object) -> None:
        self.data = b""
        self.json: dict = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], **record}

    def add(self, values: np.ndarray, **more: object) -> int:
        values = np.asarray(values)
        component = {"u1": 5121, "u2": 5123, "u4": 5125, "f4": 5126}[values.dtype.str[1:]]
        width = {1: "SCALAR", 2: {2: "VEC2", 3: "VEC3", 4: "VEC4"}.get(values.shape[-1]), 3: "MAT4"}[values.ndim]
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes})
        self.data += values.tobytes() + b"\0" * (-values.nbytes % 4)
        view = len(self.json["bufferViews"]) - 1
        self.json["accessors"].append(
            {"bufferView": view, "componentType": component, "type": width, "count": len(values), **more}
        )
        return len(self.json["accessors"]) - 1

    def glb(self, path: Path) -> Path:
        self.json["buffers"] = [{"byteLength": len(self.data)}]
        path.write_bytes(glb(self.json, self.data))
        return path

    def text(self, path: Path, uri: str | None = None) -> Path:
        uri = uri or "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        self.json["buffers"] = [{"byteLength": len(self.data), "uri": uri}]
        path.write_text(json.dumps(self.json))
        return path


def two_material_cube() -> Gltf:
    """A cube whose first six triangles are red and the others half-grey, each with vertices of its own."""
    gltf = Gltf(
        scenes=[{"nodes": [0]}],
        nodes=[{"children": [1], "translation": [0, 0, 2]}, {"mesh": 0, "scale": [1, 2, 1]}],
        materials=[
            {"pbrMetallicRoughness": {"baseColorFactor": c}} for c in ([1, 0, 0, 1], [0.21404, 0.21404, 0.21404, 1])
        ],
    )
    primitives = []
    for material, part in enumerate((TRIANGLES[:6], TRIANGLES[6:])):
        positions = gltf.add(CUBE[part.reshape(-1)])
        indices = gltf.add(np.arange(part.size, dtype=np.uint16))
        primitives.append({"attributes": {"POSITION": positions}, "indices": indices, "material": material})
    gltf.json["meshes"] = [{"primitives": primitives}]
    return gltf


@pytest.mark.parametrize("binary", [True, False])
def test_gltf_materials_transforms_and_seams(tmp_path: Path, binary: bool) -> None:
    gltf = two_material_cube()
    read = import_bodies([gltf.glb(tmp_path / "c.glb") if binary else gltf.text(tmp_path / "c.gltf")])
    assert read.vertex_count == 8 and is_closed(read.triangles)
    assert np.array_equal(read.vertices[0][read.triangles], (CUBE * [1, 2, 1] + [0, 0, 2])[TRIANGLES])
    assert np.allclose(read.face_colors[0, :6], [1, 0, 0])
    assert np.allclose(read.face_colors[0, 6:], 0.5, atol=1e-3)


def test_gltf_textures_become_base_colours(tmp_path: Path) -> None:
    """Left half of the picture red, right half blue: of the lower triangle a quarter is red, of the upper one three."""
    Image.fromarray(np.array([[[255, 0, 0], [0, 0, 255]]] * 2, np.uint8)).save(tmp_path / "p.png")
    gltf = Gltf(nodes=[{"mesh": 0}], textures=[{"source": 0}], images=[{"uri": "p.png"}])
    gltf.json["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    attributes = {"POSITION": gltf.add(square), "TEXCOORD_0": gltf.add(np.ascontiguousarray(square[:, :2]))}
    indices = gltf.add(np.array([0, 1, 2, 0, 2, 3], np.uint8))
    gltf.json["meshes"] = [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}]
    read = import_bodies([gltf.glb(tmp_path / "c.glb")])
    assert np.allclose(read.face_colors[0], [[0.25, 0, 0.75], [0.75, 0, 0.25]])
    assert read.outfit_textures == ("c",) and read.textures["c"].tolist() == [[[255, 0, 0], [0, 0, 255]]] * 2
    assert np.allclose(read.uv[read.triangle_uv][..., 1], 1 - read.vertices[0][read.triangles][..., 1])
    (tmp_path / "p.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"c\.glb: image 0"):
        import_bodies([tmp_path / "c.glb"])


def bending_arm() -> Gltf:
    """A strip of two quads along x; the outer bone, at x = 1, turns a quarter about z within a second."""
    strip = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]], np.float32)
    bind = np.stack([np.eye(4), np.eye(4)]).astype(np.float32)
    bind[1, 0, 3] = -1
    gltf = Gltf(
        nodes=[{"mesh": 0, "skin": 0, "translation": [9, 9, 9]}, {"children": [2]}, {"translation": [1, 0, 0]}],
        scenes=[{"nodes": [0, 1]}],
    )
    joints = np.array([[0, 1, 0, 0]] * 6, np.uint8)
    outer = np.array([0, 0, 1, 0, 0, 1], np.float32)
    weights = np.stack([1 - outer, outer, outer * 0, outer * 0], axis=1)
    attributes = {"POSITION": gltf.add(strip), "JOINTS_0": gltf.add(joints), "WEIGHTS_0": gltf.add(weights)}
    indices = gltf.add(np.array([0, 1, 4, 0, 4, 3, 1, 2, 5, 1, 5, 4], np.uint16))
    gltf.json["meshes"] = [{"primitives": [{"attributes": attributes, "indices": indices}]}]
    gltf.json["skins"] = [{"joints": [1, 2], "inverseBindMatrices": gltf.add(bind.transpose(0, 2, 1).copy())}]
    turn = np.array([[0, 0, 0, 1], [0, 0, np.sqrt(0.5), np.sqrt(0.5)]], np.float32)
    sampler = {"input": gltf.add(np.array([0, 1], np.float32)), "output": gltf.add(turn)}
    gltf.json["animations"] = [
        {"samplers": [sampler], "channels": [{"sampler": 0, "target": {"node": 2, "path": "rotation"}}]}
    ]
    return gltf


def test_gltf_skins_and_animation_frames(tmp_path: Path) -> None:
    path = bending_arm().glb(tmp_path / "arm.glb")
    still = import_bodies([path])
    assert np.allclose(still.vertices[0, :, :2].max(axis=0), [2, 1])  # a skinned node's own transform does not count
    moving = import_bodies([path], frames=3)
    assert moving.names == ("arm 000", "arm 001", "arm 002") and moving.topology == still.topology
    tip = moving.vertices[:, np.flatnonzero((still.vertices[0] == [2, 0, 0]).all(axis=1))[0]]
    half = np.sqrt(0.5)
    assert np.allclose(tip, [[2, 0, 0], [1 + half, half, 0], [1, 1, 0]], atol=1e-6)


def test_gltf_that_is_not_read(tmp_path: Path) -> None:
    whole, draco, strip = two_material_cube(), two_material_cube(), two_material_cube()
    draco.json["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    strip.json["meshes"][0]["primitives"][0]["mode"] = 5
    for name, made, frames in (("draco", draco, 0), ("strip", strip, 0), ("whole", whole, 4)):
        with pytest.raises(InputError, match=rf"{name}\.glb.*{'no animation' if frames else ''}"):
            import_bodies([made.glb(tmp_path / f"{name}.glb")], frames=frames)


def test_buffers_are_not_copied_for_every_primitive(tmp_path: Path) -> None:
    """Merging took time in the square of the primitives: each copied the whole buffer view."""
    count, size = 500, 16 << 20
    made = gltf(count=3)
    made["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}}] * count}]
    made["buffers"] = [{"byteLength": size}]
    made["bufferViews"] = [{"buffer": 0, "byteLength": size}]
    binary = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    (tmp_path / "a.glb").write_bytes(glb(made, binary + bytes(size - len(binary))))

    started = time.process_time()
    mesh = read_gltf(tmp_path / "a.glb")
    assert len(mesh.loop_total) == count and mesh.poses.shape == (1, 3, 3)
    assert time.process_time() - started < 1, "500 copies of 16 MiB take longer"


def test_pictures_together_larger_than_any(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One picture in many colours would be held once for each of them."""
    (tmp_path / "white.png").write_bytes(png_of(60, 60, rows=60))
    monkeypatch.setattr("cloak_core.sources.bodies.meshes.gltf_document.MAX_PIXELS", 2 * 60 * 60)
    made = gltf(count=3)
    made["images"] = [{"uri": "white.png"}]
    made["textures"] = [{"source": 0}]
    made["materials"] = [
        {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "baseColorFactor": [0.1 * i, 1, 1, 1]}}
        for i in range(1, 4)
    ]
    made["accessors"].append({"componentType": 5126, "count": 3, "type": "VEC2"})
    attributes = {"POSITION": 0, "TEXCOORD_0": 1}
    made["meshes"] = [{"primitives": [{"attributes": attributes, "material": i} for i in range(3)]}]
    (tmp_path / "a.gltf").write_text(json.dumps(made))
    with pytest.raises(InputError, match="its pictures have more than"):
        read_gltf(tmp_path / "a.gltf")
