"""100 hostile model files: each gives a detector that answers, or one line that names the file; nothing hangs.

Each is a sound small network of its family, changed by seed where the format has its structure: operators, shapes,
types and attributes of ONNX, lines of a .cfg, entries and objects of a checkpoint's archive, headers of safetensors,
elements of an OpenVINO graph. Reading may end the process, so it is another:
`python -m tests.detectors.test_hostile_models FOLDER FIRST LAST` prints a record for each file as soon as it is read.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import re
import shutil
import subprocess
import sys
import time
import traceback
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch

VALUES = ("-1", "0", "1", "nan", "1e9", "", "99999999999999999999", "a", "7,7", "0.5", "-2147483648", "65537")
Make = Callable[[random.Random, Path], str]


def damaged(draw: random.Random, data: bytes) -> bytes:
    """Flip, cut, insert or overwrite bytes."""
    changed = bytearray(data)
    for _ in range(draw.randint(1, 3)):
        at = draw.randrange(len(changed) + 1)
        match draw.randrange(4):
            case 0:
                changed[at : at + 1] = bytes([draw.randrange(256)])
            case 1:
                del changed[at:]
            case 2:
                changed[at:at] = draw.randbytes(draw.randint(1, 16))
            case _:
                changed[at : at + 8] = draw.choice([b"\xff" * 8, b"\0" * 8, b"\x7f" * 8])
    return bytes(changed)


def onnx_file(draw: random.Random, folder: Path) -> str:
    import onnx

    from tests.detectors.test_onnx import Made

    made = Made()
    made.body()
    made.head()
    path = made.save(folder / "m.onnx", **draw.choice([{}, {"names": draw.choice(VALUES)}, {"imgsz": "[0, 0]"}]))
    model = onnx.load(str(path))
    graph = model.graph
    for _ in range(draw.randint(1, 3)):
        node, weight = draw.choice(graph.node), draw.choice(graph.initializer)
        match draw.randrange(11):
            case 0:
                node.op_type = draw.choice(["Loop", "If", "Gather", "Frob", "", "NonMaxSuppression", "Resize", "Sin"])
            case 1 if node.input:
                node.input[draw.randrange(len(node.input))] = draw.choice(["", "output", "images", "flat", "nowhere"])
            case 2 if node.output:
                node.output[0] = draw.choice(["images", "grid", "", "output"])
            case 3:
                for attribute in node.attribute:
                    attribute.ints[:] = [draw.choice([0, -1, 1 << 40, 3]) for _ in attribute.ints]
                    attribute.i = draw.choice([-9, 0, 7, 1 << 60])
            case 4 if weight.dims:
                weight.dims[draw.randrange(len(weight.dims))] = draw.choice([0, -1, 1 << 50, 5])
            case 5:
                weight.raw_data = weight.raw_data[: draw.randrange(len(weight.raw_data) + 1)]
            case 6:
                weight.data_type = draw.choice([0, 1, 6, 7, 8, 10, 11, 16, 23, 99])
            case 7:
                dims = graph.input[0].type.tensor_type.shape.dim
                dims[draw.randrange(4)].dim_value = draw.choice([0, -1, 1, 5, 1 << 40])
            case 8:
                weight.raw_data = b"\0\0\xc0\x7f" * (len(weight.raw_data) // 4)  # NaN
            case 9:
                weight.data_location = 1
                for key, value in (("location", draw.choice(["../../x", "/dev/zero", "m.onnx"])), ("offset", "-1")):
                    entry = weight.external_data.add()
                    entry.key, entry.value = key, value
            case _:
                model.opset_import[0].version = draw.choice([0, 1, 7, 99, -3])
    data = model.SerializeToString()
    path.write_bytes(damaged(draw, data) if draw.random() < 0.15 else data)
    return f"onnx:{path}"


def darknet_files(draw: random.Random, folder: Path) -> str:
    from tests.detectors.helpers import TINY_CFG, write_tiny

    spec = write_tiny(folder)
    if draw.random() < 0.7:
        lines = TINY_CFG.splitlines()
        for _ in range(draw.randint(1, 2)):
            at = draw.randrange(len(lines))
            key, _, _ = lines[at].partition("=")
            choices = [f"{key}={draw.choice(VALUES)}", "", lines[at] * 2, "[route]\nlayers=-9", "[shortcut]\nfrom=0"]
            lines[at] = draw.choice([*choices, "[yolo]", "[upsample]\nstride=4096", "[maxpool]\nsize=0\nstride=0"])
        (folder / "tiny.cfg").write_text("\n".join(lines) + "\n")
    else:
        weights = folder / "tiny.weights"
        weights.write_bytes(draw.choice([damaged(draw, weights.read_bytes()), b"\xff" * weights.stat().st_size]))
    return spec


def rezipped(draw: random.Random, path: Path) -> None:
    """An archive with an entry dropped, damaged, doubled or renamed."""
    with zipfile.ZipFile(path) as archive:
        entries = [(name, archive.read(name)) for name in archive.namelist()]
    at = draw.randrange(len(entries))
    name, data = entries[at]
    changes = [[], [(name, damaged(draw, data))], [("../" + name, data)], [(name, data[: len(data) // 2])]]
    entries[at : at + 1] = draw.choice(changes)
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in entries:
            archive.writestr(name, data)


def checkpoint(draw: random.Random, folder: Path) -> str:
    """A .pt of ultralytics: objects of other kinds in it, or another archive."""
    from tests.detectors.test_ultralytics_files import small

    path = folder / "m.pt"
    model = small()
    saved: object = {"model": model}
    match draw.randrange(6):
        case 0:
            model.names = draw.choice([None, 5, {}, {0: 7}, ["person"] * 9, {"a": "person"}, "person"])
        case 1:
            model.stride = draw.choice([None, "8", torch.tensor([]), torch.tensor([float("nan")]), torch.tensor([0.0])])
        case 2:
            parameter = draw.choice([*model.parameters()])
            parameter.data = draw.choice([parameter.data * float("nan"), parameter.data[:0], parameter.data.double()])
        case 3:
            model.yaml = draw.choice([None, {}, {"nc": 1 << 40}, model.yaml | {"head": []}, model.yaml | {"nc": "x"}])
        case 4:
            saved = draw.choice([model, [model], {"ema": model, "model": 3}, {}, {"model": model.state_dict()}, 7])
    torch.save(saved, path)
    if draw.random() < 0.35:
        rezipped(draw, path)
    return f"ultralytics:{path}"


def transformers_folder(draw: random.Random, folder: Path) -> str:
    """A small YOLOS: its configuration, or the header and bytes of its safetensors."""
    from tests.detectors.test_transformers import save

    save("Yolos", folder)
    config, weights = folder / "config.json", folder / "model.safetensors"
    if draw.random() < 0.5:
        record = json.loads(config.read_text())
        for key in draw.sample(sorted(record), 2):
            record[key] = draw.choice([None, -1, 0, "x", [], {}, 1 << 40, [0, 0], 0.5])
        config.write_text(draw.choice([json.dumps(record)] * 4 + ["", "[]", "null"]))
        return f"transformers:{folder}"
    data = weights.read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    name = draw.choice([name for name in header if name != "__metadata__"])
    match draw.randrange(5):
        case 0:
            header[name]["shape"] = draw.choice([[], [-1], [1 << 40], [3], "x"])
        case 1:
            header[name]["dtype"] = draw.choice(["I64", "F64", "X", None])
        case 2:
            header[name]["data_offsets"] = draw.choice([[8, 0], [0, 1 << 60], [-4, 4], []])
        case 3:
            header.pop(name)
        case _:
            header = {name: header[name] | {"shape": [2, 2]}}
    text = json.dumps(header).encode()
    whole = len(text).to_bytes(8, "little") + text + data[8 + length :]
    weights.write_bytes(damaged(draw, whole) if draw.random() < 0.4 else whole)
    return f"transformers:{folder}"


def openvino_files(draw: random.Random, folder: Path) -> str:
    from tests.detectors.test_runtimes import ir

    path = ir(folder, suppressed=draw.random() < 0.3)
    text = path.read_text()
    for _ in range(draw.randint(1, 3)):
        found = draw.choice([*re.finditer(r'="([^"]*)"', text)])
        match draw.randrange(3):
            case 0:
                text = text[: found.start(1)] + draw.choice(VALUES) + text[found.end(1) :]
            case 1:
                text = re.sub(r"<edge [^>]*/>", "", text, count=draw.randint(1, 3))
            case _:
                text = text.replace(draw.choice(["<dim>64</dim>", "<dim>3</dim>"]), draw.choice(["<dim>-1</dim>", ""]))
    path.write_text(text if draw.random() < 0.7 else damaged(draw, text.encode()).decode("utf-8", "replace"))
    if draw.random() < 0.3:
        path.with_suffix(".bin").write_bytes(damaged(draw, path.with_suffix(".bin").read_bytes()))
    return f"openvino:{path}"


def tflite_file(draw: random.Random, folder: Path) -> str:
    """No writer of TFLite is at hand: a flatbuffer's head over what is none."""
    path = folder / "m.tflite"
    path.write_bytes(draw.randbytes(4) + b"TFL3" + draw.choice([b"", b"\0" * 400, draw.randbytes(2000)]))
    return f"tflite:{path}"


