"""Small files that unfold to large meshes, and numbers that no array takes: refused in one line."""

import json
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.core.pictures import open_picture, read_picture
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.meshes.gltf import read_gltf
from tests.commands.malformed.making import glb, gltf, png_of


def document(primitives: int = 1) -> dict:
    made = gltf(count=3)
    made["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}}] * primitives}]
    return made


def test_buffers_are_not_copied_for_every_primitive(tmp_path: Path) -> None:
    """Merging took time in the square of the primitives: each copied the whole buffer view."""
    count, size = 500, 16 << 20
    made = document(primitives=count)
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
    made = document()
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


def test_formats_that_start_programs_are_no_pictures(tmp_path: Path) -> None:
    Image.new("RGB", (4, 4)).save(tmp_path / "a.eps")
    with pytest.raises(InputError, match=r"a\.eps: not a readable picture"):
        read_picture(tmp_path / "a.eps")
    Image.new("L", (4, 3), 7).save(tmp_path / "a.bmp")
    assert read_picture(tmp_path / "a.bmp").tolist() == [[[7, 7, 7]] * 4] * 3
    (tmp_path / "large.png").write_bytes(png_of(12000, 12000))
    with pytest.raises(InputError, match="12000 x 12000 pixels, more than"), open_picture(tmp_path / "large.png"):
        pass
