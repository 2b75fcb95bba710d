"""Frames as pictures: own clothing and cloak side by side, what each detector finds, and a timeline below."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cloak_core.evaluation.contact_sheet import INK, PAPER, SOFT, font
from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.figures import FAINT, SERIES
from cloak_core.evaluation.film.settings import FilmSettings
from cloak_core.evaluation.film.shooting import CONTROLS, Footage, above
from cloak_core.evaluation.film.tracking import track
from cloak_core.evaluation.inference import batches
from cloak_core.evaluation.pictures import to_pil
from cloak_core.evaluation.report.words import short_name
from cloak_core.evaluation.stage import Stage

SIDES = (CLOTHING, LOGO)
"""From left to right."""
FRAMES = ("#e0341c", "#6a3fc9", "#00795a", "#b06a00", "#0a62a8")
"""Of boxes, by detector: the report's colours."""
VERDICTS = ("not found", "only at its own threshold", "found")
Tracks = list[list[list[dict[int, int]]]]
"""By detector, control and frame of the film: index of a box -> number of its track."""
_font = lru_cache(maxsize=None)(font)


class Drawing:
    """Draws the first take's frames one after the other."""

    def __init__(self, stage: Stage, footage: Footage, settings: FilmSettings) -> None:
        self.stage, self.footage, self.settings = stage, footage, settings
        self.count = int((footage.take == 0).sum())
        self.text = max(9, settings.size // 26)
        self.gap, self.head = max(2, settings.size // 100), round(1.9 * self.text)
        self.tracks = track_numbers(footage, settings, self.count)
        self.strip = self._timeline()

    def frames(self) -> Iterator[Image.Image]:
        """All frames; they are rendered once more, not kept."""
        for batch in batches(np.arange(self.count), self.settings.batch):
            views = self.stage.views(batch)
            by_control = {
                control: [to_pil(image) for image in images]
                for control, images in zip(SIDES, self.stage.compose(views, batch, SIDES), strict=True)
            }
            for k, index in enumerate(map(int, batch)):
                yield self._frame(index, {control: pictures[k] for control, pictures in by_control.items()})

    def _frame(self, index: int, pictures: dict[str, Image.Image]) -> Image.Image:
        size = self.settings.size
        frame = Image.new("RGB", (2 * size + self.gap, self.head + size + self.strip.height), PAPER)
        draw = ImageDraw.Draw(frame)
        for side, control in enumerate(SIDES):
            left, c = side * (size + self.gap), CONTROLS.index(control)
            seen = self._boxes(pictures[control], index, c)
            frame.paste(pictures[control], (left, self.head))
            middle = self.head / 2
            place = {"font": _font(self.text, bold=True), "anchor": "lm"}
            draw.text((left + self.gap, middle), SERIES[control].label, SERIES[control].color, **place)
            shade = SOFT if seen == VERDICTS[0] else FRAMES[0]
            draw.text((left + size - self.gap, middle), seen, shade, _font(self.text), "rm")
        frame.paste(self.strip, (0, self.head + size))
        x = self._x(index)
        draw.line((x, self.head + size + 1, x, frame.height - 1), fill=INK, width=max(1, self.text // 8))
        return frame

    def _boxes(self, picture: Image.Image, index: int, c: int) -> str:
        """Draw every detector's boxes, thinly those above its own threshold alone; the verdict in words."""
        draw, verdict = ImageDraw.Draw(picture), 0
        for d, own in enumerate(self.footage.own):
            for b, (*corners, score) in enumerate(self.footage.boxes[d][c][index].tolist()):
                if score <= min(own, self.settings.threshold):
                    continue
                plain = score > self.settings.threshold
                verdict, color = max(verdict, 1 + plain), FRAMES[d % len(FRAMES)]
                x1, x2 = sorted(min(max(x, 0), picture.width - 1) for x in corners[::2])
                y1, y2 = sorted(min(max(y, 0), picture.height - 1) for y in corners[1::2])
                draw.rectangle((x1, y1, x2, y2), outline=color, width=max(1, self.text // 6) if plain else 1)
                number = self.tracks[d][c][index].get(b)
                told = f"{score:.2f}" + (f"  track {number}" if number else "")
                # Every second detector's stand below the box, so that two can be read.
                place = (x1, min(y2 + 3, picture.height - 1.3 * self.text) if d % 2 else max(2, y1 - 1.4 * self.text))
                _label(draw, place, told, color, _font(self.text), picture.width)
        return VERDICTS[verdict]

    def _x(self, index: float | int) -> float:
        """Where a frame of the first take stands on the timeline."""
        left, right = self.text * 0.6, 2 * self.settings.size + self.gap - self.text * 0.6
        return left + (index + 0.5) / self.count * (right - left)

    def _timeline(self) -> Image.Image:
        """For each detector the scores over time, and when each side was found."""
        text, rows = self.text, len(self.footage.specs)
        height = round(text * 7.6)
        strip = Image.new("RGB", (2 * self.settings.size + self.gap, rows * height + round(0.5 * text)), PAPER)
        draw = ImageDraw.Draw(strip)
        for d, spec in enumerate(self.footage.specs):
            top = d * height + 0.4 * text
            draw.text((self._x(-0.5), top), short_name(spec), FRAMES[d % len(FRAMES)], _font(text, bold=True))
            low, high = top + 5.4 * text, top + 1.6 * text
            place = lambda score, low=low, high=high: low + (high - low) * score
            own = self.footage.own[d]
            for value, shade in ((0, FAINT), (1, FAINT), (own, FAINT), (self.settings.threshold, SOFT)):
                draw.line((self._x(-0.5), place(value), self._x(self.count - 0.5), place(value)), fill=shade)
            told = f"thresholds {self.settings.threshold:g} and its own {own:g}"
            draw.text((self._x(self.count - 0.5), top), told, SOFT, _font(text), "ra")
            for c, control in enumerate(CONTROLS):
                self._curve(draw, d, c, place)
                bar = low + text * (0.35 + 0.75 * SIDES.index(control))
                self._found(draw, d, c, bar)
        return strip

    def _curve(self, draw: ImageDraw.ImageDraw, d: int, c: int, place: object) -> None:
        score = self.footage.score[d, c, : self.count]
        points = [(self._x(i), place(float(s))) for i, s in enumerate(score)]
        if len(points) == 1:
            points = [(self._x(-0.5), points[0][1]), (self._x(0.5), points[0][1])]
        draw.line(points, fill=SERIES[CONTROLS[c]].color, width=max(1, self.text // 6), joint="curve")

    def _found(self, draw: ImageDraw.ImageDraw, d: int, c: int, top: float) -> None:
        """A bar: full where this side was found, thin where above the detector's own threshold alone, else faint."""
        score, height = self.footage.score[d, c], 0.5 * self.text
        for i in range(self.count):
            left, right = self._x(i - 0.5), self._x(i + 0.5)
            draw.rectangle((left, top, right, top + height), fill=FAINT)
            share = 1 if score[i] > self.settings.threshold else 0.4 if score[i] > self.footage.own[d] else 0
            if share:
                draw.rectangle((left, top + (1 - share) * height, right, top + height), SERIES[CONTROLS[c]].color)


def _label(
    draw: ImageDraw.ImageDraw, corner: tuple, words: str, color: str, face: ImageFont.FreeTypeFont, width: int
) -> None:
    """Words on a ground of their own, inside the picture."""
    x0, _, x1, _ = draw.textbbox(corner, words, face)
    corner = (max(0, corner[0] - max(0, x1 - width + 2)), corner[1])
    x0, y0, x1, y1 = draw.textbbox(corner, words, face)
    draw.rectangle((x0 - 2, y0 - 2, x1 + 2, y1 + 2), fill=color)
    draw.text(corner, words, PAPER, face)


def track_numbers(footage: Footage, settings: FilmSettings, count: int) -> Tracks:
    """Which boxes of the first `count` frames belong to confirmed tracks; none where nobody asked (`--track`)."""
    numbers: Tracks = [[[{} for _ in range(count)] for _ in CONTROLS] for _ in footage.specs]
    for d, own in enumerate(footage.own if settings.track else ()):
        for c in range(len(CONTROLS)):
            for one in track(above(footage.boxes[d][c][:count], own), settings.rule):
                for index, box in one.boxes.items():
                    numbers[d][c][index][box] = one.number
    return numbers
