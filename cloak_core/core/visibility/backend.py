"""The choice of an implementation by device.

A render's stages are functions of equal names in two rooms: `cpu` (numba loops) and `torch` (any device; two stages
start a Triton kernel on CUDA, which CLOAK_TRITON=0 switches off). The latter documents them. Both give the same face
ids, bit for bit, and the same weights within 1e-6; tests compare them (`compiled.torch_alone`). In the order of a
render: `cover`, `merge_samples`, `build_view`, `draw_bodies`, `logo_matrix`. Exact areas have loops alone.
"""

from __future__ import annotations

import importlib
from types import ModuleType

import torch

from cloak_core.core.visibility.compiled import use_loops


def backend(device: torch.device) -> ModuleType:
    """Choose the stages for a device: loops on the CPU, torch's operations elsewhere."""
    return importlib.import_module(f"{__package__}.{'cpu' if use_loops(device) else 'torch'}")
