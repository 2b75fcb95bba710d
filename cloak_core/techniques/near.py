"""Colours that stay close to a garment's: a bound on the mean and on the 95th percentile of CIEDE2000, kept exactly.

The projection is that onto a ball of the summed distances (soft thresholding: Duchi et al., "Efficient projections onto
the l1-ball", ICML 2008), each face moving on the straight line to its garment's colour: most faces end as the garment
has them, and the difference is spent where it hides most.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float32, UInt8
from scipy.ndimage import gaussian_filter

from cloak_core.core.logo import Logo
from cloak_core.core.pattern import Pattern
from cloak_core.core.pictures import read_picture
from cloak_core.core.settings import TrainSettings
from cloak_core.core.technique import Technique
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays
from cloak_core.patterns.cloth import ClothPattern
from cloak_core.sources.bodies.logos.palette import de2000, lab
from cloak_core.zoo.entry import read_start

HALVINGS = 12
"""Of the way to the garment's colour, until a face is near enough."""
TILE = 0.5
"""Metres that a picture repeats after, unless told."""
PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".bmp")
WOODLAND = np.array([(75, 83, 52), (44, 53, 36), (98, 80, 56), (151, 138, 101)], np.uint8)
"""Olive, dark green, brown, tan."""
_PLAIN = re.compile(r"#([0-9a-fA-F]{6})")


class Near(Technique):
    """A garment's colours, and how far from them all faces together may be."""

    def __init__(self, garment: Float[np.ndarray, "L 3"], mean: float, most: float) -> None:
        """garment: sRGB in [0, 1], float32; mean and most: the largest mean and 95th percentile of CIEDE2000."""
        self.garment = garment
        self.mean = mean
        self.most = most

    def distances(self, colors: Float[np.ndarray, "L 3"]) -> Float[np.ndarray, " L"]:
        """Compute each face's CIEDE2000 from the garment."""
        return de2000(lab(colors), lab(self.garment))

    def closeness(self, colors: Float[np.ndarray, "L 3"]) -> tuple[float, float]:
        """Compute mean and 95th percentile of CIEDE2000 from the garment."""
        far = self.distances(colors)
        return float(far.mean()), float(np.percentile(far, 95))

    def content(self) -> dict[str, object]:
        return {"near": {"sha256": sha256_arrays(self.garment)}}

    def report(self, colors: Float[np.ndarray, "L 3"]) -> dict[str, float]:
        return dict(zip(("de2000_mean", "de2000_p95"), self.closeness(colors), strict=True))

    def project(self, colors: Float[torch.Tensor, "L 3"]) -> Float[torch.Tensor, "L 3"]:
        """Move faces towards the garment until both bounds hold; colours that keep them stay to the bit.

        Faces of equal colours on equal garment colours stay equal.
        """
        own = colors.detach().cpu().numpy()
        far = self.distances(own)
        allowed = self._allowed(far)
        rows = np.flatnonzero(allowed < far)
        if not len(rows):
            return colors
        own = own.copy()
        own[rows] = self._moved(own[rows], self.garment[rows], allowed[rows])
        return torch.from_numpy(own).to(colors)

    def _allowed(self, far: Float[np.ndarray, " L"]) -> Float[np.ndarray, " L"]:
        """Find each face's largest distance so that both bounds hold together."""
        place = math.ceil(0.95 * (len(far) - 1))  # of the largest that the percentile looks at
        allowed = np.minimum(far, self.most) if np.sort(far)[place] > self.most else far
        if allowed is not far:
            # The few that a percentile does not see may stay; of equal ones all or none.
            allowed = np.where(far > np.sort(far)[place], far, allowed)
        if allowed.mean() <= self.mean:
            return allowed
        # What is taken from every distance, none going below 0, so that they sum up to the mean's (soft thresholding).
        ordered = np.sort(allowed)[::-1]
        sums = np.cumsum(ordered) - self.mean * len(allowed)
        counts = np.arange(1, len(allowed) + 1)
        last = np.flatnonzero(ordered > sums / counts)[-1]
        return np.maximum(allowed - float(sums[last] / counts[last]), 0)

    def _moved(
        self, colors: Float[np.ndarray, "n 3"], garment: Float[np.ndarray, "n 3"], allowed: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n 3"]:
        """Find the farthest place on the line from the garment to each colour that is near enough."""
        low, high = np.zeros(len(colors)), np.ones(len(colors))
        base = lab(garment)
        reached = garment.copy()
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            tried = (garment + middle[:, None] * (colors - garment)).astype(np.float32)
            near = de2000(lab(tried), base) <= allowed
            reached[near] = tried[near]
            low, high = np.where(near, middle, low), np.where(near, high, middle)
        return reached


def build(settings: TrainSettings, pattern: Pattern, detectors: object, device: object) -> Near:
    """Read the garment that colours stay close to; where faces share a colour, its mean there.

    InputError: no such garment; one of several colours where inks are counted.
    """
    named, most = settings.pattern.near, settings.pattern.colors_at_most
    within = settings.pattern.within
    garment = garment_colors(named, pattern.bodies, pattern.cover)
    garment = read_start(Path(named), pattern.cover, "--near") if garment is None else garment
    if most is not None and len(np.unique(garment, axis=0)) > 1:
        raise InputError("--near: with --colors-at-most the garment must have one colour")
    if most is not None and settings.objective.palette is not None:
        raise InputError("--near: would move colours away from those of --palette; give --colors-at-most alone")
    return Near(pattern.from_faces(garment), within, 2 * within)


def garment_colors(spec: str, bodies: Bodies, logo: Logo) -> Float32[np.ndarray, "L 3"] | None:
    """Find a garment's colours on the logo, sRGB in [0, 1]; None where `spec` names neither of these.

    spec: "#rrggbb"; "clothing", the body's first outfit; "camouflage", a woodland print; a picture,
    FILE.png[@tile=METRES], worn as cloth: each face has its mean there. InputError: no such picture, no width.
    """
    if (plain := _PLAIN.fullmatch(spec)) is not None:
        color = np.frombuffer(bytes.fromhex(plain[1]), np.uint8) / np.float32(255)
        return np.tile(color.astype(np.float32), (len(logo), 1))
    if spec == "clothing":
        return np.ascontiguousarray(bodies.face_colors[0, logo.face_ids], np.float32)
    file, _, width = spec.partition("@tile=")
    if spec != "camouflage" and Path(file).suffix.lower() not in PICTURES:
        return None
    try:
        tile = float(width or TILE)
    except ValueError:
        tile = 0.0
    if not 0.01 <= tile <= 10:
        raise InputError(f"{spec}: tile={width} is no width in metres (0.01 to 10)")
    picture = camouflage() if spec == "camouflage" else read_picture(Path(file).expanduser())
    cloth = ClothPattern.of_picture(logo, picture, tile, bodies=bodies)
    return cloth.on_faces(cloth.colors)


def camouflage(side: int = 256) -> UInt8[np.ndarray, "side side 3"]:
    """Draw a woodland print that repeats: smooth noise, cut at its quantiles into four colours."""
    noise = gaussian_filter(np.random.default_rng(0).standard_normal((side, side)), side / 24, mode="wrap")
    return WOODLAND[np.searchsorted(np.quantile(noise, (0.3, 0.6, 0.8)), noise)]
