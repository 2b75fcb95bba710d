"""Batch norm multiplied into the convolution before it, in torch models of any family."""

import itertools

import torch
from torch import nn


@torch.no_grad()
def fold_batch_norm(module: nn.Module) -> int:
    """Fold, in place, every batch norm that directly follows a convolution among its parent's children.

    For modules whose children stand in the order they run (torchvision's do). Eval-mode outputs stay equal up to
    rounding; the batch norm's place is taken by an identity. Returns how many were folded.
    """
    folded = 0
    for parent in list(module.modules()):
        children = list(parent.named_children())
        for (_, conv), (name, norm) in itertools.pairwise(children):
            # Each model of transformers has a copy of torchvision's frozen one under a name of its own.
            is_norm = isinstance(norm, nn.BatchNorm2d) or type(norm).__name__.endswith("FrozenBatchNorm2d")
            if type(conv) is nn.Conv2d and is_norm:
                _fold(conv, norm)
                setattr(parent, name, nn.Identity())
                folded += 1
    return folded


def _fold(conv: nn.Conv2d, norm: nn.Module) -> None:
    ones = torch.ones_like(norm.running_var, dtype=torch.float64)
    weight = ones if norm.weight is None else norm.weight.double()
    bias = 0 * ones if norm.bias is None else norm.bias.double()
    scale = weight / (norm.running_var.double() + getattr(norm, "eps", 1e-5)).sqrt()
    before = 0 * ones if conv.bias is None else conv.bias.double()
    folded = conv.weight.double() * scale[:, None, None, None]
    conv.weight.copy_(folded)
    shift = (before - norm.running_mean.double()) * scale + bias
    conv.bias = nn.Parameter(shift.to(conv.weight.dtype), requires_grad=conv.weight.requires_grad)
