"""What a command that computes does to its process, before it begins; nothing below the commands does.

Who uses Cloak as a library decides on threads and memory alone.
"""

import ctypes
import sys

from cloak_core.attack.settings import check_settings
from cloak_core.attack.settings.components import ComputeSettings

_MMAP_MAX, _TRIM_THRESHOLD, _ARENA_MAX = -4, -1, -8
"""Options of mallopt(3)."""


def prepare_process(settings: ComputeSettings) -> None:
    """Set torch's threads, and keep freed memory. InputError: no such number, or no such device."""
    check_settings(settings)
    keep_freed_memory()
    if settings.device != "cpu":
        from cloak_core.detectors.loading import usable_device

        usable_device(settings.device)
    if settings.threads is not None:
        import torch

        torch.set_num_threads(settings.threads)


def keep_freed_memory() -> bool:
    """Have this process reuse what it frees; tell whether that could be arranged (glibc on Linux).

    glibc maps large blocks anew and unmaps them when they are freed. A step frees hundreds of megabytes of activations
    and images and takes them again, and the system hands them out page by page, zeroed: up to 30,000 page faults a
    step, a tenth of the time of a small detector. The price: the process stays as large as it ever was.
    """
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:  # another C library (musl)
        return False
    return all([mallopt(_MMAP_MAX, 0), mallopt(_TRIM_THRESHOLD, -1), mallopt(_ARENA_MAX, 1)])