KINDS: tuple[tuple[Make, int], ...] = (
    (onnx_file, 36), (darknet_files, 22), (checkpoint, 12), (transformers_folder, 10), (openvino_files, 15),
    (tflite_file, 5),
)  # fmt: skip
FILES = [make for make, count in KINDS for _ in range(count)]


def read(seed: int, folder: Path) -> dict:
    """Read one file and ask the detector about a picture: what went wrong, "" for nothing."""
    from cloak_core.detectors.loading import load_detector
    from cloak_core.files.errors import InputError
    from tests.detectors.helpers import images

    began, wrong, message = time.monotonic(), "", ""
    with contextlib.redirect_stdout(io.StringIO()):
        make = FILES[seed % len(FILES)]
        spec = make(random.Random(seed), folder)
        try:
            found = load_detector(spec)(images(1, 64, 96))
            wrong = "" if bool(found.boxes.isfinite().all()) else "boxes that are no numbers"
        except InputError as error:
            message = str(error)
            is_named = str(folder) in message or message.startswith("tflite:")
            wrong = "" if message.isprintable() and is_named else f"names no file: {message}"
        except BaseException:
            wrong = traceback.format_exc(limit=-4)
    return {"seed": seed, "kind": make.__name__, "said": message, "wrong": wrong, "seconds": time.monotonic() - began}


