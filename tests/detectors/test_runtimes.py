"""Files of OpenVINO and TFLite: what their outputs mean, and networks made here run as black boxes."""

import io
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.detectors import runtimes
from cloak_core.detectors.decoding import Decoded
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.onnx_family.decoders import (
    SsdHead,
    boxes_labels,
    detection_rows,
    mediapipe_pose,
    tflite_ssd,
)
from cloak_core.detectors.onnx_family.layouts import OPEN_MODEL_ZOO, SYMMETRIC, guess_layout
from cloak_core.detectors.pixels import PixelFormat
from cloak_core.detectors.runtimes import without_telemetry
from cloak_core.detectors.verification import verify
from cloak_core.files.errors import InputError
from tests.detectors.helpers import images

SIZE = (100, 200)


def guess(*shapes: tuple[int, ...]) -> str | None:
    return guess_layout([torch.zeros(shape) for shape in shapes], SIZE, 0)


def of_class(found: Decoded, number: int) -> list[float]:
    return found.classes[0, :, number].tolist()


def test_ssd_boxes_as_the_paper_decodes_them() -> None:
    priors = torch.tensor([[[0.2, 0.2, 0.4, 0.6], [0.1, 0.1, 0.2, 0.2]]]).view(1, 1, 8)
    variances = torch.tensor([0.1, 0.1, 0.2, 0.2]).repeat(2).view(1, 1, 8)
    offsets = torch.tensor([[1.0, 0.0, 0.0, 5 * float(np.log(2.0)), 0, 0, 0, 0]])
    scores = torch.tensor([[0.1, 0.7, 0.2, 0.8, 0.1, 0.1]])
    outputs = [offsets, scores, torch.cat([priors, variances], dim=1)]
    found = SsdHead(3, 0, center_size=True, scaled=True)(outputs, SIZE)
    # Centre (0.3 + 0.1 * 0.2, 0.4), size (0.2, 0.8); then the prior itself.
    torch.testing.assert_close(found.boxes[0], torch.tensor([[44.0, 0, 84, 80], [20, 10, 40, 20]]))
    assert found.classes[0].tolist() == [pytest.approx([0.7, 0.2]), pytest.approx([0.1, 0.1])]
    assert SsdHead(3, -1, True, True)(outputs, SIZE).classes.shape[-1] == 3
    corner = SsdHead(3, 2, center_size=False, scaled=False)([torch.zeros(1, 8), *outputs[1:]], SIZE)
    torch.testing.assert_close(corner.boxes[0, 0], torch.tensor([40.0, 20, 80, 60]))
    assert corner.classes[0, 0].tolist() == pytest.approx([0.1, 0.7])


def test_rows_after_suppression_end_where_they_say() -> None:
    rows = torch.tensor(
        [[0, 1, 0.9, 0.1, 0.2, 0.5, 0.6], [0, 3, 0.8, 0, 0, 1, 1], [-1, 0, 0, 0, 0, 0, 0], [0, 1, 0.7, 0, 0, 1, 1]]
    )
    found = detection_rows([rows.view(1, 1, 4, 7)], SIZE)
    assert of_class(found, 0) == pytest.approx([0.9, 0, 0, 0]) and of_class(found, 2) == pytest.approx([0, 0.8, 0, 0])
    assert found.boxes[0, 0].tolist() == pytest.approx([20, 20, 100, 60])
    assert guess((1, 1, 200, 7)) == "detection-rows"


def test_boxes_and_labels_in_either_order() -> None:
    boxes, labels = torch.tensor([[1.0, 2, 3, 4, 0.9], [5, 6, 7, 8, 0.4]]), torch.tensor([0.0, 2.0])
    for outputs in ([boxes, labels], [labels, boxes]):
        found = boxes_labels(outputs, SIZE)
        assert of_class(found, 0) == pytest.approx([0.9, 0]) and of_class(found, 2) == pytest.approx([0, 0.4])
        assert found.boxes[0, 1].tolist() == [5, 6, 7, 8]
        assert guess(*(tuple(o.shape) for o in outputs)) == "boxes-labels"


