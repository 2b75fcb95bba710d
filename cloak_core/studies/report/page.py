"""Build pages from templates: HTML that opens offline, every picture and plot inside and no script."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path

import jinja2
from markupsafe import Markup
from matplotlib.figure import Figure
from PIL import Image

from cloak_core.files.reading import MAX_TEXT_BYTES, read_bytes, read_text
from cloak_core.files.writing import write_text
from cloak_core.studies.report import words
from cloak_core.studies.report.style import CSS_COLORS, SERIES, style

TEMPLATES = Path(__file__).parent / "templates"
MAX_PICTURE = 16 << 20
"""Bytes; larger picture files are left out."""


def write_page(path: Path, template: str, values: Mapping[str, object]) -> Path:
    """Render a template of `TEMPLATES` with these values into the file `path`; return it.

    The template also gets `css`, the style of all pages. What is put into HTML is escaped unless it is Markup.
    """
    css = Markup(read_text(TEMPLATES / "style.css", MAX_TEXT_BYTES))  # our own file, nothing of the user's
    text = _environment().get_template(template).render({"css": css} | dict(values))
    write_text(path, text.rstrip() + "\n")
    return path


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=jinja2.select_autoescape(("html",)),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    filters = (words.percent, words.interval, words.degrees, words.short_name, words.duration, words.instead)
    filters += (words.most_named, words.plain, inside, boxed)
    environment.filters |= {write.__name__: write for write in filters}
    environment.filters["record"] = lambda value: value if isinstance(value, dict) else {}
    environment.filters["control_label"] = lambda name: SERIES[name]["label"] if name in SERIES else name
    return environment


def figures(draw: Callable[..., Mapping[str, Figure | None]], *shown: object) -> dict[str, Markup]:
    """Draw figures for a page: <svg> elements by name, whose text stays text in the page's font.

    Every colour of the style becomes a CSS variable (--ink, --faint, --c0 ...), so the page decides light and dark.
    Matplotlib escapes the text that it draws.
    """
    with style(**{"svg.fonttype": "none"}):
        return {name: _svg(figure) for name, figure in draw(*shown).items() if figure is not None}


def _svg(figure: Figure) -> Markup:
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r'<svg ([^>]*?)width="[^"]*" ([^>]*?)height="[^"]*"', r"<svg \1\2", text, count=1)
    text = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", text, count=1, flags=re.S)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r"'DejaVu Sans'(, '[^']*')*(, sans-serif)?", "var(--font)", text)
    for color, variable in CSS_COLORS.items():
        text = text.replace(color, f"var({variable})")
    return Markup(text)


# --- pictures, inside the page


def data_uri(path: Path) -> str:
    """Read a picture file as a data: address. InputError where it is missing or larger than `MAX_PICTURE`."""
    data = read_bytes(path, MAX_PICTURE)
    kind = {".jpg": "jpeg", ".png": "png", ".gif": "gif"}.get(path.suffix, "png")
    return _encoded(data, kind)


def jpeg_uri(picture: Image.Image, quality: int) -> str:
    """Encode a picture as JPEG in a data: address."""
    data = io.BytesIO()
    picture.save(data, "JPEG", quality=quality)
    return _encoded(data.getvalue(), "jpeg")


def _encoded(data: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def inside(name: str, folder: Path) -> str:
    """Read a picture of a folder as a data: address; no name leads out of it. InputError: see `data_uri`."""
    return data_uri(folder / Path(name).name)


def boxed(picture: Mapping, folder: Path, specs: Sequence[str]) -> dict:
    """Prepare a picture that `pictures.Drawing` wrote into a folder, with these detectors' boxes, for `framed`."""
    boxes = [box(d, b[:4], b[4]) for d, spec in enumerate(specs) for b in picture["boxes"].get(spec, [])]
    return {"image": inside(picture["file"], folder), "boxes": boxes}


def box(detector: int, corners: Sequence[float], score: float) -> dict:
    """Prepare a box (x1, y1, x2, y2) of the detector with this number for the template."""
    x1, y1, x2, y2 = corners
    return {"d": detector, "x": x1, "y": y1, "w": max(x2 - x1, 0), "h": max(y2 - y1, 0), "score": f"{score:.2f}"}
