"""`cloak bench accuracy`: speed against error, for every number of samples and for exact areas.

Errors are against the 64 x 64 samples of `bench.reference`:
image_rms: root mean square over the body's pixels of the image (smooth colours, default light, black background);
coverage_rms: the same of the coverage; gradient_smooth, gradient_white: relative L2 error of the colour gradient for
a smooth and for a white-noise upstream gradient; starved: share of the faces with more than 0.02 px^2 visible that
receive no gradient.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from cloak_core.bench.reference import Matrix, matrix_of, reference
from cloak_core.bench.views import cached_render, machine, timed, torch_threads
from cloak_core.render.shading import Light
from cloak_core.render.views import GRIDS, ViewBank
from cloak_core.scene.bodies import subdivide
from cloak_core.scene.cameras import Camera
from cloak_core.scene.exchange import Bodies, read_scene

VISIBLE = 0.02
"""Pixels of visible area from which a face counts as starved without a gradient."""
DEFAULT = "ours-area"
COLUMNS = {
    "visibility_ms": "visibility, ms",
    "new_view_ms": "new view, ms",
    "cached_ms": "cached + gradient, ms",
    "image_rms": "image RMS",
    "coverage_rms": "coverage RMS",
    "gradient_smooth": "gradient, smooth",
    "gradient_white": "gradient, white",
    "starved": "starved",
}


@dataclass(frozen=True)
class Scene:
    """A body and the camera that makes it hard."""

    bodies: Bodies
    camera: Camera


def scenes(bodies: Bodies) -> dict[str, Scene]:
    """The scene itself, far away, close up and cut by the near plane, and with about a million triangles."""
    first = bodies.select_poses([0])
    dense = first
    while dense.triangle_count < 800_000:
        dense, _ = subdivide(dense)
    return {
        "bench": Scene(first, Camera(azimuth=-10.0)),
        "distant": Scene(first, Camera(azimuth=-10.0, distance=8.0)),
        "close-up": Scene(first, Camera(azimuth=-10.0, distance=1.0, near=0.85)),
        "million": Scene(dense, Camera(azimuth=-10.0)),
    }


def run_bench_accuracy(
    scene: str | os.PathLike | Bodies,
    threads: int = 2,
    repeats: int = 10,
    out: str | os.PathLike | None = None,
    only: tuple[str, ...] | None = None,
) -> dict:
    """All points of all scenes (or of `only` some); with `out`, also a table, a plot and the JSON in that folder."""
    bodies = scene if isinstance(scene, Bodies) else read_scene(scene)
    chosen = {name: s for name, s in scenes(bodies).items() if only is None or name in only}
    result = {"scenes": {}, "default": DEFAULT, "threads": threads, "repeats": repeats, "machine": machine()}
    with torch_threads(threads):
        for name, item in chosen.items():
            result["scenes"][name] = measure(item, repeats)
    if out is not None:
        from cloak_core.bench.accuracy_report import write_report

        write_report(result, Path(out))
    return result


def measure(scene: Scene, repeats: int) -> dict:
    """Every way to build a view of one scene, timed and compared."""
    light = Light()
    judge = Judge(scene, light, reference(scene.bodies, scene.camera, light))
    points = []
    for samples in (*GRIDS, None):
        bank = ViewBank(scene.bodies, light, samples)
        name = f"ours-{samples or 'area'}"
        points.append({"name": name} | _times(bank, scene.camera, repeats) | judge.errors(bank))
    record = {"triangles": scene.bodies.triangle_count, "reference": "64 x 64 samples per pixel"}
    return record | {"pixels": int((judge.exact.coverage > 0).sum()), "points": points}


def _times(bank: ViewBank, camera: Camera, repeats: int) -> dict[str, float]:
    key = [(0, camera)]
    median = lambda work: timed(work, repeats, warm_up=2)["median"]
    return {
        "visibility_ms": median(lambda: bank.visible(key)),
        "new_view_ms": median(lambda: bank.build(key)),
        "cached_ms": median(cached_render(bank, camera)),
    }


class Judge:
    """The errors of a view against the reference."""

    def __init__(self, scene: Scene, light: Light, exact: Matrix) -> None:
        self.scene, self.light, self.exact = scene, light, exact
        camera = scene.camera
        self.colors = smooth_colors(scene.bodies)
        self.black = torch.zeros(camera.width * camera.height, 3)
        generator = torch.Generator().manual_seed(0)
        self.white = torch.randn(len(self.black), 3, generator=generator)
        coarse = torch.randn(1, 3, 13, 13, generator=generator)
        size = (camera.height, camera.width)
        smooth = torch.nn.functional.interpolate(coarse, size, mode="bicubic", align_corners=True)
        self.smooth = smooth[0].permute(1, 2, 0).reshape(-1, 3)
        flat = Light(ambient=1.0, diffuse=0.0, specular=0.0)
        area = reference(scene.bodies, camera, flat)
        self.visible = torch.zeros(exact.face_count).double().index_add_(0, area.face, area.weight.double()) > VISIBLE

    def errors(self, bank: ViewBank) -> dict[str, float]:
        ours = matrix_of(bank.build([(0, self.scene.camera)])[0], self.exact.face_count)
        body = (self.exact.coverage > 0) | (ours.coverage > 0)
        rms = lambda a, b: float((a - b)[body].double().pow(2).mean().sqrt())
        seen = torch.zeros(ours.face_count).double().index_add_(0, ours.face, ours.weight.double()) > 0
        return {
            "image_rms": rms(ours.image(self.colors, self.black), self.exact.image(self.colors, self.black)),
            "coverage_rms": rms(ours.coverage, self.exact.coverage),
            "gradient_smooth": _relative(ours.gradient(self.smooth), self.exact.gradient(self.smooth)),
            "gradient_white": _relative(ours.gradient(self.white), self.exact.gradient(self.white)),
            "starved": float((self.visible & ~seen).sum() / self.visible.sum().clamp(min=1)),
        }


def _relative(ours: Tensor, exact: Tensor) -> float:
    return float((ours - exact).norm() / exact.norm())


def smooth_colors(bodies: Bodies) -> Tensor:
    """[F, 3]: colours that change slowly over the body, waves of about 0.8 m in each channel."""
    centers = bodies.vertices[0][bodies.triangles].astype(np.float64).mean(1)
    colors = np.zeros((bodies.face_count, 3))
    wave = 0.5 + 0.4 * np.sin(8 * (centers @ np.array([[1, 0.3, 0], [0, 1, 0.5], [0.4, 0.7, 1]]).T))
    colors[bodies.triangle_face] = wave
    return torch.from_numpy(colors)