def test_tflites_own_post_processing() -> None:
    outputs = [
        torch.tensor([[[0.1, 0.2, 0.5, 0.6], [0, 0, 1, 1]]]),
        torch.tensor([[0.0, 17]]),
        torch.tensor([[0.8, 0.7]]),
    ]
    assert of_class(tflite_ssd([*outputs, torch.tensor([1.0])], SIZE), 17) == [0, 0]
    found = tflite_ssd([*outputs, torch.tensor([2.0])], SIZE)
    assert found.boxes[0, 0].tolist() == pytest.approx([40, 10, 120, 50])
    assert of_class(found, 0) == pytest.approx([0.8, 0]) and of_class(found, 17) == pytest.approx([0, 0.7])
    assert guess((1, 2, 4), (1, 2), (1, 2), (1,)) == "tflite-ssd"


def test_mediapipes_person_is_made_of_two_key_points() -> None:
    raw, logits = torch.zeros(1, 2254, 12), torch.full((1, 2254, 1), -200.0)
    row = 2 * (28 * 3 + 5) + 1  # second anchor of a cell at stride 8: centre (44, 28)
    raw[0, row, 4:6], raw[0, row, 6:8], logits[0, row] = torch.tensor([6.0, 2]), torch.tensor([6.0, 32]), 3.0
    found = mediapipe_pose([raw, logits], (224, 224))
    assert found.boxes[0, row].tolist() == pytest.approx([50 - 12, 30 - 30, 50 + 12, 30 + 30])
    assert found.classes[0, row, 0].item() == pytest.approx(0.9526, abs=1e-4) and 0 <= found.classes.min() < 1e-30
    assert found.boxes.isfinite().all() and guess((1, 2254, 12), (1, 2254, 1)) == "mediapipe-pose"


def ir(folder: Path, suppressed: bool = False, batch: int = 1) -> Path:
    """A small network: one convolution to an 8 x 12 grid, as YOLOv8 lays it out or into SSD's DetectionOutput."""
    if find_spec("openvino") is None:
        pytest.skip("pip install 'cloak-core[openvino]'")
    with without_telemetry():
        import openvino
        from openvino import opset8 as op

    random = np.random.default_rng(1)
    picture = op.parameter([batch, 3, 64, 96], np.float32, name="data")
    kernel = random.normal(0, 0.1, (7, 3, 8, 8)).astype(np.float32)
    grid = op.convolution(picture, op.constant(kernel), [8, 8], [0, 0], [0, 0], [1, 1])
    rows = op.reshape(grid, op.constant(np.array([batch, 7, -1])), False)
    if suppressed:
        flat = op.transpose(rows, op.constant(np.array([0, 2, 1])))
        offsets, logits = (
            op.slice(flat, *(op.constant(np.array([k])) for k in cut)) for cut in ((0, 4, 1, 2), (4, 7, 1, 2))
        )
        scores = op.softmax(logits, 2)
        y, x = np.mgrid[0:8, 0:12]
        corner = np.stack([x / 12, y / 8], -1).reshape(-1, 2)
        priors = np.concatenate([corner, corner + np.array([1 / 12, 1 / 8])], 1).ravel()
        both = np.stack([priors, np.tile([0.1, 0.1, 0.2, 0.2], 96)])[None].astype(np.float32)
        attributes = {
            "background_label_id": 0, "top_k": 400, "keep_top_k": [200], "nms_threshold": 0.45, "normalized": True,
            "confidence_threshold": 0.01, "code_type": "caffe.PriorBoxParameter.CENTER_SIZE", "share_location": True,
        }  # fmt: skip
        flatten = lambda value: op.reshape(value, op.constant(np.array([batch, -1])), False)
        out = op.detection_output(flatten(offsets), flatten(scores), op.constant(both), attributes | {"num_classes": 3})
    else:
        parts = [op.slice(rows, *(op.constant(np.array([k])) for k in cut)) for cut in ((0, 4, 1, 1), (4, 7, 1, 1))]
        out = op.concat([op.add(parts[0], op.constant(np.float32(30))), op.sigmoid(parts[1])], 1)
    path = folder / "net.xml"
    openvino.serialize(openvino.Model([out], [picture], "net"), str(path), str(path.with_suffix(".bin")))
    return path


def test_an_openvino_file_is_a_black_box(tmp_path: Path) -> None:
    before = {*sys.modules}
    path = ir(tmp_path)
    path.with_suffix(".json").write_text('{"classes": ["cat", "person", "dog"]}')
    detector = load_detector(f"openvino:{path}@rgb,range=1")
    assert not detector.differentiable and detector.person == 1 and detector.source["layout"] == "yolov8"
    assert detector.input_size == (64, 96) and detector.class_names == ("cat", "person", "dog")
    found = detector(images(3, 90, 60))
    assert found.scores.shape == (3, 96) and found.other is not None
    assert not torch.equal(found.scores[0], found.scores[1])
    report = verify(detector, images(4, 64, 96))
    assert report["failed"] == [] and report["white_box"] is False, report["checks"]
    with pytest.raises(InputError, match="a black box without gradients"):
        detector(images(1).requires_grad_())
    # What other tests of this process imported is not this one's doing.
    assert not [name for name in {*sys.modules} - before if name.startswith("openvino_telemetry")]


