"""What exporters write today as ONNX, of random weights, is trained against, hardened, and written back as it came.

`python -m tests.detectors.test_exports TABLE [FOLDER]` writes records/onnx-exports.csv.
"""

from __future__ import annotations

import contextlib
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, fields
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import pandas as pd
import pytest
import torch
from torch import Tensor, nn
from torchvision.models.detection.image_list import ImageList

from cloak_core.detectors.classes import COCO
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.onnx_family.detector import OnnxDetector
from cloak_core.detectors.onnx_family.model_file import read_model
from cloak_core.detectors.onnx_family.networks import apart
from cloak_core.detectors.verification.comparing import Apart, sample_images
from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_text
from cloak_core.studies.hardening.students import OnnxStudent, open_student

for package in ("onnx", "onnx2torch", "onnxruntime", "onnxscript", "onnxslim", "transformers"):
    pytest.importorskip(package, reason="pip install 'cloak-core[test]'")

SIDE = 160
Export = Callable[[Path], None]


def by_ultralytics(name: str, path: Path, **options: object) -> None:
    """Write what `yolo export model=NAME.pt format=onnx OPTIONS` does."""
    with _network(name) as model, contextlib.chdir(path.parent):
        written = model.export(format="onnx", **({"imgsz": SIDE} | options))
        Path(written).rename(path)


@contextlib.contextmanager
def _network(name: str) -> Iterator[object]:
    """Make one of the package's networks, whose scores depend on the image, in both heads where it has two."""
    from cloak_core.detectors.ultralytics_family.architecture import library, settle_batch_norm

    with library(), warnings.catch_warnings(), torch.random.fork_rng():
        from ultralytics import RTDETR, YOLO

        warnings.simplefilter("ignore")
        torch.manual_seed(0)
        model = (RTDETR if name.startswith("rtdetr") else YOLO)(f"{name}.yaml")
        head = model.model.model[-1]
        for end_to_end in (False, head.end2end) if hasattr(head, "end2end") else (None,):
            if end_to_end is not None:
                head.end2end = end_to_end
            settle_batch_norm(model.model.eval())
        model.model.names = dict(enumerate(COCO))
        yield model


def yolo(name: str) -> nn.Module:
    """Make one of ultralytics' networks that answers as in its own exports."""
    with _network(name) as model:
        head = model.model.model[-1]
        head.export, head.format, head.dynamic, head.end2end = True, "onnx", False, False
        return model.model


class Dense(nn.Module):
    """A torchvision detector without its suppression: boxes and scores of all anchors."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self.model, self.softmax = _torchvision(name), name.startswith("ssd")

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        levels = list(self.model.backbone(images).values())
        found, sizes = self.model.head(levels), [tuple(images.shape[2:])] * len(images)
        anchors = self.model.anchor_generator(ImageList(images, sizes), levels)[0]
        coder = self.model.box_coder
        decode = coder.decode if "bbox_ctrness" in found else coder.decode_single
        boxes = torch.stack([decode(deltas, anchors) for deltas in found["bbox_regression"]])
        scores = found["cls_logits"].softmax(-1) if self.softmax else found["cls_logits"].sigmoid()
        return boxes, scores * found["bbox_ctrness"].sigmoid() if "bbox_ctrness" in found else scores


class Whole(nn.Module):
    """A torchvision detector with its suppression."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self.model = _torchvision(name)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        found = self.model(list(images))[0]
        return found["boxes"], found["labels"], found["scores"]


def _torchvision(name: str) -> nn.Module:
    from torchvision.models import get_model

    from cloak_core.detectors.ultralytics_family.architecture import settle_batch_norm

    with torch.random.fork_rng():
        torch.manual_seed(0)
        sizes = {"min_size": SIDE, "max_size": SIDE} if not name.startswith("ssd") else {}
        model = get_model(name, weights=None, weights_backbone=None, num_classes=91, **sizes).eval()
        settle_batch_norm(model.backbone)  # else scores hardly depend on the image
        return model


