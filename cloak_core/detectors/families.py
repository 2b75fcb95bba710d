"""The families of detectors: how each is written and loaded, what it needs, and how it was verified.

A new family is a row of `FAMILIES` and a module with its loader, which takes a `Request` and returns a frozen detector.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cloak_core.detectors.defended.table import list_defences
from cloak_core.detectors.specs import PERSON, Request
from cloak_core.files.errors import InputError

if TYPE_CHECKING:
    from cloak_core.core.detector.protocol import Detector

NOT_ONNX = {
    "pixels": "bgr, range, mean and std are for onnx:FILE",
    "stretch": "it stretches unless told letterbox; drop stretch",
}


@dataclass(frozen=True, kw_only=True)
class Family:
    """One kind of detector."""

    spec: str
    """How its specs are written: parts between colons, of which those in brackets may be left out."""
    loader: str
    """MODULE:FUNCTION below cloak_core.detectors, imported when such a detector is asked for."""
    weights: str
    """Where the weights come from."""
    licence: str
    """Of code and weights, as far as the project can say."""
    verified: str
    refuses: Mapping[str, str] = field(default_factory=lambda: NOT_ONNX)
    """Fields of `Request` that mean nothing here, and what is said to whoever sets them."""
    changes_networks: bool = True
    """What it loads is made faster (batch norm folded, memory laid out anew), and can be loaded without that."""
    trains: bool = True
    needs: tuple[str, ...] = ()
    """Packages beyond the project's own dependencies."""
    extra: str = ""
    """The extra of this project that installs them."""
    copyleft: str = ""
    """Their licence, where that asks something of those who use them."""

    @property
    def missing(self) -> str:
        """The first package that is needed and not installed (none is imported); "" for none."""
        return next((package for package in self.needs if importlib.util.find_spec(package) is None), "")

    @property
    def install(self) -> str:
        """The command that installs what it needs."""
        return f"pip install 'cloak-core[{self.extra}]'"

    def check(self, request: Request) -> None:
        """Check a spec before any file is read. InputError: another form, an option that means nothing here."""
        needed, parts = self.spec.partition("[")[0].count(":"), request.parts
        if not needed <= len(parts) <= self.spec.count(":") or not all(parts):
            raise InputError(f"detector {request.spec!r}: expected {self.spec}, @OPTIONS at the end if wanted")
        for name, why in self.refuses.items():
            if getattr(request, name) not in (None, False, PERSON):
                raise InputError(f"detector {request.spec!r}: {why}")

    def load(self, request: Request) -> Detector:
        """Load the detector, frozen, on the CPU. InputError: whatever the loader cannot find, read or understand."""
        if package := self.missing:  # asked before the loader's module, which may import it
            licence = f" ({self.copyleft})" if self.copyleft else ""
            raise InputError(f"detector {request.spec!r} needs the package {package}{licence}: {self.install}")
        module, _, function = self.loader.partition(":")
        return getattr(importlib.import_module(f"cloak_core.detectors.{module}"), function)(request)


