"""`cloak bench accuracy`: speed against error, for every number of samples, for exact areas and for peer renderers.

Times, milliseconds: visibility_ms (what is seen, nothing lit; of a peer, rays or matrices being ready), new_view_ms
(all that a cached render needs), cached_ms (a render of a logo with its gradient), pose_ms (what a peer does once for
each new pose, such as building a tree; vertex normals, which all need, not counted).
Errors, against `bench.reference`:
image_rms: root mean square over the body's pixels of the image (smooth colours, default light, black background);
coverage_rms: the same of the coverage; gradient_smooth, gradient_white: relative L2 error of the colour gradient for
a smooth and for a white-noise upstream gradient; starved: share of the faces with more than 0.02 px^2 visible that
receive no gradient. From visibility alone, with the same light on both sides, none but the surface's own colour:
image_visibility and gradient_visibility (smooth), and hidden: the share of all weight that goes to faces that are
invisible in that pixel. given_up: pixels of too many pieces to be exact, which are sampled 64 x 64.
"""

from __future__ import annotations

import logging
import os
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.accuracy_scenes import SCENES, Scene, make_scene
from benchmarks.peers import PeerViewCache, available, usable
from benchmarks.records import with_earlier
from cloak_core.bench.measuring import check_counts, clock, machine, timed
from cloak_core.bench.reference import EXACT, Reference, ReferenceMatrix, matrix_of, reference
from cloak_core.bench.views import cached_render
from cloak_core.core.view import CrowdedPixels
from cloak_core.core.visibility.settings import GRIDS, Light, RenderSettings
from cloak_core.core.visibility.threads import torch_threads
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.scenes import read_scene
from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_json
from cloak_core.jobs.job import Tell
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.studies.pace import in_turn

_log = logging.getLogger(__name__)

VISIBLE = 0.02
"""Pixels of visible area from which a face counts as starved without a gradient."""
PEER_SAMPLES = (1, 4, 16)
"""Samples per pixel at which peers are measured."""
FLAT = Light(ambient=1.0, diffuse=0.0, specular=0.0)


def default_name() -> str:
    """Name the point of the default `RenderSettings`."""
    return _name(RenderSettings().samples)


def _name(samples: int | None) -> str:
    return f"ours-{samples or 'area'}"


def run_bench_accuracy(
    scene: str | os.PathLike | Bodies,
    threads: int = 2,
    repeats: int = 10,
    out: str | os.PathLike | None = None,
    only: tuple[str, ...] = (),
    tell: Tell = _log.info,
) -> dict:
    """Measure all points of all scenes (or of `only` some of them); `tell` hears of each, and how long it took.

    With `out`, also a table, a plot and the JSON in that folder, after each scene; scenes measured there earlier stay
    beside these.
    """
    if unknown := [name for name in only if name not in SCENES]:
        raise InputError(f"scene '{unknown[0]}': there are {', '.join(SCENES)}")
    check_counts(repeats, threads)
    bodies = scene if isinstance(scene, Bodies) else read_scene(scene)
    with torch_threads(threads):
        measured = {"threads": threads, "clock": clock(), "repeats": repeats, "peers": available()}
        measured |= {"machine": machine()}
        result = {"scenes": {}, "default": default_name(), **measured}
        for name in in_turn(tuple(only or SCENES), str, tell):
            begun = time.monotonic()
            result["scenes"][name] = measure(make_scene(name, bodies), repeats, threads, measured["peers"]) | measured
            if out is not None:
                result = write_report(result, Path(out))
            tell(f"{name}: {time.monotonic() - begun:.0f} s")
    return result


def write_report(result: dict, folder: Path) -> dict:
    """Write accuracy.json and accuracy.png, and return what they hold.

    Scenes that an accuracy.json of the folder holds and `result` does not are kept. Raises `InputError` where that
    file cannot be read.
    """
    folder.mkdir(parents=True, exist_ok=True)
    result = result | {"scenes": with_earlier(folder / "accuracy.json", "scenes", result["scenes"], SCENES)}
    write_json(folder / "accuracy.json", result)
    plot(result, folder / "accuracy.png")
    return result


