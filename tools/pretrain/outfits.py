"""Random clothes for the bodies that the built-in detector learns from: a colour for every face.

Patterns are functions of where a face sits on the standing body, so that they wrap around it like cloth. Greys and
per-face random colours on arbitrary patches are among them: a patch alone must not hide a person.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from cloak_core.core.geometry import face_centres, face_normals
from cloak_core.exchange.bodies import Bodies

Rng = np.random.Generator
Colors = Float[np.ndarray, "F 3"]
Pattern = Callable[[Rng, Colors], Colors]

GARMENTS = ("shirt", "trousers", "feet", "hands")
PATCHED = ("chest", "belly", "back", "thighs", "shins", "arms", "forearms", "shirt", "trousers")


class Wardrobe:
    """Draws outfits for the faces of one topology."""

    def __init__(self, bodies: Bodies) -> None:
        centre = face_centres(bodies)
        self.centre = (centre - centre.mean(0)).astype(np.float32)
        self.normal = face_normals(bodies).astype(np.float32)
        self.base = bodies.face_colors
        self.garments = [bodies.regions[n] for n in GARMENTS if n in bodies.regions]
        self.patches = [bodies.regions[n] for n in PATCHED if n in bodies.regions]

    def draw(self, rng: Rng) -> Colors:
        """One outfit: sRGB in [0, 1]."""
        colors = self.base[rng.integers(len(self.base))] * rng.uniform(0.6, 1.25) * rng.uniform(0.9, 1.1, 3)
        colors = colors.clip(0, 1).astype(np.float32)
        if rng.random() < 0.04:
            return np.array(self._pattern(rng, CLOTHS))
        for garment in self.garments:
            if rng.random() < 0.7:
                colors[garment] = self._pattern(rng, CLOTHS)[garment]
        for _ in range(rng.choice([0, 1, 2, 3], p=[0.35, 0.35, 0.2, 0.1])):
            patch = self._patch(rng)
            colors[patch] = self._pattern(rng, PATCHES)[patch]
        return colors

    def _patch(self, rng: Rng) -> Bool[np.ndarray, " F"]:
        """A named region or two, perhaps its front only, or a slab of the body seen from some side."""
        if self.patches and rng.random() < 0.7:
            faces = self.patches[rng.integers(len(self.patches))].copy()
            if rng.random() < 0.6:
                faces |= self.patches[rng.integers(len(self.patches))]
        else:
            low, high = np.quantile(self.centre[:, 1], np.sort(rng.random(2)))
            faces = (self.centre[:, 1] >= low) & (self.centre[:, 1] <= high)
        if rng.random() < 0.5:
            angle = rng.uniform(0, 2 * np.pi) if rng.random() < 0.4 else np.pi / 2
            faces &= self.normal @ np.array([np.cos(angle), 0, np.sin(angle)], np.float32) > 0
        return faces

    def _pattern(self, rng: Rng, kinds: dict[Pattern, float]) -> Colors:
        """One of the patterns, over the whole body."""
        weights = np.array(list(kinds.values()))
        return list(kinds)[rng.choice(len(kinds), p=weights / weights.sum())](rng, self.centre)


def _color(rng: Rng) -> Float[np.ndarray, 3]:
    """Any colour, the pale and the dark ones more often than a uniform draw has them."""
    color = rng.random(3) * rng.uniform(0.1, 1) + rng.uniform(0, 0.3)
    return (color + (color.mean() - color) * rng.uniform(0, 0.9)).clip(0, 1).astype(np.float32)


def _plain(rng: Rng, centre: Colors) -> Colors:
    return np.broadcast_to(_color(rng), centre.shape)


def _grey(rng: Rng, centre: Colors) -> Colors:
    level = 0.5 if rng.random() < 0.5 else rng.random()
    return np.full(centre.shape, level, np.float32)


def _wave(rng: Rng, centre: Colors, low: float | int, high: float | int) -> Float[np.ndarray, " F"]:
    """A sine along a random direction, `low` to `high` periods a metre."""
    direction = rng.standard_normal(3)
    if rng.random() < 0.6:
        direction *= [(1, 0, 0), (0, 1, 0)][rng.integers(2)]
    direction *= 2 * np.pi * rng.uniform(low, high) / np.linalg.norm(direction).clip(1e-9)
    return np.sin(centre @ direction.astype(np.float32) + rng.uniform(0, 2 * np.pi))


def _stripes(rng: Rng, centre: Colors) -> Colors:
    wave = _wave(rng, centre, 2, 25)
    t = (wave * rng.choice([0.6, 5, 50])).clip(-1, 1)[:, None] / 2 + 0.5
    return (t * _color(rng) + (1 - t) * _color(rng)).astype(np.float32)


def _checks(rng: Rng, centre: Colors) -> Colors:
    t = (_wave(rng, centre, 2, 15) * _wave(rng, centre, 2, 15) > 0)[:, None]
    return np.where(t, _color(rng), _color(rng)).astype(np.float32)


def _confetti(rng: Rng, centre: Colors) -> Colors:
    colors = np.stack([_color(rng) for _ in range(rng.integers(2, 6))])
    share = rng.uniform(0.05, 0.6)
    pick = rng.integers(1, len(colors), len(centre)) * (rng.random(len(centre)) < share)
    return colors[pick]


def _face_noise(rng: Rng, centre: Colors) -> Colors:
    noise = rng.random(centre.shape, dtype=np.float32)
    return noise if rng.random() < 0.6 else (_color(rng) + (noise - 0.5) * rng.uniform(0.1, 1)).clip(0, 1).astype("f4")


def _smooth(rng: Rng, centre: Colors) -> Colors:
    waves = np.stack([sum(_wave(rng, centre, 0.5, 10) for _ in range(3)) for _ in range(3)], 1)
    return (_color(rng) + waves * rng.uniform(0.05, 0.35)).clip(0, 1).astype(np.float32)


def _blocks(rng: Rng, centre: Colors) -> Colors:
    """Camouflage: cubes of space, each of one colour out of a few."""
    cells = np.floor(centre * rng.uniform(4, 40) + rng.random(3)).astype(np.int64)
    code = (cells * np.array([73856093, 19349663, 83492791])).sum(1) % 1009
    palette = np.stack([_color(rng) for _ in range(rng.integers(2, 7))])
    return palette[rng.integers(0, len(palette), 1009)[code]]


CLOTHS = {
    _plain: 5.0,
    _grey: 1.5,
    _stripes: 1.0,
    _checks: 0.7,
    _confetti: 0.6,
    _face_noise: 0.8,
    _smooth: 0.6,
    _blocks: 0.5,
}
"""How often a garment has which pattern."""
PATCHES = {_plain: 1.0, _grey: 2.0, _confetti: 0.5, _face_noise: 2.0}
"""What a patch on the clothes is filled with: mostly what the controls of an evaluation show."""
