"""Views kept between runs: found again, the same to the bit, and only where nothing that decides them has changed."""

import dataclasses
import multiprocessing
from pathlib import Path

import numpy as np
import pytest
import torch
from bodies_made import sphere
from safetensors.torch import load, save

from cloak_core.core.cameras import Camera
from cloak_core.core.view import View
from cloak_core.core.visibility.compiled import torch_alone
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.caching import DiskCache
from cloak_core.sources.bodies import view_files as stored
from cloak_core.sources.bodies.view_cache import ViewCache

CAMERA = Camera(distance=4.0, azimuth=20.0, width=60, height=50)
WANTED = [(0, CAMERA), (1, CAMERA), (0, dataclasses.replace(CAMERA, azimuth=90.0))]


def files(folder: Path, limit: int = 1 << 30) -> DiskCache:
    return DiskCache(folder, ".view", limit, "views")


def cache(folder: Path, bodies: Bodies | None = None, **options) -> ViewCache:
    return ViewCache(bodies or sphere(poses=2), RenderSettings(files=files(folder), **options))


class Built(Exception):
    """A view was built, not read."""


def no_building(monkeypatch) -> None:
    def build(*_: object, **__: object) -> None:
        raise Built

    monkeypatch.setattr(ViewCache, "build", build)


def assert_same(one: View, other: View) -> None:
    for field in dataclasses.fields(View):
        ours, theirs = getattr(one, field.name), getattr(other, field.name)
        if isinstance(ours, torch.Tensor):
            assert ours.dtype == theirs.dtype and torch.equal(ours, theirs), field.name
        else:
            assert ours == theirs, field.name


def textured() -> Bodies:
    bodies = sphere()
    corners = np.arange(3 * bodies.triangle_count)
    uv = np.random.default_rng(0).uniform(0, 1, (len(corners), 2))
    return dataclasses.replace(
        bodies, uv=uv, triangle_uv=corners.reshape(-1, 3), textures={"skin": np.full((4, 4, 3), 90, np.uint8)},
        outfit_textures=("skin", ""),
    )  # fmt: skip


@pytest.mark.parametrize("samples", [None, 4])
def test_a_second_run_builds_nothing_and_sees_the_same(tmp_path, monkeypatch, samples: int | None):
    first = cache(tmp_path, samples=samples).views(WANTED)
    no_building(monkeypatch)
    for built, read in zip(first, cache(tmp_path, samples=samples).views(WANTED), strict=True):
        assert_same(built, read)


def test_textured_bodies_and_views_without_any_body(tmp_path, monkeypatch):
    away = dataclasses.replace(CAMERA, pivot=(0.0, 50.0, 0.0))
    first = [cache(tmp_path, textured()).view(0, camera) for camera in (CAMERA, away)]
    assert first[0].uv is not None and not len(first[1].pixels)
    no_building(monkeypatch)
    for built, camera in zip(first, (CAMERA, away), strict=True):
        assert_same(built, cache(tmp_path, textured()).view(0, camera))


@pytest.mark.parametrize(
    "changed", ["vertices", "triangles", "faces", "camera", "light", "samples", "uv", "code", "pivot"]
)
def test_what_decides_a_view_decides_its_name(tmp_path, monkeypatch, changed: str):
    bodies, options, camera = textured(), {}, CAMERA
    cache(tmp_path, bodies).view(0, camera)
    if changed == "vertices":
        bodies = dataclasses.replace(bodies, vertices=bodies.vertices * np.float32(1.0000001))
    if changed == "triangles":
        bodies = dataclasses.replace(bodies, triangles=np.roll(bodies.triangles, 1, axis=1))
    if changed == "faces":
        bodies = dataclasses.replace(bodies, triangle_face=bodies.triangle_face[::-1])
    if changed == "uv":
        bodies = dataclasses.replace(bodies, uv=bodies.uv / 2)
    if changed == "camera":
        camera = dataclasses.replace(camera, distance=np.nextafter(4.0, 5.0))
    if changed == "pivot":
        camera = dataclasses.replace(camera, pivot=(0.0, 0.0, 0.0))
    if changed == "light":
        options["light"] = Light(shininess=65.0)
    if changed == "samples":
        options["samples"] = 64  # as many as an area view counts in doubtful pixels
    if changed == "code":
        monkeypatch.setattr(stored, "code_hash", lambda *rooms: "another renderer")
    no_building(monkeypatch)
    with pytest.raises(Built):
        cache(tmp_path, bodies, **options).view(0, camera)


