"""`cloak detectors list`: which families there are, what each needs, and how each was verified."""

from dataclasses import asdict, dataclass

from cloak_core.detectors.extras import install_command, installed


@dataclass(frozen=True)
class Entry:
    """One family, for the table."""

    family: str
    spec: str
    trains: bool
    evaluates: bool
    needs: str | None
    """The package beyond the project's own dependencies, None for none."""
    weights: str
    """Where the weights come from."""
    licence: str
    """Of code and weights, as far as the project can say."""
    verified: str


ENTRIES = (
    Entry(
        "builtin",
        "builtin",
        True,
        True,
        None,
        "embedded",
        "Apache-2.0",
        "clean recall and false alarms on held-out bodies and photographs",
    ),
    Entry(
        "darknet",
        "darknet:CFG:WEIGHTS",
        True,
        True,
        None,
        "your .cfg and .weights (YOLOv2, v3, v4, v7 and tiny ones)",
        "Darknet: public domain; weights: their authors'",
        "outputs of Darknet itself, the original and AlexeyAB's; real weights on photographs",
    ),
    Entry(
        "torchvision",
        "torchvision:NAME[:CHECKPOINT]",
        True,
        True,
        None,
        "your file, or the official checkpoint in the torch cache",
        "BSD-3-Clause; official weights: trained on COCO",
        "detections and input gradients of torchvision's own models, every name",
    ),
    Entry(
        "transformers",
        "transformers:DIRECTORY_OR_CACHED_NAME",
        True,
        True,
        "transformers",
        "your folder, or the local cache",
        "Apache-2.0; weights: see the model card",
        "logits and post-processing of the library, small random models of each family",
    ),
    Entry(
        "onnx",
        "onnx:FILE[:yolov5|yolov8|yolox|detr]",
        False,
        True,
        "onnxruntime",
        "your file",
        "MIT (onnxruntime); weights: their authors'",
        "hand-made models of each output layout",
    ),
    Entry(
        "python",
        "python:FILE.py:FUNCTION",
        True,
        True,
        None,
        "your code",
        "yours",
        "a real Faster R-CNN brought this way",
    ),
)


def list_detectors() -> dict[str, list[dict]]:
    """{"families": [{family, spec, trains, evaluates, installed, install, needs, weights, licence, verified}, ...]}.

    `installed` says whether it works here and now; where not, `install` is the command that changes it, else None.
    """
    families = []
    for entry in ENTRIES:
        there = entry.needs is None or installed(entry.needs)
        install = None if there or entry.needs is None else install_command(entry.needs)
        families.append(asdict(entry) | {"installed": there, "install": install})
    return {"families": families}
