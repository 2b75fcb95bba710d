"""Contact sheets: pictures of an evaluation side by side, boxes drawn, for the README and for papers."""

from __future__ import annotations

from pathlib import Path

from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from cloak_core.evaluate.controls import CLOTHING, LOGO
from cloak_core.evaluate.evaluation_folder import FOLDER, read_evaluation
from cloak_core.evaluate.figures import SERIES
from cloak_core.files.errors import InputError
from cloak_core.scene.pictures import read_picture, save_picture

BOX, INK, SOFT, PAPER = (224, 52, 28), (31, 35, 40), (89, 99, 110), (255, 255, 255)
GAP, MARGIN, HEAD, FOOT = 10, 24, 34, 30


def contact_sheet(run: Path, out: Path, *, body: int = 0, detector: str | None = None, side: int = 300) -> Path:
    """Write a sheet of one body of a run's gallery: own clothing above, trained colours below, one column per angle.

    `body` counts the gallery's bodies, `detector` is the spec whose boxes are drawn (default: the first), `side` the
    width of a picture in pixels. InputError where the run has no such thing.
    """
    stored = read_evaluation(run / FOLDER)
    specs = list(stored.summary["detectors"])
    spec = specs[0] if detector is None else detector
    if spec not in specs:
        raise InputError(f"{run}: was not evaluated with detector {spec} (but with {', '.join(specs)})")
    names = list(dict.fromkeys(shot["body"] for shot in stored.pictures["gallery"]))
    if not 0 <= body < len(names):
        raise InputError(f"{run}: its gallery shows {len(names)} bodies, there is no body {body}")
    shots = [shot for shot in stored.pictures["gallery"] if shot["body"] == names[body]]
    rows = [(SERIES[control].label, [shot[control] for shot in shots]) for control in (CLOTHING, LOGO)]
    heads = [f"{shot['angle']:g}°".replace("-", "\N{MINUS SIGN}") for shot in shots]
    sheet = draw_sheet(stored.folder / "pictures", spec, heads, rows, side)
    out.parent.mkdir(parents=True, exist_ok=True)
    save_picture(out, sheet, optimize=True)
    return out


def draw_sheet(folder: Path, spec: str, heads: list[str], rows: list[tuple[str, list[dict]]], side: int) -> Image.Image:
    """Named rows of pictures (files in `folder`) under column heads, what the detector found in each written below."""
    label = max(int(font(18, bold=True).getlength(name)) for name, _ in rows) + 2 * GAP
    width = MARGIN * 2 + label + len(heads) * (side + GAP) - GAP
    height = MARGIN + HEAD + len(rows) * (side + FOOT + GAP) + MARGIN - GAP
    sheet = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(sheet)
    left = MARGIN + label
    for k, head in enumerate(heads):
        draw.text((left + k * (side + GAP) + side / 2, MARGIN + HEAD / 2), head, SOFT, font(18), anchor="mm")
    for r, (name, pictures) in enumerate(rows):
        top = MARGIN + HEAD + r * (side + FOOT + GAP)
        draw.text((MARGIN, top + side / 2), name, INK, font(18, bold=True), anchor="lm")
        for k, picture in enumerate(pictures):
            x = left + k * (side + GAP)
            sheet.paste(boxed(folder, picture, spec, side), (x, top))
            found = bool(picture["boxes"].get(spec))
            text = (
                f"person {picture['scores'][spec]:.2f}" if found else f"no person (best {picture['scores'][spec]:.2f})"
            )
            draw.text((x, top + side + 4), text, BOX if found else SOFT, font(15), anchor="la")
    return sheet


def boxed(folder: Path, picture: dict, spec: str, side: int) -> Image.Image:
    """One picture, scaled to `side`, with the detector's boxes."""
    path = folder / Path(picture["file"]).name
    image = Image.fromarray(read_picture(path))
    scale = side / image.width
    image = image.resize((side, round(image.height * scale)), Image.Resampling.LANCZOS)
    draw = ImageDraw.Draw(image)
    for x1, y1, x2, y2, _ in picture["boxes"].get(spec, []):
        x1, y1 = max(x1 * scale, 0), max(y1 * scale, 0)
        x2, y2 = min(x2 * scale, image.width - 1), min(y2 * scale, image.height - 1)
        if x2 > x1 and y2 > y1:
            draw.rectangle((x1, y1, x2, y2), outline=BOX, width=max(2, side // 90))
    return image


def font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The figures' font, which comes with matplotlib."""
    properties = font_manager.FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal")
    return ImageFont.truetype(font_manager.findfont(properties), size)
