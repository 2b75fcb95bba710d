"""A printer's and a camera's profile: colours are trained as they are photographed after printing."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float

from cloak_core.core.technique import Technique
from cloak_core.exchange.profiles import Profile
from cloak_core.files.identity import sha256_arrays


class Photographed(Technique):
    """Values are what is sent to the printer, colours what is photographed."""

    bars_search = True

    def __init__(self, profile: Profile, device: torch.device | str = "cpu") -> None:
        self.profile = profile
        self._table = torch.from_numpy(profile.table).to(device).permute(3, 0, 1, 2)[None]

    def tone(self, values: Float[torch.Tensor, "N 3"]) -> Float[torch.Tensor, "N 3"]:
        if not len(values):
            return values
        # grid_sample's first coordinate is the table's last axis.
        place = (2 * values.flip(1) - 1).view(1, 1, 1, -1, 3)
        sampled = torch.nn.functional.grid_sample(self._table, place, padding_mode="border", align_corners=True)
        return sampled.view(3, -1).T

    def untone(self, colors: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        return self.profile.to_send(colors)

    def content(self) -> dict[str, object]:
        return {"profile": {"sha256": sha256_arrays(self.profile.table)}}
