"""What all of torchvision's detection models share: their own resizing, the memory layout, and the way back."""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torchvision.models.detection.image_list import ImageList

from cloak_core.core.detector.protocol import Detector
from cloak_core.detectors.pixels import Placement


class TorchvisionDetector(Detector):
    """A torchvision model that scores class `person`; `channels_last` is the layout of its images and weights."""

    first_class = 1
    """Where classes begin that are something; before it stands the background, if any."""

    def __init__(self, model: nn.Module, person: int, name: str, spec: str, channels_last: bool = True) -> None:
        super().__init__(name, spec)
        self.person = person
        self.memory_format = torch.channels_last if channels_last else torch.contiguous_format
        self.model = model.to(memory_format=self.memory_format)

    def prepare(self, images: Float[Tensor, "B 3 H W"]) -> tuple[ImageList, Placement]:
        """Resize and normalise by the model's own transform; say where the images lie in its input."""
        batch, _ = self.model.transform(list(images))
        batch.tensors = batch.tensors.contiguous(memory_format=self.memory_format)
        height, width = batch.image_sizes[0]
        return batch, Placement(scale_x=width / images.shape[3], scale_y=height / images.shape[2])