class Queries(nn.Module):
    """A transformer of the library transformers: logits and boxes."""

    def __init__(self, name: str) -> None:
        super().__init__()
        import transformers

        from tests.detectors.test_transformers import config

        with torch.random.fork_rng():
            torch.manual_seed(3)
            made = config(name)
            if name == "Yolos":
                made.image_size = [SIDE, SIDE]
            self.model = getattr(transformers, f"{name}ForObjectDetection")(made).eval()
            for weights in (p for p in self.model.parameters() if p.dim() > 1):
                weights.data.mul_(3 if name == "Yolos" else 1.5)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        found = self.model(pixel_values=images)
        return found.logits, found.pred_boxes


def by_torch(make: Callable[[], nn.Module], path: Path, **options: object) -> None:
    """Write what torch.onnx.export does."""
    model = make().eval()
    with warnings.catch_warnings(), contextlib.redirect_stdout(None):
        warnings.simplefilter("ignore")
        torch.onnx.export(model, (torch.rand(1, 3, SIDE, SIDE),), str(path), input_names=["images"], **options)


def _exports() -> dict[tuple[str, str], Export]:
    rows: dict[tuple[str, str], Export] = {}
    for name in ("yolov5nu", "yolov8n", "yolov10n", "yolo11n", "yolo12n", "yolo26n"):
        for words, options in OPTIONS.items():
            rows[name, f"ultralytics, {words}"] = partial(by_ultralytics, name, **options)
    for name in ("yolov10n", "yolo26n"):
        rows[name, "ultralytics, end to end"] = partial(by_ultralytics, name, end2end=True)
    for words in ("default", "opset 22", "half"):
        rows["rtdetr-l", f"ultralytics, {words}"] = partial(by_ultralytics, "rtdetr-l", **OPTIONS[words])
    rows["yolov8n", "ultralytics, not simplified"] = partial(by_ultralytics, "yolov8n", simplify=False)
    for name, make in NETWORKS.items():
        for words, options in {"default": {}, "legacy": {"dynamo": False}}.items():
            rows[name, f"torch, {words}"] = partial(by_torch, make, **options)
    rows["yolov8n", "torch, opset 23"] = partial(by_torch, NETWORKS["yolov8n"], opset_version=23)
    return rows


OPTIONS = {"default": {}} | {f"opset {n}": {"opset": n} for n in (11, 17, 20, 22)}
OPTIONS |= {"dynamic": {"dynamic": True}, "half": {"half": True}, "nms": {"nms": True}}
DENSE = ("ssdlite320_mobilenet_v3_large", "retinanet_resnet50_fpn", "fcos_resnet50_fpn")
LAYOUTS = {"Detr": ":detr", "Yolos": ":detr", "RTDetrV2": ":rtdetr", "DFine": ":rtdetr"}
"""Of random weights, whose outputs do not tell."""
NETWORKS = {"yolov8n": partial(yolo, "yolov8n")} | {name: partial(Queries, name) for name in LAYOUTS}
NETWORKS |= {f"{name} without suppression": partial(Dense, name) for name in DENSE}
NETWORKS |= {name: partial(Whole, name) for name in (DENSE[0], "fasterrcnn_mobilenet_v3_large_320_fpn")}
EXPORTS = _exports()
"""What writes each row of the table, by (network, exporter)."""


@dataclass(frozen=True)
class Row:
    """What became of a file."""

    opset: int
    white_box: bool
    hardened: bool
    """Its weights, moved, went back into the file, and onnxruntime answers as the trained network does."""
    scores: float | None
    """Largest difference between torch and onnxruntime; None for a black box."""
    boxes_px: float | None
    why: str
    """It is a black box, or cannot be hardened."""


def judge(path: Path, layout: str = "") -> Row | None:
    """Load a file, move its weights, write them back and run that; None for one that onnxruntime does not run."""
    import onnx
    import onnxruntime

    opset = next(entry.version for entry in onnx.load(str(path)).opset_import if not entry.domain)
    try:
        onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    except Exception:  # of many classes
        return None
    spec = f"onnx:{path}{layout}@person=0"
    try:
        student = open_student(spec)
    except InputError as refused:
        try:
            detector = load_detector(spec)
        except InputError as error:
            return Row(opset, False, False, None, None, str(error))
        return Row(opset, detector.differentiable, False, None, None, detector.black_box or str(refused))
    parity = _apart(student.teacher, student.teacher.original())
    return Row(opset, True, _hardens(student, path), parity.scores, parity.boxes_px, "")


