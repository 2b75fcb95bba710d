"""Run folders: checkpoints, records, events, colours."""

import hashlib
import json
import pickle
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from tests.commands.malformed.making import RESUME, Case, Evil, array, put, saved


def latest(folder: Path) -> Path:
    return max((folder / "run" / "checkpoint").iterdir())


def in_checkpoint(name: str, data: bytes) -> Callable[[Path], None]:
    return lambda folder: (latest(folder) / name).write_bytes(data) and None


def signed(data: bytes) -> Callable[[Path], None]:
    """State with a record that vouches for it."""

    def make(folder: Path) -> None:
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
