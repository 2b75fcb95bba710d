"""The package ultralytics, imported so that it reaches no network and leaves the process as it found it."""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import PIL.Image
import torch

from cloak_core.files.caching import cache_folder

PACKAGE = "ultralytics"
SWITCHES = {"YOLO_OFFLINE": "1", "YOLO_AUTOINSTALL": "0", "YOLO_VERBOSE": "0", "ULTRALYTICS_SAFE_LOAD": "1"}
"""What the package reads from the environment: no look-ups, no installing, no words, no evaluating of strings."""
_kept: list[tempfile.TemporaryDirectory] = []
"""Where nothing is cached: folders that last as long as the process."""


@contextlib.contextmanager
def library() -> Iterator[ModuleType]:
    """Import `ultralytics.nn.tasks`, to build networks with inside this context.

    The switches stay in the environment, and its settings lie in our cache, never among the user's own. What importing
    it changes otherwise is put back: the environment, PIL.Image.open, torch.save, OpenCV's threads, how numpy and
    torch print, warnings. Nothing reaches standard output.
    """
    first = PACKAGE not in sys.modules
    if first:
        folder = cache_folder(PACKAGE)
        if folder is None:
            _kept.append(tempfile.TemporaryDirectory(prefix="cloak-ultralytics-"))
        os.environ.update(SWITCHES, YOLO_CONFIG_DIR=str(folder or _kept[0].name))
    with _unchanged(), contextlib.redirect_stdout(sys.stderr):
        tasks = importlib.import_module(f"{PACKAGE}.nn.tasks")
        importlib.import_module(f"{PACKAGE}.models.utils.ops")  # what RT-DETR imports when it first runs
        log = logging.getLogger(PACKAGE)
        if first:  # its own handler writes to standard output
            log.handlers.clear()
            log.propagate = True
        before = log.level
        log.setLevel(logging.CRITICAL)
        try:
            yield tasks
        finally:
            log.setLevel(logging.ERROR if first else before)


@contextlib.contextmanager
def _unchanged() -> Iterator[None]:
    """Put back what the package patches for the whole process."""
    import cv2

    environment, threads = dict(os.environ), cv2.getNumThreads()
    opens, saves = PIL.Image.open, torch.save
    numpy_prints, torch_prints = np.get_printoptions(), vars(torch._tensor_str.PRINT_OPTS).copy()
    try:
        with warnings.catch_warnings():
            yield
    finally:
        PIL.Image.open, torch.save = opens, saves
        np.set_printoptions(**numpy_prints)
        torch.set_printoptions(**torch_prints)
        cv2.setNumThreads(threads)
        for name in os.environ.keys() - environment.keys():
            del os.environ[name]
        os.environ.update(environment)
