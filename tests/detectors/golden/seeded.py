"""Seeded weights and image for the cfgs beside this file: inputs of the golden outputs.

The .npz beside each cfg holds what Darknet itself computed from them on the CPU (yolov4-parts: AlexeyAB's, commit
59596d78; yolov2-parts: the original, commit f6afaab), one array per detection layer, as the layer leaves it.
"""

import struct
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from cloak_core.detectors.darknet.network import Network
from cloak_core.detectors.darknet.weights import stored_tensors


def seeded_inputs(network: Network, weights_out: Path, revision: int) -> Tensor:
    """Write a .weights file for a network and return the image [3, H, W] that goes with it."""
    rng = np.random.default_rng(11)
    parts = []
    for _, name, tensor in stored_tensors(network):
        shape = tuple(tensor.shape)
        if name in ("scales", "rolling variances"):
            parts.append(rng.random(shape) + 0.5)
        elif len(shape) == 4:
            parts.append(rng.standard_normal(shape) * (2 / np.prod(shape[1:])) ** 0.5)
        else:
            parts.append(rng.standard_normal(shape) * 0.3)
    values = np.concatenate([part.ravel() for part in parts]).astype("<f4")
    weights_out.write_bytes(struct.pack("<iiiq", 0, 2, revision, 0) + values.tobytes())
    height, width = network.input_size
    return torch.from_numpy(rng.random((3, height, width), dtype=np.float32))
