"""Surfaces for the procedural scenes: small RGB pictures of brick, planks, facades, foliage and the like.

Every function draws from the random generator it is given and from nothing else.
"""

from __future__ import annotations

import colorsys

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw

Rng = np.random.Generator
Color = tuple[int, int, int]
Range = tuple[float | int, float | int]


def random_color(rng: Rng, hue: Range = (0, 1), saturation: Range = (0.05, 0.6), value: Range = (0.2, 0.95)) -> Color:
    """Draw an 8-bit colour with hue, saturation and value drawn uniformly (hue wraps around at 1)."""
    red, green, blue = colorsys.hsv_to_rgb(rng.uniform(*hue) % 1, rng.uniform(*saturation), rng.uniform(*value))
    return int(red * 255), int(green * 255), int(blue * 255)


def shade(color: Color, factor: float) -> Color:
    """Multiply the colour by `factor`, clipped."""
    return tuple(int(min(255, max(0, c * factor))) for c in color)


def fractal(
    rng: Rng, height: int, width: int, cells: float | int = 4, octaves: int = 4, falloff: float = 0.55
) -> Float[np.ndarray, "H W"]:
    """Smooth noise of about zero mean and unit size: `cells` bumps across, each octave twice as fine and `falloff` as
    strong."""
    total = np.zeros((height, width), np.float32)
    for octave in range(octaves):
        n = cells * 2**octave
        rows, columns = max(2, min(height, round(n * height / width) + 1)), max(2, min(width, round(n) + 1))
        grid = Image.fromarray(rng.standard_normal((rows, columns), dtype=np.float32))
        total += falloff**octave * np.asarray(grid.resize((width, height), Image.Resampling.BICUBIC))
    return total


def blend(field: Float[np.ndarray, "H W"], dark: Color, light: Color) -> Image.Image:
    """Turn the field, clipped to [-1, 1], into an image from `dark` to `light`."""
    t = (field.clip(-1, 1)[..., None] + 1) / 2
    pixels = np.asarray(dark, np.float32) * (1 - t) + np.asarray(light, np.float32) * t
    return Image.fromarray(pixels.astype(np.uint8))


def rough(rng: Rng, color: Color, size: tuple[int, int] = (96, 96), contrast: float = 0.25) -> Image.Image:
    """Draw plaster, concrete, soil, grass: one colour with noise; `size` is (width, height)."""
    field = fractal(rng, size[1], size[0], cells=rng.uniform(3, size[0] / 4), octaves=3, falloff=rng.uniform(0.5, 1.1))
    return blend(field * rng.uniform(0.3, 0.8), shade(color, 1 - contrast), shade(color, 1 + contrast))