MODULES = ("onnx", "onnx2torch", "onnxruntime", "openvino", "ai_edge_litert", "ultralytics", "transformers")


@pytest.mark.long
def test_hostile_model_files_are_read_or_refused(tmp_path: Path) -> None:
    # Not imported here: ultralytics patches Pillow for the whole process, and the tests after this one would meet that.
    for module in MODULES:
        if find_spec(module) is None:
            pytest.skip(f"no package {module}")
    command = [sys.executable, "-m", "tests.detectors.test_hostile_models", str(tmp_path), "0", str(len(FILES))]
    here = Path(__file__).parents[2]
    done = subprocess.run(command, capture_output=True, text=True, timeout=500, cwd=here, env=os.environ, check=False)
    records = [json.loads(line) for line in done.stdout.splitlines()]
    # A library that ends the process leaves the files after it unread.
    assert len(records) == len(FILES) == 100 and done.returncode == 0, (len(records), done.stderr[-2000:])
    assert not [record for record in records if record["wrong"]]
    read = [record for record in records if not record["said"]]
    assert len(read) >= 3 and {record["kind"] for record in records} == {make.__name__ for make in FILES}


if __name__ == "__main__":
    root, first, last = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    for number in range(first, last):
        here = root / str(number)
        here.mkdir()
        print(json.dumps(read(number, here)), flush=True)
        shutil.rmtree(here)
