"""Files that other runtimes run on the CPU, as black boxes: `openvino:FILE.xml` and `tflite:FILE.tflite`."""

from __future__ import annotations

import io
import sys
import zipfile
from collections.abc import Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
import torch

from cloak_core.detectors.classes import Description, confidence_of, read_description
from cloak_core.detectors.onnx_family.decoders import SsdHead
from cloak_core.detectors.onnx_family.detector import OnnxDetector, file_and_layout, load_black_box
from cloak_core.detectors.onnx_family.layouts import OPEN_MODEL_ZOO, SYMMETRIC, Layout
from cloak_core.detectors.onnx_family.model_file import NetworkFile, image_input
from cloak_core.detectors.pixels import PixelFormat
from cloak_core.detectors.specs import Request
from cloak_core.files.errors import InputError, first_line
from cloak_core.files.identity import sha256_arrays
from cloak_core.files.reading import read_bytes

if TYPE_CHECKING:
    import openvino

LABELS_BYTES = 1 << 20
TELEMETRY = "openvino_telemetry"


def load_openvino(request: Request) -> OnnxDetector:
    """Load `openvino:FILE.xml[:LAYOUT]`, an IR compiled for one image, as a black box.

    Where it ends in SSD's DetectionOutput, that layer is left out and its inputs are the outputs: all boxes, before any
    threshold. InputError: no such file, one that OpenVINO does not read, what `assemble` refuses.
    """
    path, _ = file_and_layout(request)
    with without_telemetry():
        import openvino

    parts = [read_bytes(part) for part in (path, path.with_suffix(".bin"))]
    core = openvino.Core()
    try:
        network = core.read_model(model=parts[0], weights=parts[1])
    except Exception as error:  # the runtime's own
        raise InputError(f"{path}: not an OpenVINO network ({_words(error)})") from None
    if len(network.inputs) != 1:
        raise InputError(f"{path}: has {len(network.inputs)} inputs, not one of images")
    shape = [None if d.is_dynamic else d.get_length() for d in network.input().get_partial_shape()]
    channels_last, size = image_input(shape, request.input_size, None, path)
    head = None
    try:
        network.reshape([1, *size, 3] if channels_last else [1, 3, *size])
        network, head = _before_suppression(network)
        threads = {"INFERENCE_NUM_THREADS": torch.get_num_threads(), "INFERENCE_PRECISION_HINT": "f32"}
        compiled = core.compile_model(network, "CPU", threads | {"NUM_STREAMS": 1})
    except Exception as error:
        raise InputError(f"{path}: OpenVINO cannot run it at {size[0]}x{size[1]} ({_words(error)})") from None
    inference = compiled.create_infer_request()

    def run(image: np.ndarray) -> list[np.ndarray]:
        inference.infer([image])
        return [np.array(inference.get_output_tensor(k).data, np.float32) for k in range(len(compiled.outputs))]

    file = NetworkFile(
        path=path,
        digest=sha256_arrays(*(np.frombuffer(part, np.uint8) for part in parts)),
        channels_last=channels_last,
        size=size,
        output_names=tuple(next(iter(output.names), f"output {k}") for k, output in enumerate(compiled.outputs)),
        said=(
            Description(
                names=tuple(_said(network, "labels").split()) or None,
                confidence=confidence_of({"confidence": _said(network, "confidence_threshold")}),
            ),
            read_description(path),
        ),
        layout=None if head is None else ("ssd-head", Layout(head, 0.5, pixels=OPEN_MODEL_ZOO)),
    )
    return load_black_box(request, file, run, "openvino")


def _before_suppression(network: openvino.Model) -> tuple[openvino.Model, SsdHead | None]:
    """Cut the network before its DetectionOutput layer and read what that does; leave it where none is plain."""
    import openvino
    import openvino.opset13

    layers = [op for op in network.get_ordered_ops() if op.get_type_name() == "DetectionOutput"]
    if len(layers) != 1 or len(layers[0].inputs()) != 3:
        return network, None
    attributes = layers[0].get_attributes()
    if not attributes["share_location"] or not attributes["normalized"] or attributes["decrease_label_id"]:
        return network, None
    offsets, scores = (port.get_shape()[-1] for port in layers[0].inputs()[:2])
    head = SsdHead(
        scores * 4 // offsets,
        int(attributes["background_label_id"]),
        attributes["code_type"].endswith("CENTER_SIZE"),
        not attributes["variance_encoded_in_target"],
    )
    # Weights in half precision give outputs in it, which would round scores.
    sources = [openvino.opset13.convert(port.get_source_output(), "f32") for port in layers[0].inputs()]
    return openvino.Model(sources, network.get_parameters(), network.get_friendly_name()), head


def _said(network: openvino.Model, name: str) -> str:
    """Read what OpenVINO's Model API notes of a network; "" for nothing."""
    place = ["model_info", name]
    return str(network.get_rt_info(place).value) if network.has_rt_info(place) else ""


def _words(error: Exception) -> str:
    """Give the runtime's reason: its first lines name only its own sources."""
    lines = [
        line for line in str(error).splitlines() if line.strip() and not line.startswith(("Exception from", "Check"))
    ]
    return (lines[0].strip() if lines else first_line(error))[:160]


@contextmanager
def without_telemetry():
    """Import openvino without the package that reports its use; it does without."""
    before = sys.modules.get(TELEMETRY)
    if before is None:
        sys.modules[TELEMETRY] = None
    try:
        yield
    finally:
        if before is None:
            sys.modules.pop(TELEMETRY, None)


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
    input_details, outputs = interpreter.get_input_details()[0], interpreter.get_output_details()

    def run(image: np.ndarray) -> list[np.ndarray]:
        interpreter.set_tensor(input_details["index"], _quantised(image, input_details))
        interpreter.invoke()
        return [_real(interpreter.get_tensor(output["index"]), output) for output in outputs]

    file = NetworkFile(
        path=path,
        digest=sha256_arrays(np.frombuffer(data, np.uint8)),
        channels_last=channels_last,
        size=size,
        output_names=tuple(str(output["name"]) for output in outputs),
        said=(Description(names=_labels(data), pixels=_pixels(input_details)), read_description(path)),
    )
    return load_black_box(request, file, run, "ai-edge-litert")


def _quantised(image: np.ndarray, input_details: Mapping) -> np.ndarray:
    """Convert real numbers to the input's type, by its scale and zero point."""
    if np.issubdtype(input_details["dtype"], np.floating):
        return image.astype(input_details["dtype"])
    scale, zero = input_details["quantization"]
    bounds = np.iinfo(input_details["dtype"])
    return np.clip(np.rint(image / (scale or 1.0) + zero), bounds.min, bounds.max).astype(input_details["dtype"])


def _real(values: np.ndarray, output: Mapping) -> np.ndarray:
    scale, zero = output["quantization"]
    if np.issubdtype(values.dtype, np.floating) or not scale:
        return np.array(values, np.float32)
    return ((values.astype(np.float32) - zero) * scale).astype(np.float32)


def _pixels(input_details: Mapping) -> PixelFormat | None:
    """Find the pixel format that an input of integers stands for; None where it is no usual range."""
    if np.issubdtype(input_details["dtype"], np.floating):
        return None
    scale, zero = input_details["quantization"]
    bounds = np.iinfo(input_details["dtype"])
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
