"""What is no regular file, or says it is larger than it is: refused at once, in one line."""

import os
from pathlib import Path

import numpy as np
import pytest

from cloak_core.core.events import read_events
from cloak_core.core.pictures import read_picture
from cloak_core.detectors.checkpoints import read_state_dict
from cloak_core.detectors.classes import read_names
from cloak_core.detectors.darknet.cfg import parse_cfg, read_cfg
from cloak_core.detectors.darknet.network import Network
from cloak_core.detectors.darknet.weights import read_weights
from cloak_core.exchange.face_lists import read_colors, read_face_list
from cloak_core.exchange.scenes import read_scene
from cloak_core.files.caching import DiskCache
from cloak_core.files.errors import InputError
from cloak_core.files.reading import (
    MAX_JSON_VALUES,
    open_regular,
    parse_json,
    read_json,
    read_npy,
    read_npz,
    read_text,
    read_toml,
)
from cloak_core.files.unpickling import read_pickled_arrays
from cloak_core.files.writing import lock, open_to_append, write_bytes, write_npz
from cloak_core.sources.bodies.logos.palette import read_palette
from cloak_core.sources.bodies.meshes.importing import read_bodies


def read_darknet_weights(path: Path) -> None:
    cfg = "[net]\nwidth=32\nheight=32\nchannels=3\n[convolutional]\nfilters=30\nsize=1\nstride=1\nactivation=linear\n"
    read_weights(Network(parse_cfg(cfg + "[region]\nanchors=1,1,2,2,3,3,4,4,5,5\nclasses=1\ncoords=4\nnum=5\n")), path)


READERS = {
    "a.bin": open_regular, "a.json": read_json, "a.toml": read_toml, "a.npy": read_npy, "a.npz": read_npz,
    "scene.npz": read_scene, "logo.npy": read_face_list, "colors.npy": read_colors, "a.png": read_picture,
    "a.obj": read_bodies, "a.ply": read_bodies, "a.glb": read_bodies, "a.fbx": read_bodies, "a.txt": read_palette,
    "a.pkl": read_pickled_arrays, "a.cfg": read_cfg, "a.weights": read_darknet_weights, "a.pth": read_state_dict,
    "a.safetensors": read_state_dict, "a.names": read_names, "a.jsonl": read_events, "b.jsonl": open_to_append,
    ".lock": lock,
}  # fmt: skip


@pytest.mark.parametrize("name", READERS)
def test_pipes_devices_and_link_loops_are_refused_at_once(name: str, tmp_path: Path) -> None:
    path = tmp_path / name

    def refused(words: str) -> None:
        with pytest.raises(InputError, match=words), READERS[name](path) or open_regular(tmp_path / "never"):
            pass
        path.unlink()

    os.mkfifo(path)
    refused("not a regular file|No such device|no such file")  # a pipe that nobody reads cannot be written to either
    path.symlink_to("/dev/zero")
    refused("not a regular file|no such file")
    path.symlink_to(path)
    refused("symbolic links|cannot be written|no such")


def test_a_pipe_is_not_written_over(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="not a regular file"):
        write_bytes(tmp_path / "pipe", b"x")
    assert (tmp_path / "pipe").is_fifo() and len(list(tmp_path.iterdir())) == 1


def test_a_pipe_in_a_cache_counts_as_absent(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.rgb")
    assert DiskCache(tmp_path, ".rgb", 1000, "images").get("a") is None


@pytest.mark.parametrize("digits", ["9" * 20, "-" + "9" * 20, "9" * 5000, "1" * 4000])
def test_integers_beyond_64_bits(digits: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(f'{{"a": [{{"b": {digits}}}]}}')
    (tmp_path / "a.toml").write_text(f"[a]\nb = [{digits}]\n")
    for read, name in ((read_json, "a.json"), (read_toml, "a.toml")):
        with pytest.raises(InputError, match=rf"{name}: not valid (JSON|TOML) \(.*(64 bits|digits)"):
            read(tmp_path / name)


@pytest.mark.parametrize(
    "text", ["a." * 30000 + "a = 1", "['a'" + ' . "b"' * 30000 + "]", "x = {" + "a." * 90 + "a = 1}"]
)
def test_keys_of_many_parts(text: str, tmp_path: Path) -> None:
    """tomllib takes 20 seconds and 3.8 GB for the first one."""
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(InputError, match="a key of more than 32 parts"):
        read_toml(tmp_path / "a.toml")


def test_json_of_too_many_values() -> None:
    with pytest.raises(InputError, match="more values than"):
        parse_json(b"[" + b"{}," * MAX_JSON_VALUES + b"0]", "it")


@pytest.mark.parametrize("shape", [(2**40, 0, 3), (0, 2**40), (2**31, 2**31, 0)])
def test_arrays_of_nothing_with_absurd_extents(shape: tuple[int, ...], tmp_path: Path) -> None:
    with (tmp_path / "a.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})
    with pytest.raises(InputError, match="more than the file holds"):
        read_npy(tmp_path / "a.npy")


def test_an_archive_of_too_many_members(tmp_path: Path) -> None:
    write_npz(tmp_path / "a.npz", **{f"{i:0200}": np.zeros(0) for i in range(100)})
    data = (tmp_path / "a.npz").read_bytes()
    end = data.rindex(b"PK\5\6")
    entries = data[data.index(b"PK\1\2") : end]
    many = entries * 200
    tail = bytearray(data[end:])
    tail[12:16] = len(many).to_bytes(4, "little")
    (tmp_path / "a.npz").write_bytes(data[: -len(entries) - len(tail)] + many + tail)
    with pytest.raises(InputError, match="too many members"):
        read_npz(tmp_path / "a.npz")


@pytest.mark.slow
def test_what_is_read_in_pieces_is_what_was_written(tmp_path: Path) -> None:
    arrays = {"big": np.arange(700_001), "words": np.array(["a", "bc"]), "none": np.zeros((0, 3)), "one": np.array(2.0)}
    arrays["columns"] = np.asfortranarray(np.random.default_rng(0).random((300, 2000)))
    write_npz(tmp_path / "a.npz", compressed=True, **arrays)
    read = read_npz(tmp_path / "a.npz")
    assert read.keys() == arrays.keys()
    for name, array in arrays.items():
        assert np.array_equal(read[name], array) and read[name].dtype == np.asarray(array).dtype
    with (tmp_path / "a.npz").open("rb") as file:
        data = file.read()
    (tmp_path / "b.npz").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match=r"b\.npz"):
        read_npz(tmp_path / "b.npz")


def test_text_of_another_encoding(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(b"\xff")
    with pytest.raises(InputError, match="not UTF-8"):
        read_text(tmp_path / "a.txt", 10)
    with pytest.raises(InputError, match="larger than any file of its kind"):
        read_text(tmp_path / "a.txt", 0)
