"""Darknet's .weights: a short header, then float32 numbers in network order."""

import os
import struct
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from cloak_core.detectors.darknet.cfg import parse_cfg
from cloak_core.detectors.darknet.layers import BatchNorm, Convolution
from cloak_core.detectors.darknet.network import Network
from cloak_core.files.errors import InputError
from cloak_core.files.reading import open_regular, read_bytes
from cloak_core.files.writing import write_bytes, write_text

WRITTEN_VERSION = (0, 2, 5)
"""AlexeyAB's Darknet writes this version. Its batch norm divides by sqrt(var + 1e-5); the original's (revision 0) by
sqrt(var) + 1e-6 on the CPU, which is what its golden outputs show."""


def stored_tensors(network: Network) -> list[tuple[int, str, Tensor]]:
    """List (layer index, name, tensor) of all that a .weights file holds, in file order; the network is unfolded."""
    stored: list[tuple[int, str, Tensor]] = []
    for index, (section, layer) in enumerate(zip(network.sections, network.layers, strict=True)):
        if not isinstance(layer, Convolution):
            continue
        if bool(section.integer("batch_normalize", 0)) != (layer.norm is not None):
            raise ValueError("batch norm is folded already: the network no longer matches its cfg")
        stored.append((index, "biases", layer.conv.bias if layer.norm is None else layer.norm.bias))
        if layer.norm is not None:
            stored.append((index, "scales", layer.norm.weight))
            stored.append((index, "rolling means", layer.norm.running_mean))
            stored.append((index, "rolling variances", layer.norm.running_var))
        stored.append((index, "weights", layer.conv.weight))
    return stored


def check_size(network: Network, path: Path) -> tuple[int, int]:
    """Check that a file has as many floats as `network` (a meta one, too) asks for; give header bytes and revision.

    InputError when it is missing or holds others, as in `read_weights`.
    """
    expected = sum(tensor.numel() for _, _, tensor in stored_tensors(network))
    if not path.is_file():
        raise InputError(f"{path}: no such file (expected {expected:,} floats of weights)")
    with open_regular(path) as file:
        header, revision = _header(file.read(12))
        count, odd = divmod(max(file.seek(0, os.SEEK_END) - header, 0), 4)
    if count != expected or odd:
        more = f" and {odd} odd bytes" if odd else ""
        raise InputError(
            f"{path}: expected {expected:,} floats for {network.sections[0].source}, found {count:,}{more} "
            f"({'truncated' if count < expected else 'too long'}, or the weights of another cfg)"
        )
    return header, revision


@torch.no_grad()
def read_weights(network: Network, path: Path) -> Network:
    """Fill an unfolded network from a .weights file, in place.

    InputError when the file is missing, holds fewer or more floats than the cfg asks for (both numbers are given), or
    holds numbers no network can have (not finite, negative variance).
    """
    header, revision = check_size(network, path)
    stored = stored_tensors(network)
    values = torch.from_numpy(np.frombuffer(read_bytes(path), "<f4", offset=header).astype(np.float32))
    offset = 0
    for index, name, tensor in stored:
        part = values[offset : offset + tensor.numel()]
        offset += tensor.numel()
        if not bool(part.isfinite().all()) or (name == "rolling variances" and bool((part < 0).any())):
            raise InputError(
                f"{path}: {name} of layer {index} ([{network.sections[index].kind}], cfg line "
                f"{network.sections[index].line}) hold NaN, infinite or negative numbers where none can be"
            )
        tensor.copy_(part.reshape(tensor.shape))
    for module in network.modules():
        if isinstance(module, BatchNorm):
            module.epsilon_outside = revision != WRITTEN_VERSION[2]
    return network


def write_darknet(cfg_text: str, network: Network, stem: Path, seen: int = 0) -> tuple[Path, Path]:
    """Store an unfolded, trained network as STEM.cfg and STEM.weights; returns both paths.

    `cfg_text` is the text the network was built from; a network of other shapes is refused (ValueError), as are
    numbers that are not finite. `seen` is the number of training images, kept in the header.
    """
    cfg, weights = Path(f"{stem}.cfg"), Path(f"{stem}.weights")
    stored = stored_tensors(network)
    twin = stored_tensors(Network(parse_cfg(cfg_text, str(cfg))))
    if [(i, n, t.shape) for i, n, t in stored] != [(i, n, t.shape) for i, n, t in twin]:
        raise ValueError("the network was not built from this cfg text")
    values = torch.cat([tensor.detach().float().cpu().reshape(-1) for _, _, tensor in stored])
    if not bool(values.isfinite().all()):
        raise ValueError("the network holds numbers that are not finite")
    header = struct.pack("<iiiq", *WRITTEN_VERSION, seen)
    write_bytes(weights, header + values.numpy().astype("<f4").tobytes())
    write_text(cfg, cfg_text)
    return cfg, weights


def _header(head: bytes) -> tuple[int, int]:
    """Read bytes of the header, and the revision, from a file's first 12.

    The header is major, minor, revision as int32; then `seen`, an int64 from version 0.2 on and an int32 before.
    """
    if len(head) < 12:
        return len(head), 0
    major, minor, revision = struct.unpack("<iii", head)
    return 12 + (8 if major * 10 + minor >= 2 and major < 1000 and minor < 1000 else 4), revision
