"""Weights of torch modules: state dicts from files that others made, and batch norm folded into convolutions.

No code of a file is ever run, and what does not fit is said in one line.
"""

import itertools
import pickle
from pathlib import Path

import torch
from torch import Tensor, nn

from cloak_core.files.errors import InputError, first_line
from cloak_core.files.reading import open_regular

WRAPPERS = ("model", "state_dict", "model_state_dict")
"""Keys under which training scripts keep the weights among other things."""


def read_state_dict(path: Path) -> dict[str, Tensor]:
    """Read the tensors of a .pth or .safetensors file; nothing is unpickled but plain data.

    InputError when the file is missing, broken, holds pickled objects, or tensors that are not finite.
    """
    try:
        with open_regular(path) as file:
            if path.suffix == ".safetensors":
                from safetensors.torch import load

                state = load(file.read())
            else:
                state = torch.load(file, map_location="cpu", weights_only=True)
    except InputError:
        raise
    except pickle.UnpicklingError as error:
        raise InputError(f"{path}: refused, it holds pickled objects and not only a plain state dict") from error
    except Exception as error:  # torch and safetensors raise many kinds for broken files
        raise InputError(f"{path}: cannot be read as a checkpoint ({first_line(error)[:200]})") from error
    for key in WRAPPERS:
        if isinstance(state, dict) and isinstance(state.get(key), dict):
            state = state[key]
    if not isinstance(state, dict) or not state or not all(isinstance(value, Tensor) for value in state.values()):
        raise InputError(f"{path}: not a plain state dict (a dict of names and tensors)")
    for name, value in state.items():
        if value.is_floating_point() and not bool(value.isfinite().all()):
            raise InputError(f"{path}: {name} holds numbers that are not finite")
    return dict(state)


def load_state(module: nn.Module, state: dict[str, Tensor], path: Path) -> None:
    """Load a state dict strictly. InputError: in one line what is missing, left over or of another shape."""
    own = module.state_dict()
    # Batch norm counts its training steps; files of frozen batch norm do not, and inference does not ask.
    missing = [key for key in own if key not in state and not key.endswith("num_batches_tracked")]
    extra = [key for key in state if key not in own and not key.endswith("num_batches_tracked")]
    shapes = [key for key in own if key in state and own[key].shape != state[key].shape]
    if missing or extra or shapes:
        kinds = (("missing", missing), ("unknown", extra), ("of another shape", shapes))
        parts = [f"{len(keys)} tensors {kind} ({keys[0]} ...)" for kind, keys in kinds if keys]
        raise InputError(f"{path}: does not fit the model: {', '.join(parts)}")
    module.load_state_dict(state, strict=False)


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
