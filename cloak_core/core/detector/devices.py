"""Where torch computes."""

from __future__ import annotations

import torch

from cloak_core.files.errors import InputError, first_line


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
