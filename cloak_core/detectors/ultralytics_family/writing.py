"""A network that learned, as a .pt file that both Cloak and the package it is from read."""

from __future__ import annotations

import copy
from pathlib import Path

import torch
from torch import Tensor, nn

from cloak_core.detectors.ultralytics_family.checkpoint import replace_weights
from cloak_core.detectors.ultralytics_family.heads import DenseHead
from cloak_core.detectors.ultralytics_family.library import library
from cloak_core.files.writing import replace_file


def write_ultralytics(path: Path, network: nn.Module, source: Path) -> None:
    """Write a network that was loaded, unfolded, from `source`.

    From a .pt: that file with the network's parameters in the place of its own (in the precision that it keeps them
    in, mostly half), so that whatever else it says stays. From a .yaml: a whole model of the package, in float32.
    """
    if source.suffix.lower() == ".pt":
        replace_weights(source, path, _as_the_package_has_it(network))
        return
    with library():
        model = copy.deepcopy(network)
        model.model[-1] = model.model[-1].replaced[0]
        content = {"model": model.cpu().requires_grad_(False), "ema": None}
        replace_file(path, lambda file: torch.save(content, file))


def _as_the_package_has_it(network: nn.Module) -> dict[str, Tensor]:
    """List the parameters by the names that they have in files."""
    own, last = network.model[-1], f"model.{len(network.model) - 1}."
    if not isinstance(own, DenseHead):
        return dict(network.named_parameters())
    body = {name: value for name, value in network.named_parameters() if not name.startswith(last)}
    return body | {f"{last}{name}": value for name, value in own.replaced[0].named_parameters()}