FAMILIES = {
    "builtin": Family(
        spec="builtin[:WEIGHTS]",
        loader="darknet.detector:load_darknet",
        weights="embedded, or your .weights of the same network (cloak harden)",
        licence="Apache-2.0",
        verified="clean recall and false alarms on held-out bodies and photographs",
    ),
    "darknet": Family(
        spec="darknet:CFG:WEIGHTS",
        loader="darknet.detector:load_darknet",
        weights="your .cfg and .weights (YOLOv2, v3, v4, v7 and tiny ones)",
        licence="Darknet: public domain; weights: their authors'",
        verified="outputs of Darknet itself, the original and AlexeyAB's; real weights on photographs",
    ),
    "torchvision": Family(
        spec="torchvision:NAME[:CHECKPOINT]",
        loader="torchvision_family:load_torchvision",
        refuses=NOT_ONNX | {"letterbox": "torchvision models resize by themselves; drop letterbox"},
        weights="your file, or the official checkpoint in the torch cache",
        licence="BSD-3-Clause; official weights: trained on COCO",
        verified="detections and input gradients of torchvision's own models, every name",
    ),
    "transformers": Family(
        spec="transformers:DIRECTORY_OR_CACHED_NAME",
        loader="transformers_family:load_transformers",
        refuses=NOT_ONNX | {"letterbox": "the model's own processor resizes; drop letterbox"},
        needs=("transformers",),
        extra="transformers",
        weights="your folder, or the local cache",
        licence="Apache-2.0; weights: see the model card",
        verified="logits and post-processing of the library, small random models of each family",
    ),
    "onnx": Family(
        spec="onnx:FILE[:LAYOUT]",
        loader="onnx_family.detector:load_onnx",
        refuses={},
        changes_networks=False,
        needs=("onnxruntime", "onnx", "onnx2torch"),
        extra="onnx",
        weights="your file",
        licence="MIT (onnxruntime), Apache-2.0 (onnx, onnx2torch); weights: their authors'",
        verified="against onnxruntime at every file's first loading; hand-made models of each output layout",
    ),
    "openvino": Family(
        spec="openvino:FILE.xml[:LAYOUT]",
        loader="runtimes:load_openvino",
        refuses={},
        changes_networks=False,
        trains=False,
        needs=("openvino",),
        extra="openvino",
        weights="your .xml and .bin",
        licence="Apache-2.0 (openvino); weights: their authors'",
        verified="an Open Model Zoo network against its ONNX twin",
    ),
    "tflite": Family(
        spec="tflite:FILE.tflite[:LAYOUT]",
        loader="runtimes:load_tflite",
        refuses={},
        changes_networks=False,
        trains=False,
        needs=("ai_edge_litert",),
        extra="tflite",
        weights="your file",
        licence="Apache-2.0 (LiteRT); weights: their authors'",
        verified="MediaPipe's pose detector against its ONNX twin",
    ),
    "ultralytics": Family(
        spec="ultralytics:FILE",
        loader="ultralytics_family.detector:load_ultralytics",
        refuses={name: why for name, why in NOT_ONNX.items() if name != "stretch"},
        needs=("ultralytics",),
        extra="ultralytics",
        copyleft="AGPL-3.0",
        weights="your .pt (ultralytics' or an original YOLOv5's), or a .yaml with random ones",
        licence="AGPL-3.0 (the package and its official weights; files made from such a model keep that licence)",
        verified="ultralytics' own decoded output, every family; an original YOLOv5 against its ONNX twin",
    ),
    "python": Family(
        spec="python:FILE.py:FUNCTION",
        loader="python_module:load_python",
        refuses=NOT_ONNX
        | {
            "person_class": "a python module returns the person's scores itself, it has no class to choose "
            "(for one of several detectors write the class into its spec: SPEC@person=CLASS)"
        },
        changes_networks=False,
        weights="your code",
        licence="yours",
        verified="a real Faster R-CNN brought this way",
    ),
}


def list_families() -> dict[str, list[dict]]:
    """List the families and the defences, with what each needs and whether it works here.

    {"families": [{family, spec, trains, evaluates, installed, install, needs, weights, licence, verified}, ...],
    "defences": [{defence, spec, what}, ...]}.

    `installed` says whether it works here and now; where not, `install` is the command that changes it, else None.
    """
    rows = [
        {
            "family": name,
            "spec": family.spec,
            "trains": family.trains,
            "evaluates": True,
            "needs": ", ".join(family.needs) or None,
            "weights": family.weights,
            "licence": family.licence,
            "verified": family.verified,
            "installed": not family.missing,
            "install": family.install if family.missing else None,
        }
        for name, family in FAMILIES.items()
    ]
    return {"families": rows, "defences": list_defences()}
