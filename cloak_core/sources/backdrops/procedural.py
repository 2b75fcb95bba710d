"""Procedural scenes without people: landscapes, woods, streets, rooms, walls, halls and still lifes.

Each scene is a handful of textured quads under a pinhole camera, painted from far to near; together they are varied
enough to train and test on where no photographs are at hand. A scene depends only on the generator's state and the
size, and takes around ten milliseconds at 416 x 416.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageChops, ImageDraw, ImageFilter

from cloak_core.sources.backdrops import procedural_tiles as tiles
from cloak_core.sources.backdrops.procedural_canvas import NEAR, Number, SceneCanvas, Span
from cloak_core.sources.backdrops.procedural_tiles import Color, Rng, random_color, shade


def draw_scene(rng: Rng, height: int, width: int) -> UInt8[np.ndarray, "H W 3"]:
    """Draw one scene as sRGB bytes."""
    canvas = SceneCanvas(rng, height, width)
    kinds = (_landscape, _wood, _street, _room, _wall, _hall, _still_life)
    kinds[rng.integers(len(kinds))](rng, canvas)
    return _photograph(rng, canvas.image)


# --- the scenes ------------------------------------------------------------------------------------------------------


def _sky(rng: Rng, canvas: SceneCanvas) -> Color:
    """Clear, cloudy, overcast or dusk; returns the colour at the horizon."""
    top = random_color(rng, (0.52, 0.66), (0.05, 0.75), (0.35, 1))
    pale = rng.random() < 0.7
    low = random_color(rng, (0.5, 0.65), (0, 0.25), (0.7, 1)) if pale else random_color(rng, (-0.05, 0.15))
    sky = tiles.vertical_gradient(top, low, canvas.height, canvas.width)
    if rng.random() < 0.6:
        field = tiles.fractal(rng, canvas.height // 4, canvas.width // 4, rng.uniform(1.5, 5), 4)
        field = field + rng.uniform(-0.8, 0.6)
        mask = Image.fromarray((field * 160).clip(0, 235).astype(np.uint8)).resize(sky.size, Image.Resampling.BILINEAR)
        sky.paste(shade(low, rng.uniform(0.8, 1.2)), (0, 0), mask)
    canvas.image.paste(sky)
    return low


def _ridges(rng: Rng, canvas: SceneCanvas, haze: Color) -> None:
    """Draw hills or mountains, paler the farther they are."""
    draw = ImageDraw.Draw(canvas.image)
    near = random_color(rng, (0.2, 0.65), (0.1, 0.6), (0.1, 0.5))
    count = int(rng.integers(1, 5))
    for i in range(count):
        t = (i + 1) / (count + 0.5)
        color = tuple(int(h * (1 - t) + n * t) for h, n in zip(haze, near, strict=True))
        profile = tiles.fractal(rng, 2, canvas.width // 3, rng.uniform(1.5, 8), 5, 0.5)[0]
        lift = canvas.height * rng.uniform(0.02, 0.12) * (count - i + 1) / count
        ys = canvas.horizon - lift * (1 + profile * rng.uniform(0.3, 0.8))
        outline = [(3.2 * x, float(y)) for x, y in enumerate(ys)]
        draw.polygon([(0, canvas.height), *outline, (canvas.width + 9, canvas.height)], fill=color)


def _tree(rng: Rng, canvas: SceneCanvas, x: float, z: float, leaves: Image.Image) -> None:
    height = rng.uniform(2.5, 9)
    bark = tiles.rough(rng, random_color(rng, (0.03, 0.12), (0.1, 0.5), (0.12, 0.6)), (24, 96), 0.4)
    canvas.upright(x, z, height * rng.uniform(0.03, 0.08), height * 0.8, bark)
    for _ in range(rng.integers(1, 5)):
        spread = height * rng.uniform(0.12, 0.3)
        canvas.blob(x + rng.normal(0, spread * 0.6), height * rng.uniform(0.65, 1), z, spread, leaves, rng)


def _landscape(rng: Rng, canvas: SceneCanvas) -> None:
    """Draw a meadow, desert, beach, snow or water under the sky."""
    haze = _sky(rng, canvas)
    if rng.random() < 0.7:
        _ridges(rng, canvas, haze)
    hue, saturation, value = [
        ((0.17, 0.36), (0.3, 0.7), (0.25, 0.7)),
        ((0.06, 0.13), (0.2, 0.6), (0.4, 0.9)),
        ((0.5, 0.62), (0.1, 0.7), (0.2, 0.8)),
        ((0.5, 0.7), (0, 0.1), (0.7, 1)),
    ][rng.integers(4)]
    canvas.ground(tiles.rough(rng, random_color(rng, hue, saturation, value), (256, 256), 0.45), rng.uniform(2, 8))
    if rng.random() < 0.35:
        path = tiles.rough(rng, random_color(rng, (0.05, 0.13), (0.05, 0.4), (0.4, 0.8)))
        x, far = rng.uniform(-2, 2), rng.uniform(-15, 15)
        canvas.quad(((far, 0, 60), (far + 2, 0, 60), (x + 1, 0, 0.8), (x - 1, 0, 0.8)), path)
    leaves = tiles.foliage(rng, 64, 64)
    for z in sorted(rng.uniform(4, 45, rng.integers(0, 9)), reverse=True):
        _tree(rng, canvas, rng.uniform(-0.7, 0.7) * z, z, leaves)
    for z in sorted(rng.uniform(2.5, 18, rng.integers(0, 5)), reverse=True):
        _thing(rng, canvas, rng.uniform(-0.5, 0.5) * z, z)


def _wood(rng: Rng, canvas: SceneCanvas) -> None:
    """Draw leaves all around, trunks from far to near."""
    hue = (0.16, 0.42) if rng.random() < 0.75 else (0.02, 0.16)
    leaves = tiles.foliage(rng, canvas.height // 2, canvas.width // 2, hue)
    canvas.image.paste(leaves.resize((canvas.width, canvas.height), Image.Resampling.BILINEAR))
    floor = random_color(rng, (0.04, 0.35), (0.15, 0.6), (0.15, 0.6))
    canvas.ground(tiles.rough(rng, floor, (256, 256), 0.6), rng.uniform(1.5, 4))
    bark_color = random_color(rng, (0.02, 0.13), (0.05, 0.5), (0.1, 0.7))
    for z in sorted(rng.uniform(2, 22, rng.integers(4, 22)), reverse=True):
        bark = tiles.rough(rng, shade(bark_color, rng.uniform(0.6, 1.2)), (20, 120), 0.5)
        x = rng.uniform(-0.75, 0.75) * z
        lean = rng.normal(0, 0.25)
        width = rng.uniform(0.12, 0.6)
        top = rng.uniform(6, 14)
        crown = ((x + lean - width / 3, top, z), (x + lean + width / 3, top, z))
        canvas.quad((*crown, (x + width / 2, 0, z), (x - width / 2, 0, z)), bark)
        if rng.random() < 0.3:
            canvas.blob(x, rng.uniform(0, 4), z, rng.uniform(0.3, 1.2), leaves, rng)


def _street(rng: Rng, canvas: SceneCanvas) -> None:
    """Draw a road between facades, with lamps, signs, parked boxes of cars and trees."""
    _sky(rng, canvas)
    canvas.ground(tiles.grid(rng, random_color(rng, saturation=(0, 0.2), value=(0.3, 0.8)), 8, 8, False), 3)
    half = rng.uniform(2, 5)
    road = tiles.rough(rng, random_color(rng, saturation=(0, 0.1), value=(0.15, 0.55)), (96, 192), 0.15)
    if rng.random() < 0.6:
        draw = ImageDraw.Draw(road)
        for y in range(0, 192, 24):
            draw.rectangle((46, y, 49, y + 12), (225, 225, 215))
    middle = rng.uniform(-2, 2)
    canvas.quad(((middle - half, 0, 70), (middle + half, 0, 70), (middle + half, 0, 1), (middle - half, 0, 1)), road)
    walk = half + rng.uniform(1, 4)
    for side in (-1, 1):
        z = rng.uniform(35, 60)
        while z > 1.5 and rng.random() < 0.95:
            length, height = rng.uniform(4, 16), rng.uniform(3, 22)
            near = max(0.8, z - length)
            x = middle + side * walk
            face = tiles.facade(rng, max(2, int(height / 3)), max(2, int(length / 2.5)))
            canvas.side(x, (near, z), (0, height), face, rng.uniform(0.6, 1.1))
            z -= length
    leaves = tiles.foliage(rng, 64, 64)
    for z in sorted(rng.uniform(3, 35, rng.integers(2, 10)), reverse=True):
        side = rng.choice([-1, 1])
        kind = rng.integers(4)
        if kind == 0:
            _tree(rng, canvas, middle + side * (half + 0.6), z, leaves)
        elif kind == 1:
            size = (rng.uniform(1.5, 2.0), rng.uniform(0.6, 1.0), rng.uniform(3, 5))
            paint = tiles.rough(rng, random_color(rng, saturation=(0, 0.9)), contrast=0.1)
            x = middle + side * rng.uniform(0.4, 0.8) * half
            canvas.box(x, z, size, paint, 0.3)
            canvas.box(x, z + 0.8, (size[0] * 0.9, 0.5, size[2] * 0.5), tiles.window(rng), size[1] + 0.3)
        else:
            _thing(rng, canvas, middle + side * (half + rng.uniform(0.2, 0.9)), z)


def _thing(rng: Rng, canvas: SceneCanvas, x: float, z: float) -> None:
    """Draw something that stands about: post, sign, lamp, bin, plant, cabinet, stack of boxes."""
    kind = rng.integers(6)
    skin = tiles.rough(rng, random_color(rng, saturation=(0, 0.9)), (32, 64), 0.15)
    if kind == 0:
        canvas.upright(x, z, rng.uniform(0.05, 0.2), rng.uniform(0.8, 5), skin)
    elif kind == 1:
        high = rng.uniform(1.5, 3)
        canvas.upright(x, z, 0.07, high, skin)
        w, h = rng.uniform(0.15, 0.6, 2)
        canvas.panel((x - w, x + w), (high - h, high + h), z, tiles.poster(rng))
    elif kind == 2:
        high = rng.uniform(1.2, 4)
        canvas.upright(x, z, 0.06, high, skin)
        radius = rng.uniform(0.1, 0.3)
        canvas.blob(x, high, z, radius, tiles.rough(rng, random_color(rng, (0, 0.2), (0, 0.6), (0.6, 1))), rng)
    elif kind == 3:
        canvas.box(x, z, tuple(rng.uniform((0.25, 0.3, 0.2), (0.8, 2.1, 0.8)).tolist()), skin)
    elif kind == 4:
        pot = rng.uniform(0.2, 0.5)
        canvas.upright(x, z, pot, pot, skin)
        for _ in range(3):
            spread = rng.uniform(0.15, 0.45)
            canvas.blob(x + rng.normal(0, 0.15), pot + rng.uniform(0, 1), z, spread, tiles.foliage(rng, 40, 40), rng)
    else:
        base = 0.0
        for _ in range(rng.integers(2, 5)):
            size = rng.uniform(0.25, 0.7, 3).tolist()
            color = random_color(rng, saturation=(0, 0.8))
            canvas.box(x + rng.normal(0, 0.05), z, tuple(size), tiles.rough(rng, color, (32, 32), 0.1), base)
            base += size[1]


def _room(rng: Rng, canvas: SceneCanvas) -> None:
    """Draw a room seen from within: walls with windows, doors and pictures, and furniture."""
    half, height, back = rng.uniform(1.5, 4), rng.uniform(2.3, 3.6), rng.uniform(3, 9)
    canvas.ground(tiles.floor(rng), rng.uniform(0.8, 3))
    white = tiles.rough(rng, random_color(rng, saturation=(0, 0.15), value=(0.6, 1)), contrast=0.05)
    canvas.ground(white, 3, ceiling=height)
    wall = tiles.surface(rng)
    lights = rng.uniform(0.6, 1.1, 3)
    shift = rng.uniform(-1, 1)
    left, right = shift - half, shift + half
    canvas.panel((left, right), (0, height), back, wall, lights[0])
    side = wall if rng.random() < 0.7 else tiles.surface(rng)
    canvas.side(left, (NEAR, back), (0, height), side, lights[1])
    canvas.side(right, (NEAR, back), (0, height), side, lights[2])
    _hang(rng, canvas, (left, right), height, back - 0.01)
    for x in (left + 0.01, right - 0.01):
        if rng.random() < 0.6:
            z, wide = rng.uniform(1.2, back - 1), rng.uniform(0.6, 1.5)
            high = rng.uniform(1.7, 2.2)
            low, picture = (0, tiles.door(rng)) if rng.random() < 0.4 else (rng.uniform(0.6, 1.2), tiles.window(rng))
            canvas.side(x, (z, z + wide), (low, high), picture)
    for z in sorted(rng.uniform(1.6, back - 0.4, rng.integers(1, 7)), reverse=True):
        x = rng.uniform(left + 0.3, right - 0.3)
        if rng.random() < 0.4:
            _thing(rng, canvas, x, z)
        else:
            _furniture(rng, canvas, x, z)


def _hang(rng: Rng, canvas: SceneCanvas, span: Span, height: Number, z: float) -> None:
    """Draw windows, doors, pictures and shelves on a wall that faces the camera."""
    x = span[0] + rng.uniform(0.1, 0.8)
    while x < span[1] - 0.5:
        kind = rng.integers(5)
        wide = rng.uniform(0.4, 1.4)
        if kind == 0:
            low = 0.0
            high = min(height - 0.1, 2.05)
            picture = tiles.door(rng)
            wide = 0.9
        elif kind == 1:
            low = rng.uniform(0.4, 1.1)
            high = min(height - 0.1, rng.uniform(1.7, 2.4))
            picture = tiles.window(rng)
        elif kind == 2:
            low = rng.uniform(0.9, 1.5)
            picture = tiles.poster(rng)
            high = low + rng.uniform(0.3, 0.9)
        elif kind == 3:
            low, high = rng.uniform(0, 1.0), rng.uniform(1.4, 2.2)
            picture = tiles.shelf(rng)
        else:
            low = 0.0
            high = min(height - 0.05, 2.5)
            picture = tiles.stripes(rng)
            wide *= 0.5
        canvas.panel((x, x + wide), (low, high), z, picture)
        x += wide + rng.uniform(0.1, 2)


def _furniture(rng: Rng, canvas: SceneCanvas, x: float, z: float) -> None:
    """Draw a table, a sofa, a chair or a cupboard, as boxes."""
    cover = tiles.rough(rng, random_color(rng, saturation=(0, 0.8)), (48, 48), 0.12)
    kind = rng.integers(3)
    wide, deep = rng.uniform(0.4, 2), rng.uniform(0.4, 0.9)
    if kind == 0:
        top = rng.uniform(0.4, 1)
        for dx in (-wide / 2 + 0.05, wide / 2 - 0.05):
            for dz in (deep - 0.06, 0):
                canvas.box(x + dx, z + dz, (0.06, top, 0.06), cover)
        canvas.box(x, z, (wide, 0.06, deep), cover, top)
        for _ in range(rng.integers(0, 4)):
            size = tuple(rng.uniform(0.06, 0.3, 3).tolist())
            at = x + rng.uniform(-0.4, 0.4) * wide
            canvas.box(at, z, size, tiles.rough(rng, random_color(rng), (16, 16)), top + 0.06)
    elif kind == 1:
        canvas.box(x, z + deep, (wide, rng.uniform(0.7, 1.1), 0.2), cover)
        canvas.box(x, z, (wide, 0.42, deep), cover)
        for dx in (-wide / 2, wide / 2):
            canvas.box(x + dx, z, (0.15, 0.6, deep), cover)
    else:
        front = tiles.shelf(rng) if rng.random() < 0.5 else tiles.door(rng)
        canvas.box(x, z, (wide, rng.uniform(0.7, 2.2), deep * 0.6), front)


def _wall(rng: Rng, canvas: SceneCanvas) -> None:
    """Draw one wall, straight ahead, with a strip of floor before it."""
    z = rng.uniform(2, 7)
    half = 0.75 * canvas.width / canvas.focal * z
    height = rng.uniform(3, 9)
    canvas.image.paste(random_color(rng, saturation=(0, 0.3), value=(0.6, 1)), (0, 0, canvas.width, canvas.height))
    turn = rng.uniform(-0.25, 0.25) * half
    wall = tiles.surface(rng)
    canvas.ground(tiles.floor(rng), rng.uniform(1, 3))
    ends = ((-half, height, z + turn), (half, height, z - turn), (half, 0, z - turn), (-half, 0, z + turn))
    canvas.quad(ends, wall)
    if abs(turn) < 0.15:
        _hang(rng, canvas, (-half, half), min(height, 3), z - abs(turn) - 0.02)
    for _ in range(rng.integers(0, 5)):
        near = z * rng.uniform(0.5, 0.95)
        (_thing if rng.random() < 0.6 else _furniture)(rng, canvas, rng.uniform(-0.6, 0.6) * half, near)


def _hall(rng: Rng, canvas: SceneCanvas) -> None:
    """Draw a corridor, arcade or store: columns or racks on both sides that run into the distance."""
    canvas.ground(tiles.floor(rng), rng.uniform(1, 3))
    height = rng.uniform(2.6, 7)
    canvas.ground(tiles.surface(rng), rng.uniform(2, 5), rng.uniform(0.4, 0.9), ceiling=height)
    half, back = rng.uniform(1.5, 5), rng.uniform(9, 30)
    end = tiles.surface(rng)
    canvas.panel((-half, half), (0, height), back, end, 0.8)
    side = tiles.shelf(rng) if rng.random() < 0.4 else tiles.surface(rng)
    step, width = rng.uniform(1.2, 4), rng.uniform(0.2, 0.9)
    front = tiles.shelf(rng) if rng.random() < 0.3 else tiles.surface(rng)
    for x in (-half, half):
        canvas.side(x, (NEAR, back), (0, height), side, rng.uniform(0.5, 1))
    for z in np.arange(back - 1, 1.5, -step):
        for x in (-half, half):
            canvas.box(x, float(z), (width, height, width), front)
    for z in sorted(rng.uniform(2, back, rng.integers(0, 5)), reverse=True):
        _thing(rng, canvas, rng.uniform(-0.8, 0.8) * half, z)


def _still_life(rng: Rng, canvas: SceneCanvas) -> None:
    """Draw near things on a table or against a wall: boxes, discs, bottles, cloth."""
    back = tiles.surface(rng).resize((canvas.width, canvas.height), Image.Resampling.BILINEAR)
    canvas.image.paste(back)
    draw = ImageDraw.Draw(canvas.image)
    edge = int(canvas.height * rng.uniform(0.5, 1.0))
    draw.rectangle((0, edge, canvas.width, canvas.height), random_color(rng, (0.02, 0.14), (0.1, 0.6), (0.2, 0.9)))
    for _ in range(rng.integers(3, 22)):
        x = rng.uniform(0, canvas.width)
        y = rng.uniform(0.3, 1.05) * canvas.height
        w, h = canvas.height * rng.uniform(0.02, 0.28), canvas.height * rng.uniform(0.03, 0.55)
        color = random_color(rng, saturation=(0, 1), value=(0.05, 1))
        kind = rng.integers(4)
        if kind == 0:
            draw.ellipse((x - w / 2, y - w / 2, x + w / 2, y + w / 2), color, shade(color, 0.7))
        elif kind == 1:
            patch = tiles.rough(rng, color, (48, 48), rng.uniform(0.05, 0.4)).resize((max(1, int(w)), max(1, int(h))))
            canvas.image.paste(patch, (int(x - w / 2), int(y - h)))
        elif kind == 2:
            draw.rectangle((x - w / 2, y - h, x + w / 2, y), color)
            draw.rectangle((x - w / 6, y - 1.3 * h, x + w / 6, y - h), shade(color, 0.8))
            draw.rectangle((x - w / 2, y - 0.7 * h, x - w / 3, y), shade(color, 1.3))
        else:
            points = rng.normal((x, y), (w, h / 2), (int(rng.integers(3, 7)), 2))
            draw.polygon([tuple(p) for p in points.tolist()], color)


# --- the photograph --------------------------------------------------------------------------------------------------


def _photograph(rng: Rng, image: Image.Image) -> UInt8[np.ndarray, "H W 3"]:
    """Add exposure, tint, a shadow's fall-off, softness and grain."""
    if rng.random() < 0.5:
        image = image.transpose(Image.Transpose.FLIP_LEFT_RIGHT)
    if rng.random() < 0.35:
        image = image.filter(ImageFilter.BoxBlur(rng.uniform(0.4, 1.6)))
    gamma, gain, tint = rng.uniform(0.55, 1.3), rng.uniform(0.8, 1.2), rng.uniform(0.9, 1.1, 3)
    ramp = np.linspace(0, 1, 256) ** gamma * gain * 255
    image = image.point(np.minimum(ramp * tint[:, None], 255).astype(int).reshape(-1).tolist())
    shadow = Image.fromarray(rng.uniform(185, 256, (3, 3)).astype(np.uint8)).resize(image.size)
    image = ImageChops.multiply(image, Image.merge("RGB", (shadow,) * 3))
    grain = (128 + rng.normal(0, rng.uniform(0, 5), (64, 64))).clip(0, 255).astype(np.uint8)
    grain = np.tile(grain, (image.height // 64 + 1, image.width // 64 + 1))[: image.height, : image.width]
    return np.array(ImageChops.add(image, Image.merge("RGB", (Image.fromarray(grain),) * 3), 1, -128))
