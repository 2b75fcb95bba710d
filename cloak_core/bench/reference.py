"""The reference that views are judged by: 64 x 64 samples per pixel, each lit on its own small piece of surface.

Exact area coverage by clipping visible triangles against each other is out of reach for hidden surfaces, so the
reference counts: the view is rendered 8 times as large with 64 samples per pixel, and blocks of 8 x 8 pixels are
averaged. Its own error is that of a 64 x 64 grid: below 1/64 of a pixel's edge length for every edge that crosses it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from cloak_core.render.shading import Light
from cloak_core.render.views import View, ViewBank
from cloak_core.scene.cameras import Camera
from cloak_core.scene.exchange import Bodies

FACTOR = 8


@dataclass(frozen=True, eq=False)
class Matrix:
    """A view as entries (pixel, face, weight), with the pixels' coverage and highlight; all on the CPU."""

    pixel: Int64[Tensor, " E"]
    face: Int64[Tensor, " E"]
    weight: Float[Tensor, " E"]
    coverage: Float[Tensor, " pixels"]
    specular: Float[Tensor, " pixels"]
    face_count: int

    def image(self, colors: Float[Tensor, "F 3"], background: Float[Tensor, "pixels 3"]) -> Float[Tensor, "pixels 3"]:
        """Composited and clamped, float64."""
        body = torch.zeros(len(self.coverage), 3, dtype=torch.float64)
        body.index_add_(0, self.pixel, self.weight.double().unsqueeze(1) * colors.double()[self.face])
        body += self.specular.double().unsqueeze(1)
        return (body + (1 - self.coverage.double()).unsqueeze(1) * background.double()).clamp(0, 1)

    def gradient(self, upstream: Float[Tensor, "pixels 3"]) -> Float[Tensor, "F 3"]:
        """Of sum(upstream * image before clamping) with respect to the face colours, float64."""
        result = torch.zeros(self.face_count, 3, dtype=torch.float64)
        return result.index_add_(0, self.face, self.weight.double().unsqueeze(1) * upstream.double()[self.pixel])


def matrix_of(view: View, face_count: int) -> Matrix:
    """The matrix of a view."""
    view = replace(view, **{k: v.cpu() for k, v in vars(view).items() if isinstance(v, Tensor)})
    pixels = view.height * view.width
    row = torch.repeat_interleave(view.crow.diff(), output_size=len(view.face))
    spread = lambda values: torch.zeros(pixels).index_copy_(0, view.pixels, values)
    return Matrix(view.pixels[row], view.face, view.weight, spread(view.coverage), spread(view.specular), face_count)


def reference(bodies: Bodies, camera: Camera, light: Light, pose: int = 0) -> Matrix:
    """What the view tends to with more and more samples; takes seconds."""
    bank = ViewBank(bodies, light, samples=64, memory_bytes=1)
    large = replace(camera, width=camera.width * FACTOR, height=camera.height * FACTOR)
    fine = matrix_of(bank.build([(pose, large)])[0], bodies.face_count)
    index = np.arange(large.height * large.width)
    coarse = torch.from_numpy(
        (index // large.width // FACTOR) * camera.width + index % large.width // FACTOR
    )  # coarse pixel of every fine one
    share = 1 / FACTOR**2
    key, entry = torch.unique(coarse[fine.pixel] * bodies.face_count + fine.face, return_inverse=True)
    weight = torch.zeros(len(key), dtype=torch.float64).index_add_(0, entry, fine.weight.double() * share)
    pixels = camera.height * camera.width
    fold = lambda values: torch.zeros(pixels, dtype=torch.float64).index_add_(0, coarse, values.double() * share)
    pixel = torch.div(key, bodies.face_count, rounding_mode="floor")
    return Matrix(
        pixel, key - pixel * bodies.face_count, weight, fold(fine.coverage), fold(fine.specular), bodies.face_count
    )