def test_what_loops_and_what_torch_make_are_apart(tmp_path):
    cache(tmp_path).view(0, CAMERA)
    with torch_alone():
        cache(tmp_path).view(0, CAMERA)
    assert len(list(tmp_path.iterdir())) == 2


def test_bodies_that_were_changed_in_place_are_not_found_under_the_old_name(tmp_path):
    bodies, vertices = sphere(poses=2), sphere(poses=2).vertices.copy()
    with pytest.raises(ValueError, match="read-only"):
        bodies.vertices[0] += 1
    theirs = dataclasses.replace(bodies, vertices=vertices)
    kept = cache(tmp_path, theirs)
    vertices[:, :, 0] *= 2
    assert_same(kept.view(0, CAMERA), ViewCache(bodies).view(0, CAMERA))


def test_colours_do_not_decide_a_view(tmp_path, monkeypatch):
    cache(tmp_path).view(0, CAMERA)
    no_building(monkeypatch)
    bodies = sphere(poses=2)
    cache(tmp_path, dataclasses.replace(bodies, face_colors=bodies.face_colors / 2)).view(0, CAMERA)


def doctored(change: str):
    def damage(data: bytes) -> bytes:
        tensors = load(data[:-4])
        if change == "face beyond":
            tensors["face"][3] = sphere().face_count
        if change == "negative pixel":
            tensors["pixels"][0] = -1
        if change == "pixel beyond":
            tensors["pixels"][-1] = CAMERA.width * CAMERA.height
        if change == "rows that go back":
            tensors["crow"][1] = tensors["crow"][-1] + 5
        if change == "too few rows":
            tensors["crow"] = tensors["crow"][:-1].contiguous()
        if change == "missing":
            del tensors["weight"]
        if change == "doubles":
            tensors["coverage"] = tensors["coverage"].double()
        if change == "texture":
            tensors["uv"] = torch.zeros(2, len(tensors["face"]))
        return with_checksum(save(tensors))

    return damage


def with_checksum(data: bytes) -> bytes:
    import zlib

    return data + zlib.crc32(data).to_bytes(4, "little")


DAMAGE = {
    "torn": lambda data: data[:-100],
    "a bit": lambda data: data[:2000] + bytes([data[2000] ^ 1]) + data[2001:],
    "empty": lambda data: b"",
    "foreign": lambda data: with_checksum(b"GIF89a" + bytes(100)),
    "a huge header": lambda data: with_checksum(bytes([255] * 8) + bytes(100)),
} | {
    name: doctored(name)
    for name in (
        "face beyond", "negative pixel", "pixel beyond", "rows that go back", "too few rows", "missing", "doubles",
        "texture",
    )
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGE)
def test_a_file_that_is_no_such_view_is_built_anew(tmp_path, name: str):
    whole = cache(tmp_path).view(0, CAMERA)
    (file,) = tmp_path.iterdir()
    sound = file.read_bytes()
    file.write_bytes(DAMAGE[name](sound))
    assert file.read_bytes() != sound
    assert_same(whole, cache(tmp_path).view(0, CAMERA))
    assert file.read_bytes() == sound


def _look(folder: Path, turn: float) -> int:
    torch.set_num_threads(1)
    views = cache(folder).views([(0, dataclasses.replace(CAMERA, azimuth=a + turn)) for a in range(0, 360, 30)])
    return sum(len(view.pixels) for view in views)


@pytest.mark.long
def test_several_processes_share_the_folder_within_its_limit(tmp_path):
    with multiprocessing.get_context("forkserver").Pool(4) as pool:
        counts = pool.starmap(_look, [(tmp_path, 0.0)] * 4)
    assert len(set(counts)) == 1
    names = sorted(tmp_path.iterdir())
    assert len(names) == 12 and all(path.suffix == ".view" for path in names)
    limit = sum(path.stat().st_size for path in names) // 2
    ViewCache(sphere(poses=2), RenderSettings(files=files(tmp_path, limit))).view(1, CAMERA)
    assert 0 < sum(path.stat().st_size for path in tmp_path.iterdir()) <= limit
    assert _look(tmp_path, 0.0) == counts[0]


def test_a_pose_that_is_not_there_is_refused_as_ever(tmp_path):
    from cloak_core.files.errors import InputError

    with pytest.raises(InputError, match="pose 7"):
        cache(tmp_path).view(7, CAMERA)
