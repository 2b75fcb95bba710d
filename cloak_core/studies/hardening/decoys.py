"""Draw pictures of patterned cloth that nobody wears: hard negatives for hardening.

A detector that learns from cloaked people alone learns that anything colourful and upright is a person. So it also
sees cloaks, prints and random patterns as panels, curtains, boxes, racks of garments, headless dummies and patches on
whatever a photograph shows, each beside the same picture without the pattern: what the unhardened detector says of the
latter is what it should say of the former.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Float32
from scipy.spatial import cKDTree
from torch import Tensor

from cloak_core.core.pictures import perspective

TEXTURE = 96
"""Height and width of a texture, pixels."""
Texture = Float32[np.ndarray, "3 t t"]
Quad = Float[np.ndarray, "4 2"]
"""Corners in pixels: top left, top right, bottom right, bottom left."""
UNIT_SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


class FlatCloth:
    """The colours of a logo's faces laid flat: the texture of a panel printed with a cloak.

    centres: [L, 3] face centres, metres; normals: [L, 3]. Faces that look to the front (or, where there are none, all)
    are projected onto the x-y plane; a pixel takes the colour of the nearest one.
    """

    def __init__(self, centres: Float[np.ndarray, "L 3"], normals: Float[np.ndarray, "L 3"]) -> None:
        front = np.flatnonzero(normals[:, 2] > 0)
        front = front if len(front) else np.arange(len(centres))
        points = centres[front, :2]
        low, high = points.min(0), points.max(0)
        x = np.linspace(low[0], high[0], TEXTURE)
        y = np.linspace(high[1], low[1], TEXTURE)
        self._face = front[cKDTree(points).query(np.stack(np.meshgrid(x, y), -1).reshape(-1, 2))[1]]

    def texture(self, colors: Float32[np.ndarray, "L 3"]) -> Texture:
        """Give the texture in these colours."""
        return np.ascontiguousarray(colors[self._face].T.reshape(3, TEXTURE, TEXTURE))


def random_texture(rng: np.random.Generator, picture: Callable[[], Float[Tensor, "3 H W"]] | None = None) -> Texture:
    """Draw a pattern that nobody trained.

    Noise, blocks, stripes, checks, blobs of a few colours, smooth colours of one or several scales, a single colour,
    or, where there is a picture, a print of a part of it.
    """
    kind, cells = rng.integers(9 if picture is not None else 7), int(rng.integers(4, 32))
    if kind == 0:
        return rng.random((3, TEXTURE, TEXTURE)).astype(np.float32)
    if kind == 1:
        return _enlarged(rng.random((3, cells, cells)), "nearest")
    if kind == 2:
        lines = rng.random((3, cells, 1)).repeat(cells, 2)
        return _enlarged(lines if rng.random() < 0.5 else lines.swapaxes(1, 2), "nearest")
    if kind == 3:
        even = (np.add.outer(np.arange(cells), np.arange(cells)) % 2)[None]
        return _enlarged(np.where(even, rng.random((3, 1, 1)), rng.random((3, 1, 1))), "nearest")
    if kind == 4:
        field = _enlarged(rng.normal(size=(1, cells, cells)), "bicubic")[0]
        return rng.random((5, 3)).astype(np.float32)[np.digitize(field, (-0.6, -0.2, 0.2, 0.6))].transpose(2, 0, 1)
    if kind == 5:
        octaves = [_enlarged(rng.normal(0, 0.7**k, (3, n, n)), "bicubic") for k, n in enumerate((4, 8, 16, 32))]
        smooth = sum(octaves[: rng.integers(1, 5)])
        return (0.5 + rng.uniform(0.1, 0.5) * smooth).clip(0, 1).astype(np.float32)
    if kind == 6:
        return np.broadcast_to(rng.random((3, 1, 1)).astype(np.float32), (3, TEXTURE, TEXTURE))
    whole = picture()
    side = int(rng.integers(min(whole.shape[1:]) // 6, min(whole.shape[1:]) // 2))
    y, x = (int(rng.integers(length - side)) for length in whole.shape[1:])
    print_of = whole[:, y : y + side, x : x + side]
    return _enlarged(print_of.numpy()[list(rng.permutation(3))], "bilinear")


def _enlarged(cells: np.ndarray, mode: str) -> Float32[np.ndarray, "c t t"]:
    image = torch.from_numpy(cells.astype(np.float32))[None]
    return F.interpolate(image, (TEXTURE, TEXTURE), mode=mode)[0].numpy()


@dataclass(frozen=True)
class Layer:
    """One piece of cloth in a picture, within the rectangle of pixels that holds it."""

    area: tuple[slice, slice]
    """Rows and columns of the picture."""
    alpha: Float[Tensor, "h w"]
    """How much of each pixel it covers."""
    place: Float[Tensor, "h w 2"]
    """What each pixel shows of the texture, -1 to 1 across and down."""


def draw_decoy(
    picture: Float[Tensor, "3 H W"],
    textures: Iterator[Texture],
    rng: np.random.Generator,
    silhouette: Float[Tensor, "H W"] | None = None,
    keep_clear: Sequence[Sequence[float]] = (),
    flat: bool = False,
) -> Float[Tensor, "3 H W"]:
    """Draw patterned cloth into a picture, as one of `SHAPES` or on a dummy.

    picture: [0, 1], unchanged. textures: what cloth shows, one after the other; a rack needs several. silhouette: a
    body's coverage of pixels, for dummies. keep_clear: boxes (xyxy, pixels) of people, of whom the cloth hides no more
    than a tenth. flat: an upright panel and nothing else.
    """
    height, width = picture.shape[1:]
    for _ in range(8):
        if silhouette is not None and rng.random() < DUMMIES:
            layers = [_dummy(silhouette)]
        else:
            shape = _panel if flat else SHAPES[rng.choice(len(SHAPES), p=ODDS)]
            layers = [_layer(quad, height, width) for quad in shape(rng, height, width)]
        covered = torch.zeros(height, width)
        for layer in layers:
            covered[layer.area] = torch.maximum(covered[layer.area], layer.alpha)
        if not _covers(covered, keep_clear):
            break
    else:
        return picture
    shown, texture = picture.clone(), next(textures)
    light = _folds(rng, height, width) * _shading(picture, rng)
    for layer in layers:
        if len(layers) > 3 and rng.random() < 0.5:  # a rack holds different garments
            texture = next(textures)
        bright = (light * float(rng.uniform(0.6, 1.0)))[layer.area]
        colors, grid = torch.from_numpy(np.array(texture))[None], layer.place.nan_to_num(-1)[None]
        cloth = F.grid_sample(colors, grid, padding_mode="border", align_corners=False)[0]
        under = shown[:, *layer.area] * (1 - layer.alpha)
        shown[:, *layer.area] = under + (cloth * bright).clamp(0, 1) * layer.alpha
    return shown


def _panel(rng: np.random.Generator, height: int, width: int) -> list[Quad]:
    """Draw an upright rectangle of about a person's proportions, slightly askew."""
    tall = rng.uniform(0.25, 0.95) * height
    wide = tall / rng.uniform(1.0, 3.5)
    return [_quad(rng, rng.uniform(0, width), height / 2 + rng.normal() * height / 8, wide, tall, 0.08)]


