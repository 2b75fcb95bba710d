"""Packages only some detector families need."""

import importlib.util

from cloak_core.files.errors import InputError

EXTRAS = {
    "transformers": "transformers",
    "onnxruntime": "onnx",
    "onnx": "onnx",
    "onnx2torch": "onnx",
    "ultralytics": "ultralytics",
    "openvino": "openvino",
    "ai_edge_litert": "tflite",
}
"""Package -> the extra of this project that installs it."""
COPYLEFT = {"ultralytics": "AGPL-3.0"}
"""Package -> its licence, where that asks something of those who use it."""


def installed(package: str) -> bool:
    """Tell whether a package can be imported, without importing it."""
    return importlib.util.find_spec(package) is not None


def install_command(package: str) -> str:
    """Give the command that installs it."""
    return f"pip install 'cloak-core[{EXTRAS[package]}]'"


def require(package: str, spec: str) -> None:
    """Require a package that `spec` needs. InputError: it is missing, with the pip command."""
    if not installed(package):
        licence = f" ({COPYLEFT[package]})" if package in COPYLEFT else ""
        raise InputError(f"detector {spec!r} needs the package {package}{licence}: {install_command(package)}")
