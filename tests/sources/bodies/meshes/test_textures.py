"""Textures on bodies: from files, on UV maps of other files, several as one."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.scenes import read_scene, write_scene
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.meshes.importing import import_bodies
from cloak_core.sources.bodies.meshes.textures import dress_in_textures, read_textures, texture_means, with_uv_of

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
UVS = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"


def picture(path: Path, *colors: tuple[int, int, int], side: int = 8) -> Path:
    """Vertical stripes of plain colours."""
    row = np.repeat(np.array(colors, np.uint8), side, axis=0)
    Image.fromarray(np.repeat(row[None], side, axis=0)).save(path)
    return path


def two_quads() -> Bodies:
    vertices = np.array([[[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]]], np.float32)
    return Bodies(vertices=vertices, triangles=np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]]))


def test_the_uv_map_of_another_file_whatever_its_order_and_cut(tmp_path: Path) -> None:
    """Quads in another order, starting at other corners; the second one's texture coordinates lie apart."""
    (tmp_path / "map.obj").write_text(
        "".join(f"v {x} {y} 0\n" for y in (0, 1) for x in (0, 1, 2))
        + "vt 0 0\nvt 0.5 0\nvt 0.5 1\nvt 0 1\nvt 0.6 0\nvt 1 0\nvt 1 1\nvt 0.6 1\n"
        + "f 3/6 6/7 5/8 2/5\nf 4/4 1/1 2/2 5/3\n"
    )
    bodies = with_uv_of(two_quads(), tmp_path / "map.obj")
    corners = bodies.uv[bodies.triangle_uv]
    assert np.allclose(corners[0], [[0, 0], [0.5, 0], [0.5, 1]]) and np.allclose(corners[1, 2], [0, 1])
    assert np.allclose(corners[2], [[0.6, 0], [1, 0], [1, 1]]) and np.allclose(corners[3, 2], [0.6, 1])
    textures = read_textures([picture(tmp_path / "halves.png", (255, 0, 0), (0, 0, 255)), tmp_path / "halves.png"])
    dressed = dress_in_textures(bodies, textures)
    assert dressed.outfit_textures == ("halves", "halves 1") and dressed.topology == bodies.topology
    assert np.allclose(dressed.face_colors[0], [[1, 0, 0]] * 2 + [[0, 0, 1]] * 2)
    read = read_scene(write_scene(tmp_path / "scene", dressed))
    assert read.outfit_textures == dressed.outfit_textures and np.array_equal(
        read.textures["halves"], textures["halves"]
    )
    assert read.select_poses([0]).outfit_textures == dressed.outfit_textures


def test_a_texture_without_uvs_is_refused(tmp_path: Path) -> None:
    (tmp_path / "no.png").write_bytes(b"nothing")
    (tmp_path / "empty").mkdir()
    for path, says in (("no.png", "not a readable picture"), ("absent.png", "no such file"), ("empty", "no png")):
        with pytest.raises(InputError, match=f"{path}.*{says}"):
            read_textures([tmp_path / path])
    picture(tmp_path / "p.png", (1, 2, 3))
    with pytest.raises(InputError, match=r"texture 'p': .* no texture coordinates"):
        dress_in_textures(two_quads(), read_textures([tmp_path / "p.png"]))
    (tmp_path / "m.mtl").write_text("newmtl skin\nmap_Kd -s 1 1 1 p.png\n")
    (tmp_path / "a.obj").write_text(f"mtllib m.mtl\n{SQUARE}{UVS}usemtl skin\nf 1 2 3 4\n")
    with pytest.raises(InputError, match=r"a\.obj: face 0 has a texture but no texture coordinates"):
        import_bodies([tmp_path / "a.obj"])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (SQUARE + "f 1 2 3 4\n", "no texture coordinates"),
        (SQUARE + UVS + "f 1/1 2/2 3/3 4/4\n", "4 vertices, but the body has 6"),
        ("v 0 0 0\nv 1 0 0\n" + SQUARE + UVS + "f 1/1 2/2 3/3 4/4\n", "triangle 0 "),
    ],
)
def test_uv_files_that_do_not_fit(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "uv.obj").write_text(text)
    with pytest.raises(InputError, match=rf"uv\.obj.*{says}"):
        with_uv_of(two_quads(), tmp_path / "uv.obj")


def test_obj_materials_with_pictures_and_plain_ones_share_a_picture(tmp_path: Path) -> None:
    """Three materials in turn, faces in the file's order; the plain one's faces have no texture coordinates."""
    picture(tmp_path / "halves.png", (255, 0, 0), (0, 0, 255))
    picture(tmp_path / "green.png", (0, 255, 0), side=5)
    (tmp_path / "m.mtl").write_text(
        "newmtl a\nKd 0.1 0.1 0.1\nmap_Kd halves.png\nnewmtl b\nmap_Kd green.png\nnewmtl c\nKd 1 1 1\n"
    )
    (tmp_path / "s.obj").write_text(
        f"mtllib m.mtl\n{SQUARE}{UVS}vt 1.5 0\nvt 2 0\nvt 2 1\n"
        "usemtl b\nf 1/1 2/2 3/3\nusemtl c\nf 1 3 4\nusemtl a\nf 1/5 2/6 3/7\nusemtl b\nf 1/1 3/3 4/4\n"
    )
    read = import_bodies([tmp_path / "s.obj"])
    assert np.allclose(read.face_colors[0], [[0, 1, 0], [1, 1, 1], [0, 0, 1], [0, 1, 0]])
    assert np.allclose(texture_means(read, read.textures["s"]), read.face_colors[0])
    assert read.outfit_textures == ("s",)


def test_a_picture_that_is_not_there_is_a_warning(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl skin\nKd 1 0 0\nmap_Kd C:\\pictures\\skin.png\n")
    (tmp_path / "a.obj").write_text(f"mtllib m.mtl\n{SQUARE}{UVS}usemtl skin\nf 1/1 2/2 3/3 4/4\n")
    with pytest.warns(UserWarning, match=r"a\.obj: its picture 'C:.pictures.skin\.png'"):
        read = import_bodies([tmp_path / "a.obj"])
    assert np.allclose(read.face_colors, [1, 0, 0]) and not any(read.outfit_textures)


def test_scenes_with_textures_are_checked() -> None:
    bodies = two_quads()
    fields = {"vertices": bodies.vertices, "triangles": bodies.triangles}
    image = {"p": np.zeros((2, 2, 3), np.uint8)}
    for more, says in (
        ({"outfit_textures": ("p",)}, "no texture 'p'"),
        ({"outfit_textures": ("p", ""), "textures": image}, "2 for 1 outfits"),
        ({"outfit_textures": ("p",), "textures": image}, "no texture coordinates"),
        ({"textures": {"q": np.zeros((0, 2, 3), np.uint8)}}, "texture_q: no pixels"),
    ):
        with pytest.raises(InputError, match=says):
            Bodies(**fields, **more)


def test_uv_arrays_as_smplx_files_have_them(tmp_path: Path) -> None:
    np.savez(tmp_path / "uv.npz", vt=np.random.default_rng(0).random((5, 2)), ft=np.array([[0, 1, 2], [2, 3, 4]] * 2))
    assert with_uv_of(two_quads(), tmp_path / "uv.npz").triangle_uv.shape == (4, 3)
    np.savez(tmp_path / "bad.npz", vt=np.zeros((5, 2)), ft=np.zeros((3, 3), int))
    with pytest.raises(InputError, match=r"bad\.npz: vt, ft: triangle_uv"):
        with_uv_of(two_quads(), tmp_path / "bad.npz")
