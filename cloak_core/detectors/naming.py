"""What people type for a detector: a file alone is taken by its suffix, and a typing error gets a suggestion."""

from __future__ import annotations

import logging
from pathlib import Path

from cloak_core.detectors.defended.table import DEFENCES, list_defences, split_defence
from cloak_core.detectors.families import FAMILIES
from cloak_core.detectors.specs import Request, parse_spec
from cloak_core.files.errors import InputError, suggestion
from cloak_core.files.specs import split_spec

BY_SUFFIX = {
    ".onnx": "onnx",
    ".pt": "ultralytics",
    ".xml": "openvino",
    ".tflite": "tflite",
    ".cfg": "darknet",
    ".weights": "darknet",
}
"""The family that a file's suffix names."""
INCOMPLETE = {".pth": "torchvision:NAME:{}", ".py": "python:{}:FUNCTION", ".yaml": "ultralytics:{}"}
"""Specs of files that do not say all; a description in YAML has no weights, and code is run only by its full name."""
OTHER_FORMATS = dict.fromkeys(
    (".torchscript", ".engine", ".mlpackage", ".mlmodel", ".ncnn", ".pb"),
    "export the network to .onnx, or name its .pt",
) | {".safetensors": "transformers:DIRECTORY reads it with the config.json beside it"}
"""What to do with files of other runtimes."""
_log = logging.getLogger("cloak")
_said: set[str] = set()


def full_spec(spec: str) -> str:
    """Complete what names a detector.

    `yolov8n.onnx@320` is `onnx:yolov8n.onnx@320`, `A.cfg` is `darknet:A.cfg:A.weights`.

    A spec with its family stays as it is. InputError: a file whose suffix does not say all, or whose other half is not
    beside it; nothing that is known, with what may be meant.
    """
    if (defended := split_defence(spec)) is not None:
        return f"{defended[0]}:{full_spec(defended[1])}"
    request = parse_spec(spec)
    if request.family in FAMILIES:
        return spec
    body = f"{request.family}:{request.what}" if request.what else request.family
    parts, options = split_spec(body), spec[len(body) :]
    suffix = Path(parts[0]).suffix.lower()
    if suffix in INCOMPLETE:
        raise InputError(f"detector {spec!r}: names no family; {INCOMPLETE[suffix].format(body)}{options}?")
    family = BY_SUFFIX.get(suffix)
    if family is None:
        raise InputError(_unknown(spec, parts[0], request.family, suffix))
    if (licence := FAMILIES[family].copyleft) and family not in _said and not FAMILIES[family].missing:
        _said.add(family)
        _log.warning("%s: read through the package %s, which is %s", parts[0], family, licence)
    if family == "darknet" and len(parts) == 1:
        parts = _both_halves(Path(parts[0]), spec)
    return f"{family}:{':'.join(parts)}{options}"


def _both_halves(file: Path, spec: str) -> list[str]:
    """Find a .cfg file's weights beside it, or the other way round.

    Of the same name, or of that name with an ending as Darknet writes them (NAME_final, NAME_20000), or the only ones.
    """
    other = ".weights" if file.suffix.lower() == ".cfg" else ".cfg"
    beside = file.with_suffix(other)
    if not beside.is_file():
        there = sorted(file.parent.glob(f"*{other}")) if file.parent.is_dir() else []
        own = file.stem
        there = [p for p in there if p.stem.startswith(f"{own}_") or own.startswith(f"{p.stem}_")] or there
        if len(there) != 1:
            raise InputError(f"detector {spec!r}: no {beside.name} beside it; darknet:CFG:WEIGHTS names both")
        beside = there[0]
    return [str(file), str(beside)] if other == ".weights" else [str(beside), str(file)]


def _unknown(spec: str, file: str, family: str, suffix: str) -> str:
    if suffix and ":" not in spec:
        known = f"no detector's file ends in {suffix} ({', '.join(BY_SUFFIX)}; cloak detectors list)"
        known += f"; {OTHER_FORMATS[suffix]}" if suffix in OTHER_FORMATS else ""
        return f"detector {spec!r}: {known if Path(file).exists() else 'no such file'}"
    forms = " | ".join(known.spec for known in FAMILIES.values())
    known = (*FAMILIES, *DEFENCES)
    meant = suggestion(family, known)
    if meant:
        return f"detector {spec!r}: unknown family {family!r}{meant} (cloak detectors list)"
    before = " | ".join(defence["spec"] for defence in list_defences())
    return (
        f"detector {spec!r}: unknown family {family!r}; expected a file, or {forms}, then @OPTIONS; "
        f"or a defence before one: {before}"
    )


def behind_defences(spec: str) -> Request:
    """Take apart the spec of the detector behind any defences."""
    while (defended := split_defence(spec)) is not None:
        spec = defended[1]
    return parse_spec(spec)


def missing_file(spec: str) -> Path | None:
    """Find the first file of a spec that is not there; None where all are, or it names none."""
    files = (
        part for part in map(Path, behind_defences(spec).parts) if part.suffix.lower() in (*BY_SUFFIX, ".pth", ".py")
    )
    return next((file for file in files if not file.expanduser().exists()), None)


def refuse_typing_errors(spec: str) -> None:
    """Refuse a spec whose file does not exist where one of nearly this name does (InputError).

    Where nothing is near, the family says what it lacks: it knows more.
    """
    file = missing_file(spec)
    if file is None:
        return
    folder = file.expanduser().parent
    meant = suggestion(file.name, [path.name for path in folder.iterdir()] if folder.is_dir() else [])
    if meant:
        raise InputError(f"{file}: no such file{meant}")