def grid(rng: Rng, color: Color, rows: int, columns: int, offset: bool) -> Image.Image:
    """Draw bricks (`offset`), tiles or planks: cells of slightly different colour with joints between them."""
    cell = max(4, 160 // max(rows, columns))
    width, height = columns * cell * (2 if offset else 1), rows * cell
    image = Image.new("RGB", (width, height), shade(color, rng.uniform(0.5, 1.3)))
    draw = ImageDraw.Draw(image)
    step = width // columns
    variation = rng.uniform(0.03, 0.25)
    factors = rng.normal(1, variation, (rows, columns + 1))
    for row in range(rows):
        start = -(step // 2) if offset and row % 2 else 0
        for column in range(columns + 1):
            x = start + column * step
            draw.rectangle((x, row * cell, x + step - 2, row * cell + cell - 2), shade(color, factors[row, column]))
    return image


def stripes(rng: Rng, upright: bool = True) -> Image.Image:
    """Draw wallpaper, curtains, cladding: bands of two colours, soft or hard."""
    color = random_color(rng, saturation=(0, 0.5))
    other_color = shade(color, rng.uniform(0.5, 0.95))
    phase = np.linspace(0, 2 * np.pi * rng.integers(4, 25), 192, dtype=np.float32) + rng.normal(0, 0.4, 192)
    wave = np.sin(phase) * rng.choice([1, 5])
    field = np.broadcast_to(wave.clip(-1, 1).astype(np.float32), (96, 192))
    return blend(field if upright else np.ascontiguousarray(field.T), other_color, color)


def foliage(rng: Rng, height: int, width: int, hue: Range = (0.16, 0.42)) -> Image.Image:
    """Draw leaves: clumps in light and shadow, with speckle as fine as the pixels."""
    field = fractal(rng, height, width, cells=rng.uniform(3, 9), octaves=5, falloff=rng.uniform(0.65, 0.95))
    dark, light = random_color(rng, hue, (0.3, 0.8), (0.05, 0.25)), random_color(rng, hue, (0.25, 0.8), (0.4, 0.85))
    return blend(field * 0.6 + rng.uniform(-0.3, 0.2), dark, light)


def window(rng: Rng) -> Image.Image:
    """Draw a framed window: panes with sky, dark room or garden behind."""
    width, height = 60, 80
    frame = random_color(rng, saturation=(0, 0.3), value=(0.2, 1))
    kind = rng.integers(3)
    if kind == 0:
        view = vertical_gradient(random_color(rng, (0.5, 0.65), (0.05, 0.5), (0.7, 1)), (235, 240, 245), height, width)
    elif kind == 1:
        view = rough(rng, random_color(rng, (0.5, 0.7), (0.1, 0.4), (0.08, 0.4)), (width, height))
    else:
        view = foliage(rng, height, width)
    draw = ImageDraw.Draw(view)
    thick = int(rng.integers(2, 6))
    for i in range(int(rng.integers(1, 4)) + 1):
        x = i * (width - thick) // max(1, rng.integers(1, 4))
        draw.rectangle((x, 0, x + thick, height), frame)
    for y in np.linspace(0, height - thick, rng.integers(2, 5)):
        draw.rectangle((0, int(y), width, int(y) + thick), frame)
    draw.rectangle((0, 0, width - 1, height - 1), outline=frame, width=thick)
    return view


def door(rng: Rng) -> Image.Image:
    """Draw a door with panels and a knob."""
    width, height = 48, 104
    color = random_color(rng, saturation=(0, 0.6), value=(0.15, 0.95))
    image = rough(rng, color, (width, height), 0.1)
    draw = ImageDraw.Draw(image)
    draw.rectangle((0, 0, width - 1, height - 1), outline=shade(color, rng.uniform(0.4, 1.4)), width=4)
    rows = int(rng.integers(1, 5))
    for row in range(rows):
        top, bottom = 10 + row * (height - 14) // rows, 2 + (row + 1) * (height - 14) // rows
        draw.rectangle((10, top, width - 11, bottom), shade(color, rng.uniform(0.7, 1.2)), shade(color, 0.6), 2)
    draw.ellipse((width - 9, height // 2, width - 4, height // 2 + 5), (200, 180, 90))
    return image


def poster(rng: Rng) -> Image.Image:
    """Draw a picture on the wall: blocks, discs and lines of any colour in a frame."""
    width, height = (int(v) for v in rng.integers(50, 120, 2))
    image = rough(rng, random_color(rng, saturation=(0, 0.9)), (width, height))
    draw = ImageDraw.Draw(image)
    for _ in range(rng.integers(2, 9)):
        x0, x1 = np.sort(rng.integers(0, width, 2)).tolist()
        y0, y1 = np.sort(rng.integers(0, height, 2)).tolist()
        shape = (draw.rectangle, draw.ellipse, draw.line)[rng.integers(3)]
        shape((x0, y0, x1, y1), random_color(rng, saturation=(0, 1), value=(0, 1)))
    if rng.random() < 0.7:
        draw.rectangle((0, 0, width - 1, height - 1), outline=random_color(rng), width=int(rng.integers(2, 7)))
    return image


def shelf(rng: Rng) -> Image.Image:
    """Draw shelves of books, boxes and bottles."""
    image = Image.new("RGB", (120, 128), random_color(rng, (0.03, 0.12), (0.2, 0.6), (0.1, 0.6)))
    draw = ImageDraw.Draw(image)
    saturation = rng.uniform(0.1, 0.9)
    for bottom in np.linspace(0, 128, rng.integers(3, 7))[1:]:
        x = 3
        while x < 114:
            width, tall = int(rng.integers(3, 15)), int(rng.integers(10, 24))
            if rng.random() < 0.85:
                draw.rectangle(
                    (x, int(bottom) - 4 - tall, x + width - 1, int(bottom) - 4),
                    random_color(rng, saturation=(0, saturation)),
                )
            x += width
    return image


def facade(rng: Rng, rows: int, columns: int) -> Image.Image:
    """Draw the face of a building: rows of one kind of window, perhaps a shop front at the bottom."""
    color = random_color(rng, saturation=(0, 0.45), value=(0.25, 0.95))
    cell_w, cell_h = (int(v) for v in rng.integers(16, 30, 2))
    wall = rough(rng, color, (columns * cell_w, rows * cell_h), 0.12)
    pane = window(rng).resize((int(cell_w * rng.uniform(0.35, 0.8)), int(cell_h * rng.uniform(0.4, 0.8))))
    for row in range(rows):
        for column in range(columns):
            wall.paste(pane, (column * cell_w + cell_w // 5, row * cell_h + cell_h // 6))
    if rng.random() < 0.5:
        front = Image.new("RGB", (wall.width, cell_h), shade(color, rng.uniform(0.3, 0.8)))
        draw = ImageDraw.Draw(front)
        for x in range(2, wall.width, int(rng.integers(20, 40))):
            draw.rectangle((x, 5, x + int(rng.integers(8, 20)), cell_h), random_color(rng, value=(0.05, 0.9)))
        wall.paste(front, (0, (rows - 1) * cell_h))
    return wall


def vertical_gradient(top: Color, bottom: Color, height: int, width: int) -> Image.Image:
    """Blend from `top` to `bottom`."""
    t = np.linspace(0, 1, height, dtype=np.float32)[:, None]
    column = np.asarray(top, np.float32) * (1 - t) + np.asarray(bottom, np.float32) * t
    return Image.fromarray(np.repeat(column[:, None].astype(np.uint8), width, 1))


def surface(rng: Rng) -> Image.Image:
    """Choose something that a wall is covered with."""
    kind = rng.integers(5)
    color = random_color(rng, saturation=(0, 0.45), value=(0.3, 1))
    if kind == 0:
        return grid(rng, color, int(rng.integers(6, 26)), int(rng.integers(3, 10)), True)
    if kind == 1:
        return grid(rng, color, int(rng.integers(1, 12)), int(rng.integers(1, 12)), False)
    if kind == 2:
        return stripes(rng, bool(rng.random() < 0.7))
    return rough(rng, color, (160, 96), rng.uniform(0.02, 0.3))


def floor(rng: Rng) -> Image.Image:
    """Choose something that a floor is covered with: squares of two colours, planks, or one colour."""
    kind = rng.integers(3)
    if kind == 0:
        color = random_color(rng, saturation=(0, 0.5))
        other_color = shade(color, rng.uniform(0.4, 0.8)) if rng.random() < 0.6 else random_color(rng)
        cells = rng.integers(2, 7)
        pattern = np.indices((cells, cells)).sum(0)[..., None] % 2
        small = Image.fromarray(np.where(pattern, color, other_color).astype(np.uint8))
        return small.resize((cells * 16, cells * 16), Image.Resampling.NEAREST)
    color = random_color(rng, (0.02, 0.14), (0.05, 0.6), (0.2, 0.9))
    if kind == 1:
        return grid(rng, color, int(rng.integers(3, 10)), int(rng.integers(1, 8)), bool(rng.random() < 0.5))
    return rough(rng, color, contrast=0.2)