def measure(scene: Scene, repeats: int, threads: int, peers: dict[str, str]) -> dict:
    """Time and compare every way to build a view of one scene. peers: as `available` says."""
    light, key = Light(), [(0, scene.camera)]
    exact = reference(scene.bodies, scene.camera, light)
    judge = Judge(scene, exact)
    points = []
    for samples in (*GRIDS, None):
        lit, flat = (ViewCache(scene.bodies, RenderSettings(light=kind, samples=samples)) for kind in (light, FLAT))
        times = {
            "visibility_ms": _median(partial(lit.visible, key), repeats),
            "new_view_ms": _median(partial(lit.build, key), repeats),
            "cached_ms": _median(cached_render(lit, scene.camera), repeats),
            "pose_ms": None,
        }
        points.append({"name": _name(samples)} | times | judge.errors(lit, flat))
    for kind in usable(peers):
        peer = kind(scene.bodies.triangles.astype(np.int64), threads)
        for samples in PEER_SAMPLES:
            lit, flat = (PeerViewCache(scene.bodies, shine, samples, peer) for shine in (light, FLAT))
            pose = timed(lit.pose, min(repeats, 5), warm_up=1)["median"]
            peer.aim(lit.target(scene.camera))
            times = {
                "visibility_ms": _median(peer.look, repeats),
                "new_view_ms": _median(partial(lit.build, key), repeats),
                "cached_ms": None,
                "pose_ms": pose,
            }
            points.append({"name": f"{kind.module}-{samples}"} | times | judge.errors(lit, flat))
    record = {"triangles": scene.bodies.triangle_count, "reference": EXACT}
    return record | {"pixels": int((exact.matrix.coverage > 0).sum()), "points": points}


def _median(work: Callable[[], object], repeats: int) -> float:
    """Milliseconds: of as many runs as were asked for, of up to ten times as many where they take a third of a second
    together."""
    first = timed(work, 2, warm_up=2)["min"]
    return timed(work, min(10 * repeats, max(repeats, round(333 / first))), warm_up=0)["median"]


