"""Pickles made to harm: each is refused in one line, or read, within a memory limit and a few seconds."""

import json
import pickle
import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cloak_core.files.errors import InputError
from cloak_core.files.torch_pickles import read_torch_pickle
from cloak_core.files.unpickling import read_pickled_arrays
from tests.files.hostile_pickles import BOMBS, extents, name, text, tuple_of, unfilled_bytes
from tests.reliability_record import record

ROOT = Path(__file__).parents[2]


@pytest.mark.reliability
@pytest.mark.long
@pytest.mark.parametrize("kind", ["arrays", "torch"])
def test_two_thousand_hostile_files_in_two_gigabytes(kind: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.files.hostile_pickles", kind, "2000", "3"]
    done = subprocess.run(
        command, cwd=tmp_path, env={"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    counts = json.loads(done.stdout)
    assert counts["files"] == 2000 and counts["read"] > 10 and counts["refused"] > 1000, counts
    named = {"arrays": "SMPL's pickles", "torch": "torch's archives"}[kind]
    figures = f"{counts['read']} read, {counts['refused']} refused, 0 crashed; the slowest {counts['slowest_s']} s"
    record("Files from strangers", f"hostile {named} by structure, each in a process of 2 GiB: 2,000", figures)


def dtype(code: str, *state: bytes) -> bytes:
    made = name(("numpy", "dtype")) + tuple_of([text(code), b"K\0", b"K\1"]) + b"R"
    return made + (tuple_of([*state]) + b"b" if state else b"")


def refused(value: bytes, words: str, tmp_path: Path) -> None:
    """The value of a dictionary is refused by both readers, in these words."""
    content = b"\x80\x02}" + text("k") + value + b"s."
    bare, archive = tmp_path / "a.pkl", tmp_path / "a.pt"
    bare.write_bytes(content)
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("a/data.pkl", content)
    for read, path in ((read_pickled_arrays, bare), (read_torch_pickle, archive)):
        with pytest.raises(InputError, match=words):
            read(path)


@pytest.mark.parametrize("code", ["O", "V8", "(1000,1000)f8", "f4,f4", "M8[s]"])
def test_a_type_that_is_no_number(code: str, tmp_path: Path) -> None:
    refused(dtype(code), "no type of numbers", tmp_path)


def test_a_type_of_numbers_whose_state_says_objects(tmp_path: Path) -> None:
    """numpy takes its word for it, and follows the bytes as pointers."""
    state = (b"K\3", text("|"), b"N", b"N", b"N", b"J\xff\xff\xff\xff", b"J\xff\xff\xff\xff", b"K\x3f")
    array = unfilled_bytes + tuple_of([b"K\1", extents(1), dtype("f8", *state), b"\x89", b"C\x08" + b"A" * 8]) + b"b"
    (tmp_path / "a.pkl").write_bytes(b"\x80\x02}" + text("k") + array + b"s.")
    assert read_pickled_arrays(tmp_path / "a.pkl")["k"].dtype == np.float64


def test_an_array_is_filled_once(tmp_path: Path) -> None:
    """Filled again, tensors that look at its numbers would look at freed memory."""
    state = tuple_of([b"K\1", extents(1), dtype("u1"), b"\x89", b"C\x01a"])
    refused(unfilled_bytes + state + b"b" + state + b"b", "a state for a ndarray", tmp_path)


def test_a_memo_index_takes_no_memory(tmp_path: Path) -> None:
    (tmp_path / "a.pkl").write_bytes(b"\x80\x02}r" + struct.pack("<I", 1 << 29) + text("k") + b"K\1s.")
    assert read_pickled_arrays(tmp_path / "a.pkl") == {"k": 1}


@pytest.mark.parametrize("bomb", ["tuples in tuples as a key", "tuples in tuples in a set"])
def test_keys_that_take_ages_to_hash(bomb: str, tmp_path: Path) -> None:
    refused(BOMBS[bomb](60), r"a tuple as a key|builtins\.set, which is never loaded", tmp_path)


@pytest.mark.slow
def test_what_grows_beyond_the_file(tmp_path: Path) -> None:
    for bomb in ("a text encoded over and over", "one array's bytes for many"):
        refused(BOMBS[bomb](20_000), "far more memory than the file", tmp_path)


def test_lengths_beyond_the_file(tmp_path: Path) -> None:
    refused(b"\x8e" + struct.pack("<Q", 1 << 62), "expected|remain|breaks off", tmp_path)
    refused(b"\x8b" + struct.pack("<i", 1 << 30), "an integer of absurd size", tmp_path)


def test_states_change_nothing_but_records(tmp_path: Path) -> None:
    """Python's unpickler sets attributes of whatever it is given a state for: functions and classes, too."""
    refused(name(("copyreg", "_reconstructor")) + b"}" + text("make") + b"K\1sb", "a state for a", tmp_path)


@pytest.mark.parametrize("protocol", range(6))
def test_arrays_of_every_protocol(protocol: int, tmp_path: Path) -> None:
    made = {
        "plain": np.arange(12.0).reshape(3, 4),
        "columns": np.asfortranarray(np.arange(6, dtype=np.int32).reshape(2, 3)),
        "other order": np.arange(5, dtype=">f4"),
        "none": np.zeros((0, 3)),
        "word": np.array(["a", "bc"]),
        "flag": np.array([True, False]),
        "number": np.float64(0.5),
        "text": "x",
        "bytes": b"\xff",
        "nothing": b"",
    }
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(made, protocol))
    read = read_pickled_arrays(tmp_path / "a.pkl")
    for key, value in made.items():
        np.testing.assert_array_equal(read[key], value)
