"""From a file of another runtime to a black-box detector."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from cloak_core.detectors.classes import COCO_IDS, names_beside, read_description
from cloak_core.detectors.decoding import Decoded, in_pixels
from cloak_core.detectors.onnx_family.detector import OnnxDetector, chosen_person
from cloak_core.detectors.onnx_family.guessing import guess_layout, is_classifier
from cloak_core.detectors.onnx_family.layouts import Decode, Layout, Size
from cloak_core.detectors.onnx_family.networks import BlackBox
from cloak_core.detectors.runtimes import openvino_file, tflite_file
from cloak_core.detectors.runtimes.layouts import AFTER_SUPPRESSION, RUNTIME_LAYOUTS, runtime_layout
from cloak_core.detectors.runtimes.model import RuntimeModel
from cloak_core.detectors.specs import Request
from cloak_core.detectors.verification.comparing import sample_images
from cloak_core.files.errors import InputError, first_line

FRACTIONS = 2.0
"""Boxes whose coordinates all lie below this are parts of the input's sides, not pixels."""


def load_openvino(request: Request) -> OnnxDetector:
    """Load `openvino:FILE.xml[:LAYOUT]`, an OpenVINO IR, as a black box; see `_load`."""
    return _load(request, openvino_file.PACKAGE, openvino_file.read_openvino)


def load_tflite(request: Request) -> OnnxDetector:
    """Load `tflite:FILE.tflite[:LAYOUT]`, a TensorFlow Lite file, as a black box; see `_load`."""
    return _load(request, tflite_file.PACKAGE, tflite_file.read_tflite)


def _load(request: Request, package: str, read: Callable[[Path, tuple[int, int] | None], RuntimeModel]) -> OnnxDetector:
    """Load a file: layout, pixels, names and confidence as the spec says, else the file, else a JSON file beside it.

    Else as the layout usually has them. InputError names what is missing or ambiguous.
    """
    name, named = (*request.parts, "")[:2]
    path = Path(name).expanduser()
    model, said = read(path, request.input_size), read_description(path)
    network = BlackBox(model.run, model.digest, model.channels_last, one_by_one=True)
    outputs = _first_outputs(model, network)
    layout_name, layout, decode = _layout(model, outputs, request, named or said.layout)
    letterbox = request.letterbox or (layout.letterbox and not request.stretch)
    told = request.pixels or model.pixels or said.pixels
    detector = OnnxDetector(network, decode, model.size, told or layout.pixels, letterbox, request.spec)
    detector.fill, detector.pixels_assumed = layout.fill, told is None
    detector.name, detector.path = path.stem, path
    count = None if layout_name in AFTER_SUPPRESSION else decode(outputs, model.size).classes.shape[-1]
    detector.class_names = _names(model, said.names, count, layout_name)
    detector.person = chosen_person(request, detector.class_names, said.person, count, path)
    confidence = request.confidence or model.confidence or said.confidence
    detector.operating_point = confidence or layout.confidence
    detector.operating_point_assumed = not confidence
    options = {"layout": layout_name, "pixels": repr(detector.pixels), "letterbox": letterbox}
    detector.source = {"file": model.digest, "input_size": list(model.size), "person": detector.person} | options
    detector.packages = (package.replace("_", "-"),)
    return detector.freeze()


@torch.no_grad()
def _first_outputs(model: RuntimeModel, network: BlackBox) -> list[Tensor]:
    """Run the network on one sample image."""
    try:
        return network(sample_images(model.size)[:1])
    except InputError as error:
        raise InputError(f"{model.path}: {error}") from None
    except Exception as error:  # the runtime's own
        raise InputError(f"{model.path}: does not run ({first_line(error)[:160]})") from None


def _layout(
    model: RuntimeModel, outputs: list[Tensor], request: Request, named: str | None
) -> tuple[str, Layout, Decode]:
    """Find the layout, its name, and what decodes such outputs."""
    labelled = dict(zip(model.output_names, outputs, strict=True))
    shapes = ", ".join(f"{label} {list(output.shape)}" for label, output in labelled.items())
    if is_classifier(labelled, ""):
        raise InputError(f"{model.path}: not a detector: one output, {shapes}")
    name, layout = request.layout or named, None
    if not name and model.layout is not None:
        name, layout = model.layout
    name = name or runtime_layout([tuple(output.shape) for output in outputs])
    name = name or guess_layout(labelled, model.size, model.names and len(model.names))
    layout = layout or RUNTIME_LAYOUTS.get(name or "")
    if layout is None:
        known = f"say FILE:LAYOUT ({', '.join(RUNTIME_LAYOUTS)})"
        what = f"unknown layout {name!r}" if name else f"outputs {shapes} are of no known layout"
        raise InputError(f"{model.path}: {what}; {known}")
    try:
        decode = layout.decoder(outputs)
        found = decode(outputs, model.size)
    except (RuntimeError, IndexError, ValueError) as error:  # what tensors of another shape end in
        raise InputError(f"{model.path}: its outputs {shapes} are not laid out as {name}") from error
    if name in ("yolov5", "yolov8") and float(found.boxes.abs().max()) < FRACTIONS:
        return name, layout, _in_fractions(decode)
    return name, layout, decode


def _in_fractions(decode: Decode) -> Decode:
    """Decode exports whose boxes are parts of the input's sides."""

    def scaled(outputs: list[Tensor], size: Size) -> Decoded:
        found = decode(outputs, size)
        return found._replace(boxes=in_pixels(found.boxes, size))

    return scaled


def _names(model: RuntimeModel, said: tuple[str, ...] | None, count: int | None, layout: str) -> tuple[str, ...] | None:
    """Find class names: the file's, its description's, those of a list beside it, COCO's of TFLite's SSD."""
    for names in (model.names, said):
        if names and (count is None or len(names) == count):
            return names
    if count is not None:
        return names_beside(model.path, count)
    return COCO_IDS[1:] if layout == "tflite-ssd" else None
