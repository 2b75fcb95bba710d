"""Loops for the CPU, compiled by numba on their first call and kept on disk.

torch pays for every operation and every intermediate array; a triangle of a body covers a handful of samples, so on the
CPU that is most of a view's time. The loops do the same arithmetic in the same order (no fused or reordered operations)
and give the same result as the torch operations in torch/, which other devices use.

So a render's stages are functions of equal names in two rooms, which `backend` chooses by device: `cpu` (these loops)
and `torch` (any device; two stages start a Triton kernel on CUDA, which CLOAK_TRITON=0 switches off). The latter
documents them. Both give the same face ids, bit for bit, and the same weights within 1e-6; tests compare them
(`torch_alone`). In the order of a render: `cover`, `merge_samples`, `build_view`, `draw_bodies`, `logo_matrix`. Exact
areas have loops alone.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import inspect
import logging
import os
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

import numba
import numpy as np
import torch
from numba.core import event

from cloak_core.files.errors import InputError

_log = logging.getLogger("cloak")


def loop(function: Callable, **options: object) -> Callable:
    """Compile a function of arrays and numbers; it releases the interpreter, so that threads run side by side."""
    # Under pytest, functions come wrapped in a check of types, which cannot be compiled.
    function = inspect.unwrap(function)
    try:
        kept = numba.njit(function, cache=True, **_OPTIONS, **options)
        # numba compares the function's own file alone, but the machine code also holds what it calls in others.
        kept._cache._cache_file._source_stamp = _source_stamp(Path(inspect.getfile(function)))
        return kept
    except RuntimeError:  # neither the installation nor a cache folder of the user can be written to
        return numba.njit(function, **_OPTIONS, **options)


@cache
def _source_stamp(file: Path) -> tuple[tuple[float, int], ...]:
    """Time and size of a file with loops and of all files whose loops and numbers it may call."""
    room = Path(__file__).parent
    files = [file, *sorted(room.glob("cpu/*.py")), *(room / f"{name}.py" for name in ("compiled", "screen"))]
    return tuple((state.st_mtime, state.st_size) for state in (source.stat() for source in files))


def inner(function: Callable) -> Callable:
    """Compile a function that other loops call often and that allocates nothing.

    Without reference counts, which are two atomic operations for each array and call.
    """
    return loop(function, _nrt=False)


class _Saying(event.Listener):
    """Says that loops are being compiled, before the first of a process: it takes most of a minute, in silence."""

    has_said = False

    def on_start(self, event: event.Event) -> None:
        dispatcher = event.data["dispatcher"]
        if self.has_said or not dispatcher.py_func.__module__.startswith("cloak_core."):
            return
        self.has_said = True
        kept = hasattr(dispatcher.stats, "cache_path") and dispatcher.stats.cache_path
        often = "once after installation" if kept else "at every start: no folder to keep them in can be written to"
        _log.warning("compiling the loops that draw, %s: about a minute, longer on a busy machine", often)

    def on_end(self, event: event.Event) -> None:
        pass


_saying = _Saying()
event.register("numba:compile", _saying)


_OPTIONS = {"nogil": True, "error_model": "numpy"}
_switched_off = False
_kernels = os.environ.get("CLOAK_TRITON")


def use_loops(device: torch.device) -> bool:
    """Tell whether work on this device is done by loops."""
    return device.type == "cpu" and not _switched_off


def backend(device: torch.device) -> ModuleType:
    """Choose the stages for a device: loops on the CPU, torch's operations elsewhere."""
    return importlib.import_module(f"{__package__}.{'cpu' if use_loops(device) else 'torch'}")


def use_kernels(device: torch.device) -> bool:
    """Tell whether Triton kernels do work that loops do not: on CUDA where there is Triton, which comes with torch.

    CLOAK_TRITON=0 switches them off; 1 asks for them anywhere, and raises `InputError` where there is no Triton.
    """
    if _kernels == "0" or use_loops(device) or (_kernels is None and device.type != "cuda"):
        return False
    if _kernels is None:
        return _kernels_start(device)
    if importlib.util.find_spec("triton") is None:
        raise InputError("CLOAK_TRITON=1: no package 'triton' is installed")
    return True


@cache
def _kernels_start(device: torch.device) -> bool:
    """Try one out: Triton needs a C compiler and Python's headers, which a machine that trains may lack."""
    if importlib.util.find_spec("triton") is None:
        return False
    try:
        importlib.import_module(f"{__package__}.fused").try_out(device)
    except Exception as error:  # whatever a compiler that is not there, or too old, makes of it
        words = (str(error).strip().splitlines() or [type(error).__name__])[0]
        _log.warning("Triton's kernels do not start here, torch's operations draw instead: %s", words)
        return False
    return True


@contextlib.contextmanager
def triton_kernels(wanted: bool = True) -> Iterator[None]:
    """Within, in all threads, Triton kernels do what loops do not; or, not `wanted`, torch's operations do."""
    global _kernels
    before = _kernels
    _kernels = "1" if wanted else "0"
    try:
        yield
    finally:
        _kernels = before


@contextlib.contextmanager
def torch_alone() -> Iterator[None]:
    """Within, in all threads, the CPU does what other devices do: torch's operations, no loops."""
    global _switched_off
    before = _switched_off
    _switched_off = True
    try:
        yield
    finally:
        _switched_off = before


def arrays(*tensors: torch.Tensor) -> list[np.ndarray]:
    """View the tensors' own memory as contiguous arrays, as loops want it."""
    return [tensor.detach().contiguous().numpy() for tensor in tensors]
