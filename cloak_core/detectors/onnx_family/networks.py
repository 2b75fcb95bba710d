"""The two ways to run an ONNX file: as a torch module, or by onnxruntime."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.detectors.onnx_family.model_file import ModelFile

if TYPE_CHECKING:
    import onnxruntime


def as_input(images: Float[Tensor, "B 3 H W"], network: ModelFile | nn.Module) -> Tensor:
    """Order the axes as the network has them: exports of TensorFlow want channels last."""
    return images.permute(0, 2, 3, 1) if network.channels_last else images


class BlackBox(nn.Module):
    """A network that another runtime runs, as a module, on the CPU, without gradients."""

    def __init__(
        self, run: Callable[[np.ndarray], list[np.ndarray]], digest: str, channels_last: bool, one_by_one: bool
    ) -> None:
        """run: images to outputs; digest: SHA-256 of the network's file; one_by_one: it takes one image at a time."""
        super().__init__()
        self.run, self.channels_last, self.one_by_one = run, channels_last, one_by_one
        # The runtime's weights are no tensors of ours; this stands for them in `state_hash`.
        self.register_buffer("digest", torch.frombuffer(bytearray.fromhex(digest), dtype=torch.uint8))

    @torch.no_grad()
    def forward(self, inputs: Float[Tensor, "B 3 H W"]) -> list[Tensor]:
        array = as_input(inputs, self)
        array = np.ascontiguousarray(array.cpu().numpy())
        chunks = np.split(array, len(array)) if self.one_by_one else [array]
        runs = [self.run(chunk) for chunk in chunks]
        joined = (np.concatenate(parts) for parts in zip(*runs, strict=True))
        return [torch.from_numpy(part).float().to(inputs.device) for part in joined]


class Session(BlackBox):
    """An onnxruntime session; image by image where the batch is fixed."""

    def __init__(self, session: onnxruntime.InferenceSession, file: ModelFile) -> None:
        super().__init__(
            lambda array: session.run(None, {file.input_name: array}),
            file.digest,
            file.channels_last,
            one_by_one=file.batch is not None,
        )


class Converted(nn.Module):
    """A converted graph with its outputs as a list; one image at a time where batches go wrong in it."""

    def __init__(self, graph: nn.Module, file: ModelFile, one_by_one: bool = False) -> None:
        super().__init__()
        self.graph, self.channels_last, self.one_by_one = graph, file.channels_last, one_by_one

    def forward(self, inputs: Float[Tensor, "B 3 H W"]) -> list[Tensor]:
        array = as_input(inputs, self)
        if not self.one_by_one:
            return self._listed(self.graph(array))
        runs = [self._listed(self.graph(image)) for image in array.split(1)]
        return [torch.cat(parts) for parts in zip(*runs, strict=True)]

    @staticmethod
    def _listed(outputs: Tensor | tuple | list) -> list[Tensor]:
        return [outputs] if isinstance(outputs, Tensor) else list(outputs)
