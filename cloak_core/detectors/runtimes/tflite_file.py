"""TensorFlow Lite files, read and run by LiteRT (package ai-edge-litert) on the CPU."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping

import numpy as np
import torch

from cloak_core.detectors.classes import read_description
from cloak_core.detectors.onnx_family.detector import OnnxDetector, file_and_layout, load_black_box
from cloak_core.detectors.onnx_family.layouts import SYMMETRIC
from cloak_core.detectors.onnx_family.model_file import NetworkFile, image_input
from cloak_core.detectors.pixels import PixelFormat
from cloak_core.detectors.specs import Request
from cloak_core.files.errors import InputError, first_line
from cloak_core.files.identity import sha256_arrays
from cloak_core.files.reading import read_bytes

LABELS_BYTES = 1 << 20


def load_tflite(request: Request) -> OnnxDetector:
    """Load `tflite:FILE.tflite[:LAYOUT]` for one image, as a black box; integers outside become real numbers.

    InputError: no such file, one that LiteRT does not read, what `assemble` refuses.
    """
    from ai_edge_litert.interpreter import Interpreter

    path, _ = file_and_layout(request)
    data = read_bytes(path)
    try:
        interpreter = Interpreter(model_content=data, num_threads=torch.get_num_threads())
        inputs = interpreter.get_input_details()
    except Exception as error:  # the runtime's own
        raise InputError(f"{path}: not a TFLite network ({first_line(error)[:160]})") from None
    if len(inputs) != 1:
        raise InputError(f"{path}: has {len(inputs)} inputs, not one of images")
    shape = [None if extent < 0 else int(extent) for extent in inputs[0]["shape_signature"]]
    channels_last, size = image_input(shape, request.input_size, None, path)
    try:
        interpreter.resize_tensor_input(inputs[0]["index"], [1, *size, 3] if channels_last else [1, 3, *size])
        interpreter.allocate_tensors()
    except Exception as error:
        raise InputError(f"{path}: LiteRT cannot run it at {size[0]}x{size[1]} ({first_line(error)[:160]})") from None
    given, outputs = interpreter.get_input_details()[0], interpreter.get_output_details()

    def run(image: np.ndarray) -> list[np.ndarray]:
        interpreter.set_tensor(given["index"], _quantised(image, given))
        interpreter.invoke()
        return [_real(interpreter.get_tensor(output["index"]), output) for output in outputs]

    file = NetworkFile(
        path=path,
        digest=sha256_arrays(np.frombuffer(data, np.uint8)),
        channels_last=channels_last,
        size=size,
        output_names=tuple(str(output["name"]) for output in outputs),
        names=_labels(data),
        pixels=_pixels(given),
        described=read_description(path),
    )
    return load_black_box(request, file, run, "ai-edge-litert")


def _quantised(image: np.ndarray, given: Mapping) -> np.ndarray:
    """Convert real numbers to the input's type, by its scale and zero point."""
    if np.issubdtype(given["dtype"], np.floating):
        return image.astype(given["dtype"])
    scale, zero = given["quantization"]
    bounds = np.iinfo(given["dtype"])
    return np.clip(np.rint(image / (scale or 1.0) + zero), bounds.min, bounds.max).astype(given["dtype"])


def _real(values: np.ndarray, output: Mapping) -> np.ndarray:
    scale, zero = output["quantization"]
    if np.issubdtype(values.dtype, np.floating) or not scale:
        return np.array(values, np.float32)
    return ((values.astype(np.float32) - zero) * scale).astype(np.float32)


def _pixels(given: Mapping) -> PixelFormat | None:
    """Find the pixel format that an input of integers stands for; None where it is no usual range."""
    if np.issubdtype(given["dtype"], np.floating):
        return None
    scale, zero = given["quantization"]
    bounds = np.iinfo(given["dtype"])
    low, high = ((bound - zero) * (scale or 1.0) for bound in (bounds.min, bounds.max))
    usual = ((0, 1, PixelFormat()), (0, 255, PixelFormat(range=255.0)), (-1, 1, SYMMETRIC))
    near = lambda a, b: abs(a - b) <= 0.02 * (high - low)
    return next((pixels for black, white, pixels in usual if near(low, black) and near(high, white)), None)


def _labels(data: bytes) -> tuple[str, ...] | None:
    """Read class names of a text file packed behind the network, as TFLite's metadata has them."""
    if not zipfile.is_zipfile(io.BytesIO(data)):
        return None
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        texts = [entry for entry in packed.infolist() if entry.filename.lower().endswith(".txt")]
        if len(texts) != 1 or texts[0].file_size > LABELS_BYTES:
            return None
        lines = packed.read(texts[0]).decode("utf-8", "replace").splitlines()
    return tuple(line.strip() for line in lines if line.strip()) or None
