"""The canvas of the procedural scenes: textured quads under a level pinhole camera, painted one over the other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw, ImageEnhance

from cloak_core.core.pictures import perspective
from cloak_core.sources.backdrops.procedural_tiles import Rng

Number = float | int
Span = tuple[Number, Number]
NEAR = 0.3
"""Metres: what is nearer to the camera is drawn as if it were this far."""


class SceneCanvas:
    """An image and the level camera that looks at it: metres, x right, y up from the ground, z ahead."""

    def __init__(self, rng: Rng, height: int, width: int) -> None:
        self.image = Image.new("RGB", (width, height))
        self.height, self.width = height, width
        self.focal = height * rng.uniform(0.7, 1.5)
        self.horizon = height * rng.uniform(0.3, 0.62)
        self.eye = rng.uniform(0.9, 2.2)

    def project(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 2"]:
        """Project points ahead of the camera to pixels."""
        scale = self.focal / np.maximum(points[:, 2], NEAR)
        return np.stack([self.width / 2 + scale * points[:, 0], self.horizon + scale * (self.eye - points[:, 1])], 1)

    def quad(self, corners: Sequence[Sequence[Number]], tile: Image.Image, light: Number = 1.0) -> None:
        """Draw a picture on a quad; corners top left, top right, bottom right, bottom left."""
        target = self.project(np.asarray(corners, np.float64))
        low = np.clip(np.floor(target.min(0)), 0, (self.width, self.height)).astype(int)
        high = np.clip(np.ceil(target.max(0)), 0, (self.width, self.height)).astype(int)
        size = (int(high[0] - low[0]), int(high[1] - low[1]))
        if min(size) < 1:
            return
        tile = _lit(tile, light)
        shrink = int(min(tile.width / max(1, np.ptp(target[:, 0])), tile.height / max(1, np.ptp(target[:, 1]))))
        if shrink > 1:
            tile = tile.reduce(shrink)
        source = np.array([(0, 0), (tile.width, 0), (tile.width, tile.height), (0, tile.height)], np.float64)
        try:
            coefficients = perspective(target - low, source).tolist()
        except np.linalg.LinAlgError:  # a degenerate quad
            return
        warped = tile.transform(size, Image.Transform.PERSPECTIVE, coefficients, Image.Resampling.BILINEAR)
        mask = Image.new("L", size)
        ImageDraw.Draw(mask).polygon([tuple(p) for p in (target - low).tolist()], fill=255)
        self.image.paste(warped, (int(low[0]), int(low[1])), mask)

    def ground(self, tile: Image.Image, metres: Number, light: Number = 1.0, ceiling: Number | None = None) -> None:
        """Draw an endless floor (or a ceiling at that height) covered with a repeating picture `metres` wide."""
        drop = self.eye if ceiling is None else self.eye - ceiling
        rows = np.arange(self.height, dtype=np.float32)
        rows = rows[rows > self.horizon] if drop > 0 else rows[rows < self.horizon]
        if not len(rows):
            return
        depth = self.focal * drop / (rows + 0.5 - self.horizon + (1e-3 if drop > 0 else -1e-3))
        across = (np.arange(self.width, dtype=np.float32) - self.width / 2) / self.focal
        pixels = np.asarray(_lit(tile, light))
        u = (depth[:, None] * across * (tile.width / metres)).astype(np.int32) % tile.width
        v = (depth * (tile.height / metres)).astype(np.int32) % tile.height
        mean = tuple(pixels.reshape(-1, 3).mean(0).astype(int).tolist())
        haze = np.clip(depth / (self.focal * metres / tile.width), 0, 1) ** 0.5  # one texel per pixel and beyond
        mask = np.broadcast_to((haze * 255).astype(np.uint8)[:, None], u.shape)
        band = Image.fromarray(pixels.reshape(-1, 3)[v[:, None] * tile.width + u])
        band.paste(mean, (0, 0), Image.fromarray(np.ascontiguousarray(mask)))
        self.image.paste(band, (0, int(rows[0])))

    def panel(self, across: Span, up: Span, z: Number, tile: Image.Image, light: Number = 1.0) -> None:
        """Draw a picture that faces the camera, from left to right and from low to high."""
        (left, right), (low, high) = across, up
        self.quad(((left, high, z), (right, high, z), (right, low, z), (left, low, z)), tile, light)

    def side(self, x: Number, ahead: Span, up: Span, tile: Image.Image, light: Number = 1.0) -> None:
        """Draw a picture along the way ahead, from near to far and from low to high, seen from the middle."""
        first, last = ahead if x < 0 else ahead[::-1]
        self.quad(((x, up[1], first), (x, up[1], last), (x, up[0], last), (x, up[0], first)), tile, light)

    def upright(self, x: Number, z: Number, width: Number, height: Number, tile: Image.Image) -> None:
        """Draw a picture standing on the ground, facing the camera."""
        self.panel((x - width / 2, x + width / 2), (0, height), z, tile)

    def box(self, x: Number, z: Number, size: tuple[Number, ...], tile: Image.Image, base: Number = 0.0) -> None:
        """Draw a box of (width, height, depth) whose front is at z and stands `base` above the ground."""
        left, right, top, back = x - size[0] / 2, x + size[0] / 2, base + size[1], z + size[2]
        if top < self.eye:
            self.quad(((left, top, back), (right, top, back), (right, top, z), (left, top, z)), tile, 1.15)
        if left > 0:
            self.side(left, (z, back), (base, top), tile, 0.65)
        if right < 0:
            self.side(right, (z, back), (base, top), tile, 0.75)
        self.panel((left, right), (base, top), z, tile, 0.95)

    def blob(self, x: Number, y: Number, z: Number, radius: Number, tile: Image.Image, rng: Rng) -> None:
        """Draw a ragged round patch of a picture, such as the crown of a tree."""
        centre = self.project(np.array([[x, y, z]]))[0]
        r = radius * self.focal / max(z, NEAR)
        angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        reach = r * (1 + 0.18 * rng.standard_normal(24))
        outline = np.stack([r * 1.5 + reach * np.cos(angles), r * 1.5 + reach * np.sin(angles)], 1)
        size = int(np.clip(3 * r, 2, 3 * self.height))
        mask = Image.new("L", (size, size))
        ImageDraw.Draw(mask).polygon([tuple(p) for p in outline.tolist()], fill=255)
        patch = tile.resize((size, size), Image.Resampling.BILINEAR)
        self.image.paste(patch, (int(centre[0] - 1.5 * r), int(centre[1] - 1.5 * r)), mask)


def _lit(tile: Image.Image, light: Number) -> Image.Image:
    return tile if light == 1.0 else ImageEnhance.Brightness(tile).enhance(light)
