"""Where torch computes, and torch as it is where nobody has changed it, for the length of a call.

So what we compute follows from what is given.
"""

from __future__ import annotations

import contextlib
import copy
import threading
from collections.abc import Iterator

import torch
from torch import nn

from cloak_core.files.errors import InputError, first_line

_lock = threading.Lock()
_calls: list[torch.dtype] = []
"""The caller's default type, once for each call that goes on: torch has one for all threads."""


def usable_device(device: str | torch.device) -> torch.device:
    """Find the torch device of this name. InputError: there is none, or it cannot be used on this machine."""
    try:
        usable = torch.device(device)
        if usable.type == "meta":
            raise RuntimeError("holds no numbers")
        torch.empty(1, device=usable)
    except (RuntimeError, AssertionError, NotImplementedError, ImportError) as error:  # each backend has its own
        raise InputError(f"--device {device}: {first_line(error)}") from None
    return usable


@contextlib.contextmanager
def plain_torch() -> Iterator[None]:
    """Compute in float32 on the CPU unless told otherwise, with gradients and without autocast; then set all back.

    Also a decorator. The default type belongs to the process: other threads see float32 until the last call has ended.
    """
    with contextlib.ExitStack() as stack:
        stack.enter_context(_float32())
        stack.enter_context(torch.inference_mode(False))
        stack.enter_context(torch.enable_grad())
        for device in ("cpu", "cuda"):
            if torch.is_autocast_enabled(device):
                stack.enter_context(torch.autocast(device, enabled=False))
        if torch.get_default_device().type != "cpu":  # torch looks at every call where a device is set
            stack.enter_context(torch.device("cpu"))
        yield


@contextlib.contextmanager
def _float32() -> Iterator[None]:
    with _lock:
        _calls.append(_calls[0] if _calls else torch.get_default_dtype())
        torch.set_default_dtype(torch.float32)
    try:
        yield
    finally:
        with _lock:
            before = _calls.pop()
            if not _calls:
                torch.set_default_dtype(before)


def is_foreign(module: nn.Module) -> bool:
    """Tell whether images in float32 and their gradients do not go through a module: it was made in inference mode, or
    where float64 is the default."""
    of_numbers = any(parameter.dtype == torch.float64 for parameter in module.parameters())
    return of_numbers or any(t.is_inference() for t in (*module.parameters(), *module.buffers()))


def copied(module: nn.Module) -> nn.Module:
    """Copy a module; what was made where float64 is the default is float32 then. InputError: it cannot be copied."""
    try:
        made = copy.deepcopy(module)
    except Exception as error:  # modules fail to be copied in their own ways
        name = type(module).__name__
        raise InputError(
            f"detectors: {name} cannot be copied ({first_line(error)}): wrap it in one that can"
        ) from error
    for tensor in (*made.parameters(), *made.buffers()) if is_foreign(made) else ():
        if tensor.dtype == torch.float64:
            tensor.data = tensor.data.float()
    return made