def _hardens(student: OnnxStudent, path: Path) -> bool:
    """Tell whether moved weights run in the written file, whose signature and opset are those of the old one."""
    import onnx

    generator = torch.Generator().manual_seed(0)
    with torch.no_grad(), tempfile.TemporaryDirectory() as folder:
        for weights in student.detector.weights.parameters.values():
            weights += 1e-3 * weights.std(correction=0) * torch.randn(weights.shape, generator=generator)
            weights.copy_(weights.half())  # what files in half precision hold
        student.write(student.network.state_dict(), Path(folder), 0)
        old, new = (onnx.load(str(file)) for file in (path, Path(folder) / "hardened.onnx"))
        same = all(
            list(getattr(old.graph, part)) == list(getattr(new.graph, part)) for part in ("input", "output")
        ) and list(old.opset_import) == list(new.opset_import)
        student.detector.path = Path(folder) / "hardened.onnx"
        student.detector.source["file"] = read_model(student.detector.path).digest
        after = student.detector.original()
        return same and _apart(student.detector, after).same and not torch.equal(*_scores(student.teacher, after))


def _scores(*detectors: OnnxDetector) -> list[Tensor]:
    with torch.no_grad():
        images = sample_images(detectors[0].input_size)[:1]
        return [detector.answer(detector.pixels.apply(images)).scores for detector in detectors]


def _apart(one: OnnxDetector, other: OnnxDetector) -> Apart:
    images = one.pixels.apply(sample_images(one.input_size)[:1])
    with torch.no_grad():
        return apart([one.answer(images)], [other.answer(images)])


FEW = [("yolov8n", "ultralytics, default"), ("Yolos", "torch, legacy")]
LEFT_OUT = [row for row in EXPORTS if row[0].endswith(("_large", "_fpn"))]
"""They choose boxes by rules that have no gradient, in the middle of their graphs."""
LEFT_OUT += [(name, "torch, default") for name in ("RTDetrV2", "DFine")]
"""torch 2.14 does not export them."""
LEFT_OUT.append(("rtdetr-l", "ultralytics, half"))
"""Random weights, rounded: its answers in torch are 0.002 off onnxruntime's."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "row",
    [*FEW, *(pytest.param(row, marks=pytest.mark.long) for row in EXPORTS if row not in (*FEW, *LEFT_OUT))],
    ids=" ".join,
)
def test_a_file_of_today_is_a_white_box_and_hardened(row: tuple[str, str], tmp_path: Path) -> None:
    if (
        "yolo" in row[0] and find_spec("ultralytics") is None
    ):  # asked without importing it: what it patches would stay so
        pytest.skip("pip install 'cloak-core[ultralytics]' (AGPL-3.0)")
    path = tmp_path / "net.onnx"
    EXPORTS[row](path=path)
    judged = judge(path, LAYOUTS.get(row[0], ""))
    assert judged is None or (judged.white_box and judged.hardened), judged


def main(table: Path, files: Path) -> None:
    """Write the table; files that are there already are judged as they are."""
    records = []
    for (network, exporter), export in EXPORTS.items():
        path = files / f"{network}__{exporter}.onnx".replace(" ", "_").replace(",", "")
        try:
            if not path.exists():
                export(path=path)
            row = judge(path, LAYOUTS.get(network, ""))
            record = asdict(row) if row else {"why": "onnxruntime does not run it"}
        except Exception as error:  # of many exporters
            record = {"why": f"not exported: {type(error).__name__}"}
        why = (record["why"].partition(".onnx: ")[2] or record["why"]).partition("; say ")[0]
        records.append({"network": network, "exporter": exporter} | record | {"why": why})
        print(*records[-1].values(), flush=True)
    columns = ["network", "exporter", *(field.name for field in fields(Row))]
    frame = pd.DataFrame(records, columns=columns).astype({"opset": "Int64"})
    write_text(table, frame.to_csv(index=False, float_format="%.0e", lineterminator="\n"))
    print(*(f"{name} {version(name)}" for name in PACKAGES), sep=", ")


PACKAGES = ("ultralytics", "torch", "torchvision", "transformers", "onnx", "onnxruntime", "onnx2torch")

if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2] if len(sys.argv) > 2 else tempfile.mkdtemp()))
