"""OpenVINO's IR, FILE.xml with FILE.bin beside it, read and run by the package openvino on the CPU."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
import torch

from cloak_core.detectors.classes import confidence_of, read_description
from cloak_core.detectors.onnx_family.decoders import SsdHead
from cloak_core.detectors.onnx_family.detector import OnnxDetector, file_and_layout, load_black_box
from cloak_core.detectors.onnx_family.layouts import OPEN_MODEL_ZOO, Layout
from cloak_core.detectors.onnx_family.model_file import NetworkFile, image_input
from cloak_core.detectors.specs import Request
from cloak_core.files.errors import InputError, first_line
from cloak_core.files.identity import sha256_arrays
from cloak_core.files.reading import read_bytes

if TYPE_CHECKING:
    import openvino

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
        names=tuple(_said(network, "labels").split()) or None,
        confidence=confidence_of({"confidence": _said(network, "confidence_threshold")}),
        layout=None if head is None else ("ssd-head", Layout(head, 0.5, pixels=OPEN_MODEL_ZOO)),
        described=read_description(path),
    )
    return load_black_box(request, file, run, "openvino")


def _before_suppression(network: openvino.Model) -> tuple[openvino.Model, SsdHead | None]:
    """Cut the network before its DetectionOutput layer and read what that does; leave it where none is plain."""
    import openvino
    import openvino.opset13

    layers = [op for op in network.get_ordered_ops() if op.get_type_name() == "DetectionOutput"]
    if len(layers) != 1 or len(layers[0].inputs()) != 3:
        return network, None
    said = layers[0].get_attributes()
    if not said["share_location"] or not said["normalized"] or said["decrease_label_id"]:
        return network, None
    offsets, scores = (port.get_shape()[-1] for port in layers[0].inputs()[:2])
    head = SsdHead(
        scores * 4 // offsets,
        int(said["background_label_id"]),
        said["code_type"].endswith("CENTER_SIZE"),
        not said["variance_encoded_in_target"],
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