def test_ssds_detection_layer_is_left_out(tmp_path: Path) -> None:
    """All boxes, before threshold and suppression; the best of them is the one that the layer reports."""
    path = ir(tmp_path, suppressed=True)
    detector = load_detector(f"openvino:{path}@person=0")
    assert detector.source["layout"] == "ssd-head" and detector.pixels == OPEN_MODEL_ZOO
    picture = images(1, 64, 96)
    found = detector(picture)
    assert found.scores.shape == (1, 96)
    rows = reported(path, detector.pixels.apply(picture).numpy())
    best = max((row for row in rows if row[1] == 1), key=lambda row: row[2])
    assert found.scores.max().item() == pytest.approx(best[2], abs=1e-5)
    box = found.boxes[0, found.scores[0].argmax()] / torch.tensor([96, 64, 96, 64])
    assert box.tolist() == pytest.approx(best[3:].tolist(), abs=1e-4)


def reported(path: Path, picture: np.ndarray) -> np.ndarray:
    """Rows of the file's own output."""
    import openvino

    core = openvino.Core()
    return core.compile_model(core.read_model(path), "CPU", {"INFERENCE_PRECISION_HINT": "f32"})(picture)[0].reshape(
        -1, 7
    )


def test_files_that_openvino_does_not_run(tmp_path: Path) -> None:
    path = ir(tmp_path)
    with pytest.raises(InputError, match=r"net.xml: its input is fixed to 64x96, it cannot run at 32x32"):
        load_detector(f"openvino:{path}@32")
    with pytest.raises(InputError, match=r"net.xml:yolo': unknown layout 'yolo'; known are yolov5"):
        load_detector(f"openvino:{path}:yolo")
    (tmp_path / "broken.xml").write_text("<net>")
    (tmp_path / "broken.bin").write_bytes(b"")
    with pytest.raises(InputError, match=r"broken.xml: not an OpenVINO network"):
        load_detector(f"openvino:{tmp_path / 'broken.xml'}")
    path.with_suffix(".bin").unlink()
    with pytest.raises(InputError, match=r"net.bin: no such file"):
        load_detector(f"openvino:{path}")
    with pytest.raises(InputError, match=r"net.xml: its batch is fixed to 2 images"):
        load_detector(f"openvino:{ir(tmp_path, batch=2)}")


@pytest.mark.parametrize(
    ("dtype", "quantization", "pixels"),
    [
        (np.float32, (0.0, 0), None),
        (np.uint8, (1 / 128, 128), SYMMETRIC),
        (np.uint8, (1 / 255, 0), PixelFormat()),
        (np.int8, (1 / 255, -128), PixelFormat()),
        (np.uint8, (0.0, 0), PixelFormat(range=255.0)),
        (np.int8, (0.5, 3), None),
    ],
)
def test_what_integers_of_an_input_stand_for(dtype, quantization, pixels) -> None:
    details = {"dtype": dtype, "quantization": quantization}
    assert runtimes._pixels(details) == pixels
    if pixels is not None:
        picture = torch.linspace(0, 1, 256).view(1, 1, 256).expand(1, 3, 1, 256)
        integers = runtimes._quantised(pixels.apply(picture).numpy(), details).astype(int)
        bounds = np.iinfo(dtype)
        assert np.abs(integers[0, 0, 0] - np.arange(bounds.min, bounds.max + 1)).max() <= 1


def test_class_names_packed_behind_the_network() -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("labelmap.txt", "person\nbicycle\n\n")
    assert runtimes._labels(b"TFL3 weights" + packed.getvalue()) == ("person", "bicycle")
    assert runtimes._labels(b"TFL3 weights") is None


def test_files_that_are_no_tflite(tmp_path: Path) -> None:
    pytest.importorskip("ai_edge_litert", reason="pip install 'cloak-core[tflite]'")
    (tmp_path / "a.tflite").write_bytes(b"not a network at all")
    with pytest.raises(InputError, match=r"a.tflite: not a TFLite network"):
        load_detector(f"tflite:{tmp_path / 'a.tflite'}")
