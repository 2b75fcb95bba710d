"""A test objective: a "person" that vanishes as the picture turns red. Loaded by the trainer, never by Blender."""

import torch


class NotRed(torch.nn.Module):
    def forward(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        wrong = (1 - images[:, 0] + images[:, 1] + images[:, 2]).mean((1, 2)) / 3
        boxes = torch.tensor([[10.0, 10.0, 90.0, 90.0]]).expand(len(images), 1, 4)
        return boxes, wrong[:, None]


def load() -> torch.nn.Module:
    return NotRed()