class Judge:
    """The errors of a view against the reference."""

    def __init__(self, scene: Scene, exact: Reference) -> None:
        self.camera = scene.camera
        self.exact = exact.matrix
        self.areas = exact.areas
        self.colors = smooth_colors(scene.bodies)
        self.black = torch.zeros(self.camera.width * self.camera.height, 3)
        generator = torch.Generator().manual_seed(0)
        self.white = torch.randn(len(self.black), 3, generator=generator)
        coarse = torch.randn(1, 3, 13, 13, generator=generator)
        size = (self.camera.height, self.camera.width)
        smooth = torch.nn.functional.interpolate(coarse, size, mode="bicubic", align_corners=True)
        self.smooth = smooth[0].permute(1, 2, 0).reshape(-1, 3)
        self.visible = exact.visible > VISIBLE

    def errors(self, cache: ViewCache, flat: ViewCache) -> dict[str, float]:
        """flat: the same without light."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", CrowdedPixels)
            ours = self._matrix(cache)
        given_up = sum(warning.message.pixels for warning in caught if warning.category is CrowdedPixels)
        areas = self._matrix(flat)
        seen = torch.zeros(ours.face_count).double().index_add_(0, ours.face, ours.weight.double()) > 0
        return {
            "image_rms": self._image_rms(ours, self.exact),
            "coverage_rms": self._rms(ours, ours.coverage - self.exact.coverage),
            "gradient_smooth": _relative(ours.gradient(self.smooth), self.exact.gradient(self.smooth)),
            "gradient_white": _relative(ours.gradient(self.white), self.exact.gradient(self.white)),
            "starved": float((self.visible & ~seen).sum() / self.visible.sum().clamp(min=1)),
            "image_visibility": self._image_rms(areas, self.areas),
            "gradient_visibility": _relative(areas.gradient(self.smooth), self.areas.gradient(self.smooth)),
            "hidden": self._hidden(areas),
            "given_up": float(given_up),
        }

    def _matrix(self, cache: ViewCache) -> ReferenceMatrix:
        return matrix_of(cache.build([(0, self.camera)])[0], self.exact.face_count)

    def _image_rms(self, ours: ReferenceMatrix, exact: ReferenceMatrix) -> float:
        return self._rms(ours, ours.image(self.colors, self.black) - exact.image(self.colors, self.black))

    def _rms(self, ours: ReferenceMatrix, difference: Tensor) -> float:
        """Compute the root mean square over the pixels of the body."""
        body = (self.exact.coverage > 0) | (ours.coverage > 0)
        return float(difference[body].double().pow(2).mean().sqrt())

    def _hidden(self, areas: ReferenceMatrix) -> float:
        """Compute the share of the weight that lies where nothing of its face is seen."""
        entries, truth = (m.pixel * m.face_count + m.face for m in (areas, self.areas))
        weight = areas.weight.double()
        return float(weight[~torch.isin(entries, truth)].sum() / weight.sum().clamp(min=1e-30))


def _relative(ours: Tensor, exact: Tensor) -> float:
    return float((ours - exact).norm() / exact.norm())


def smooth_colors(bodies: Bodies) -> Tensor:
    """[F, 3]: colours that change slowly over the body, waves of about 0.8 m in each channel."""
    centers = bodies.vertices[0][bodies.triangles].astype(np.float64).mean(1)
    colors = np.zeros((bodies.face_count, 3))
    wave = 0.5 + 0.4 * np.sin(8 * (centers @ np.array([[1, 0.3, 0], [0, 1, 0.5], [0.4, 0.7, 1]]).T))
    colors[bodies.triangle_face] = wave
    return torch.from_numpy(colors)


# --- the plot: errors against the time of a new view, a column for each scene

_COLORS = {"ours": "tab:red", "embreex": "tab:blue", "mitsuba": "tab:green", "moderngl": "tab:purple"}
_PANELS = {"gradient_smooth": ("gradient error, relative", 0.05), "image_rms": ("image error, RMS", 1 / 255)}
"""Rows of the plot, each with the error that the default setting has to stay below."""
_ACROSS = 4


def plot(result: dict, path: Path) -> None:
    """Plot for each scene the gradient's error above the image's, four scenes side by side."""
    from matplotlib.figure import Figure

    names = list(result["scenes"])
    across = min(len(names), _ACROSS)
    down = -(-len(names) // _ACROSS)
    figure = Figure(figsize=(3.3 * across + 1, 6 * down), layout="constrained")
    panels = figure.subplots(len(_PANELS) * down, across, squeeze=False)
    for panel in panels.flat:
        panel.set_visible(False)
    for number, name in enumerate(names):
        begin, column = number // across * len(_PANELS), number % across
        pair = panels[begin : begin + len(_PANELS), column]
        for panel, (error, (label, limit)) in zip(pair, _PANELS.items(), strict=True):
            _draw(panel, result["scenes"][name]["points"], error, result["default"])
            panel.axhline(limit, color="0.6", linestyle=":", linewidth=1, zorder=0, label="limit set for the default")
            panel.set(ylabel=label if column == 0 else "")
        pair[0].set(title=name)
        pair[-1].set(xlabel="new view, ms")
        pair[0].sharex(pair[-1])
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.savefig(path, dpi=110)


def _draw(panel: object, points: list[dict], error: str, default: str) -> None:
    """Draw a point for each way to build a view; ours are named by their samples."""
    panel.set_visible(True)
    panel.margins(0.12)
    panel.set(xscale="log", yscale="log")
    panel.grid(True, which="major", color="0.92")
    for point in points:
        family, _, samples = point["name"].partition("-")
        place = point["new_view_ms"], point[error]
        is_first = samples == "1"
        size = 90 if point["name"] == default else 22
        panel.scatter(*place, color=_COLORS.get(family, "0.4"), s=size, label=family if is_first else None, zorder=3)
        if family == "ours":
            panel.annotate(samples, place, textcoords="offset points", xytext=(-5, -11), ha="right", fontsize=8)
