"""What a thing is: the same however it is held, another as soon as anything differs that decides a result."""

import dataclasses
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest

from cloak_core.exchange.bodies import Bodies, frozen
from cloak_core.files import identity
from cloak_core.files.identity import code_hash, package_versions, source_hash


def bodies(**changes: object) -> Bodies:
    numbers = np.random.default_rng(0)
    values: dict[str, object] = {
        "vertices": numbers.normal(size=(2, 4, 3)).astype(np.float32),
        "triangles": np.array([[0, 1, 2], [0, 2, 3], [1, 2, 3]]),
        "triangle_face": np.array([0, 0, 1]),
        "face_colors": numbers.uniform(0, 1, (2, 2, 3)),
        "uv": numbers.uniform(0, 1, (4, 2)),
        "triangle_uv": np.array([[0, 1, 2], [0, 2, 3], [1, 2, 3]]),
        "textures": {"skin": numbers.integers(0, 255, (5, 4, 3), np.uint8)},
        "outfit_textures": ("skin", ""),
    }
    return Bodies(**(values | changes))


def nudged(array: np.ndarray) -> np.ndarray:
    changed = np.array(array)
    changed.flat[-1] = changed.flat[-2]
    return changed


@pytest.mark.parametrize(
    "part",
    ["vertices", "triangles", "triangle_face", "face_colors", "uv", "triangle_uv", "textures", "outfit_textures"],
)
def test_whatever_an_image_depends_on_is_in_the_bodies_identity(part: str) -> None:
    ours = bodies()
    value = getattr(ours, part)
    other = {
        "textures": lambda: {"skin": nudged(value["skin"])},
        "outfit_textures": lambda: ("", "skin"),
        "triangle_face": lambda: np.array([0, 1, 1]),
    }.get(part, lambda: nudged(value))()
    assert dataclasses.replace(ours, **{part: other}).identity != ours.identity


def test_arrays_of_bodies_cannot_be_written_to_and_nobody_elses_memory_is_kept_or_frozen() -> None:
    vertices = bodies().vertices.copy()
    ours = bodies(vertices=vertices)
    vertices[0] = 7  # still theirs to write
    assert ours.identity == bodies().identity
    again = pickle.loads(pickle.dumps(ours))
    for one in (ours, again, ours.select_poses([0]), bodies(vertices=np.broadcast_to(vertices, vertices.shape))):
        for array in (one.vertices, one.triangles, one.triangle_face, one.face_colors, one.uv, one.textures["skin"]):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1
    shared = frozen(vertices.copy())
    assert bodies(vertices=shared).vertices is shared  # what nobody can write to is not copied


def test_the_code_of_a_room_is_all_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identity, "_PROJECT", tmp_path)
    (tmp_path / "render" / "inner").mkdir(parents=True)
    (tmp_path / "render" / "inner" / "loops.py").write_text("a = 1\n")
    (tmp_path / "other.py").write_text("b = 1\n")
    fresh = code_hash.__wrapped__
    before = fresh("render"), fresh("render", "other.py")
    (tmp_path / "other.py").write_text("b = 2\n")
    assert fresh("render") == before[0] and fresh("render", "other.py") != before[1]
    (tmp_path / "render" / "inner" / "loops.py").write_text("a = 2\n")
    assert fresh("render") != before[0]
    with pytest.raises(FileNotFoundError):
        fresh("renamed.py")


def test_a_python_file_is_known_with_what_it_imports_from_its_folder(tmp_path: Path) -> None:
    first = tmp_path / "first"
    (first / "parts").mkdir(parents=True)
    (first / "detector.py").write_text("import os\nimport near\ndef make():\n    from parts.head import Head\n")
    (first / "near.py").write_text("import further\n")
    (first / "further.py").write_text("x = 1\n")
    (first / "parts" / "__init__.py").write_text("")
    (first / "parts" / "head.py").write_text("class Head: pass\n")
    (first / "bystander.py").write_text("y = 1\n")
    before = source_hash(first / "detector.py")
    moved = shutil.copytree(first, tmp_path / "moved")
    (moved / "detector.py").rename(moved / "renamed.py")
    (moved / "bystander.py").write_text("y = 2\n")
    assert source_hash(moved / "renamed.py") == before
    for name in ("renamed.py", "near.py", "further.py", "parts/__init__.py", "parts/head.py"):
        content = (moved / name).read_text()
        (moved / name).write_text(content + "z = 3\n")
        assert source_hash(moved / "renamed.py") != before, name
        (moved / name).write_text(content)


def test_versions_of_packages() -> None:
    assert package_versions("numpy", "no-such-package") == {"numpy": np.__version__}