def _curtain(rng: np.random.Generator, height: int, width: int) -> list[Quad]:
    """Draw a wall or curtain over a large part of the picture."""
    wide, tall = rng.uniform(0.4, 1.2) * width, rng.uniform(0.5, 1.2) * height
    return [_quad(rng, rng.uniform(0.2, 0.8) * width, rng.uniform(0.3, 0.7) * height, wide, tall, 0.04)]


def _box(rng: np.random.Generator, height: int, width: int) -> list[Quad]:
    """Draw two sides of a box that share an upright edge."""
    x, top, tall = rng.uniform(0.2, 0.8) * width, rng.uniform(0.1, 0.6) * height, rng.uniform(0.2, 0.7) * height
    sides, slope = rng.uniform(0.08, 0.35, 2) * width, rng.uniform(0.0, 0.15) * height
    left, right = x - sides[0], x + sides[1]
    return [
        np.array([[left, top + slope], [x, top], [x, top + tall], [left, top + tall - slope]]),
        np.array([[x, top], [right, top + slope], [right, top + tall - slope], [x, top + tall]]),
    ]


def _rack(rng: np.random.Generator, height: int, width: int) -> list[Quad]:
    """Draw garments side by side, as on a clothes rack."""
    count, tall = int(rng.integers(4, 9)), rng.uniform(0.2, 0.5) * height
    wide, x, y = tall * rng.uniform(0.25, 0.5), rng.uniform(0, 0.5) * width, rng.uniform(0.3, 0.7) * height
    return [_quad(rng, x + k * wide * 0.9, y, wide, tall * rng.uniform(0.85, 1.1), 0.06) for k in range(count)]


def _patch(rng: np.random.Generator, height: int, width: int) -> list[Quad]:
    """Draw a patch on whatever the picture shows there."""
    side = rng.uniform(0.08, 0.35) * height
    turned = side * rng.uniform(0.6, 1.6)
    return [_quad(rng, rng.uniform(0, width), rng.uniform(0.1, 0.9) * height, side, turned, 0.2)]


SHAPES: tuple[Callable[[np.random.Generator, int, int], list[Quad]], ...] = (_panel, _curtain, _box, _rack, _patch)
ODDS = (0.5, 0.1, 0.15, 0.15, 0.1)
"""An upright panel is most like a person, so it is drawn most often."""
DUMMIES = 0.25
"""Share of decoys that are a garment on a dummy, where there is a silhouette."""


def _quad(rng: np.random.Generator, x: float, y: float, wide: float, tall: float, askew: float) -> Quad:
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2 * (wide, tall)
    return corners + (x, y) + rng.uniform(-askew, askew, (4, 2)) * (wide, tall)


def _covers(alpha: Float[Tensor, "H W"], boxes: Sequence[Sequence[float]]) -> bool:
    """Tell whether more than a tenth of any box is hidden."""
    height, width = alpha.shape
    for x0, y0, x1, y1 in boxes:
        part = alpha[max(0, int(y0)) : min(height, int(y1) + 1), max(0, int(x0)) : min(width, int(x1) + 1)]
        if part.numel() and float(part.mean()) > 0.1:
            return True
    return False


def _layer(quad: Quad, height: int, width: int) -> Layer:
    """Map a quad of cloth, as far as the picture shows it."""
    low, high = np.floor(quad.min(0)), np.ceil(quad.max(0))
    (left, top), (right, bottom) = np.clip([low, high], 0, (width, height)).astype(int)
    y, x = np.mgrid[top + 0.5 : bottom, left + 0.5 : right]
    projection = np.append(perspective(np.array(quad, float), UNIT_SQUARE), 1).reshape(3, 3)
    mapped = np.stack([x, y, np.ones_like(x)], -1) @ projection.T
    place = torch.from_numpy(mapped[..., :2] / np.where(mapped[..., 2:] > 1e-6, mapped[..., 2:], np.nan))
    alpha = ((place >= 0) & (place <= 1)).all(-1).float()
    return Layer((slice(top, bottom), slice(left, right)), alpha, place.float() * 2 - 1)


def _dummy(silhouette: Float[Tensor, "H W"]) -> Layer:
    """Cut a body without head and lower legs: a garment on a dummy, cut of a cloth over the whole picture."""
    height, width = silhouette.shape
    whole = _layer(np.array([[0, 0], [width, 0], [width, height], [0, height]], float), height, width)
    rows = torch.nonzero(silhouette.amax(1) > 0.5).flatten()
    if not len(rows):
        return replace(whole, alpha=silhouette)
    top, tall = int(rows[0]), int(rows[-1] - rows[0]) + 1
    mask = torch.zeros_like(silhouette)
    shown = slice(top + round(0.17 * tall), top + round(0.62 * tall))
    mask[shown] = silhouette[shown]
    return replace(whole, alpha=mask)


def _folds(rng: np.random.Generator, height: int, width: int) -> Float[Tensor, "H W"]:
    """Draw light and dark of hanging cloth: a few vertical waves, or none."""
    if rng.random() < 0.4:
        return torch.ones(height, width)
    x = np.arange(width) / width
    wave = sum(np.sin(2 * np.pi * (rng.uniform(2, 14) * x + rng.random())) for _ in range(3)) / 3
    return torch.from_numpy(np.broadcast_to(1 + 0.25 * wave, (height, width)).astype(np.float32).copy())


def _shading(picture: Float[Tensor, "3 H W"], rng: np.random.Generator) -> Float[Tensor, "H W"]:
    """Measure the picture's own light on the cloth, in half of the cases: its luminance over its mean."""
    if rng.random() < 0.5:
        return torch.ones(picture.shape[1:])
    luminance = picture.mean(0)
    return (luminance / luminance.mean().clamp(min=0.05)).clamp(0.6, 1.4)
