"""Draw frames: own clothing and cloak side by side, each detector's boxes, and a timeline of scores below."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache

import numpy as np
from PIL import Image, ImageDraw

from cloak_core.core.evaluation import CLOTHING, LOGO
from cloak_core.core.evaluation.measure import batches
from cloak_core.core.evaluation.results import Results
from cloak_core.core.evaluation.settings import FilmSettings
from cloak_core.core.evaluation.statistics import operating_point
from cloak_core.core.images import ImageSet
from cloak_core.core.pattern import Pattern
from cloak_core.studies.report.pictures import PAPER, SOFT, font, to_pil
from cloak_core.studies.report.style import FAINT, INK, SERIES
from cloak_core.studies.report.words import short_name
from cloak_core.studies.statistics_film import frame_boxes, track

SIDES = (CLOTHING, LOGO)
"""From left to right."""
COLORS = ("#e0341c", "#6a3fc9", "#00795a", "#b06a00", "#0a62a8")
"""Of boxes, by detector: the report's colours."""
VERDICTS = ("not found", "only at its own threshold", "found")
_font = lru_cache(maxsize=None)(font)


def draw_frames(
    images: ImageSet, patterns: Mapping[str, Pattern], results: Results, settings: FilmSettings
) -> Iterator[Image.Image]:
    """Render the first take once more and draw its frames, one after the other."""
    drawing = _Drawing(results, settings)
    for batch in batches(np.arange(drawing.count), settings.batch):
        made = zip(SIDES, images.compose(batch, [patterns[side] for side in SIDES]), strict=True)
        shown = {side: [to_pil(image) for image in rendered] for side, rendered in made}
        for k, index in enumerate(map(int, batch)):
            yield drawing.frame(index, {side: pictures[k] for side, pictures in shown.items()})


class _Drawing:
    """Everything that the frames of a take have in common."""

    def __init__(self, results: Results, settings: FilmSettings) -> None:
        self.detectors = results.detectors
        self.settings = settings
        self.text = max(9, settings.size // 26)
        self.gap = max(2, settings.size // 100)
        self.head = round(1.9 * self.text)
        self.scores, self.boxes, self.others, self.tracks = {}, {}, {}, {}
        for spec in self.detectors:
            for control in SIDES:
                rows = results.rows(spec, control, take=0)
                own = operating_point(rows)
                self.scores[spec, control] = rows["score"].to_numpy()
                self.boxes[spec, control] = frame_boxes(results, rows, min(own, settings.threshold))
                # What stands on the body instead of a person, where the detector tells; NaN is above no threshold.
                others = zip(rows["other"], rows["other_name"], strict=True)
                self.others[spec, control] = [name if score > own else "" for score, name in others]
                tracked = track(frame_boxes(results, rows, own), settings) if settings.track else ()
                # By frame and index of a box: the number of the box's track.
                self.tracks[spec, control] = {(i, b): path.number for path in tracked for i, b in path.boxes.items()}
        self.own = {spec: operating_point(results.rows(spec, LOGO)) for spec in self.detectors}
        self.count = len(rows)
        self.strip = self._timeline()

    def frame(self, index: int, pictures: dict[str, Image.Image]) -> Image.Image:
        """Draw one frame from the rendered pictures of both sides."""
        size = self.settings.size
        frame = Image.new("RGB", (2 * size + self.gap, self.head + size + self.strip.height), PAPER)
        draw = ImageDraw.Draw(frame)
        for side, control in enumerate(SIDES):
            left, middle = side * (size + self.gap), self.head / 2
            verdict = self._draw_boxes(pictures[control], index, control)
            # What is reported on the body though no person is.
            others = sorted({self.others[spec, control][index] for spec in self.detectors} - {""})
            words = VERDICTS[verdict] + (f", but: {', '.join(others)}" if others and not verdict else "")
            frame.paste(pictures[control], (left, self.head))
            label, color = SERIES[control]["label"], SERIES[control]["color"]
            draw.text((left + self.gap, middle), label, color, _font(self.text, bold=True), "lm")
            shade = COLORS[0] if verdict else SOFT
            draw.text((left + size - self.gap, middle), words, shade, _font(self.text), "rm")
        frame.paste(self.strip, (0, self.head + size))
        x = self._x(index)
        draw.line((x, self.head + size + 1, x, frame.height - 1), fill=INK, width=max(1, self.text // 8))
        return frame

    def _draw_boxes(self, picture: Image.Image, index: int, control: str) -> int:
        """Draw every detector's boxes, thinly those above its own threshold alone; return which of `VERDICTS` it is."""
        draw = ImageDraw.Draw(picture)
        verdict = 0
        for d, spec in enumerate(self.detectors):
            color = COLORS[d % len(COLORS)]
            for b, (*corners, score) in enumerate(self.boxes[spec, control][index].tolist()):
                sure = score > self.settings.threshold
                verdict = max(verdict, 1 + sure)
                x1, x2 = sorted(min(max(x, 0), picture.width - 1) for x in corners[::2])
                y1, y2 = sorted(min(max(y, 0), picture.height - 1) for y in corners[1::2])
                draw.rectangle((x1, y1, x2, y2), outline=color, width=max(1, self.text // 6) if sure else 1)
                number = self.tracks[spec, control].get((index, b))
                # Labels of every second detector stand below the box, so that two can be read.
                low = min(y2 + 3, picture.height - 1.3 * self.text)
                place = (x1, low if d % 2 else max(2, y1 - 1.4 * self.text))
                self._label(draw, place, f"{score:.2f}" + (f"  track {number}" if number else ""), color, picture.width)
        return verdict

    def _label(self, draw: ImageDraw.ImageDraw, corner: tuple, words: str, color: str, width: int) -> None:
        """Write words on a ground of their own, inside the picture."""
        face = _font(self.text)
        corner = (max(0, corner[0] - max(0, draw.textbbox(corner, words, face)[2] - width + 2)), corner[1])
        x0, y0, x1, y1 = draw.textbbox(corner, words, face)
        draw.rectangle((x0 - 2, y0 - 2, x1 + 2, y1 + 2), fill=color)
        draw.text(corner, words, PAPER, face)

    # --- the timeline

    def _x(self, index: float | int) -> float:
        """Compute where a frame of the take stands on the timeline, pixels."""
        left, right = self.text * 0.6, 2 * self.settings.size + self.gap - self.text * 0.6
        return left + (index + 0.5) / self.count * (right - left)

    def _timeline(self) -> Image.Image:
        """Draw for each detector the scores over time, and bars where each side is found."""
        text = self.text
        height = round(text * 7.6)
        strip = Image.new("RGB", (2 * self.settings.size + self.gap, len(self.own) * height + round(0.5 * text)), PAPER)
        draw = ImageDraw.Draw(strip)
        left, right = self._x(-0.5), self._x(self.count - 0.5)
        for d, (spec, own) in enumerate(self.own.items()):
            top = d * height + 0.4 * text
            draw.text((left, top), short_name(spec), COLORS[d % len(COLORS)], _font(text, bold=True))
            caption = f"thresholds {self.settings.threshold:g} and its own {own:g}"
            draw.text((right, top), caption, SOFT, _font(text), "ra")
            zero = top + 5.4 * text
            y = lambda score, zero=zero: zero - 3.8 * text * score  # pixels
            for value, shade in ((0.0, FAINT), (1.0, FAINT), (own, FAINT), (self.settings.threshold, SOFT)):
                draw.line((left, y(value), right, y(value)), fill=shade)
            for control in (LOGO, CLOTHING):
                self._series(draw, spec, control, y, zero + text * (0.35 + 0.75 * SIDES.index(control)))
        return strip

    def _series(self, draw: ImageDraw.ImageDraw, spec: str, control: str, y: Callable, top: float) -> None:
        """Draw one side's scores, and its bar: full where found, thin above the own threshold alone, else faint."""
        scores = self.scores[spec, control]
        color = SERIES[control]["color"]
        height = 0.5 * self.text
        points = [(self._x(i), y(float(s))) for i, s in enumerate(scores)]
        if len(points) == 1:
            points = [(self._x(-0.5), points[0][1]), (self._x(0.5), points[0][1])]
        draw.line(points, fill=color, width=max(1, self.text // 6), joint="curve")
        for i, score in enumerate(scores):
            left, right = self._x(i - 0.5), self._x(i + 0.5)
            draw.rectangle((left, top, right, top + height), fill=FAINT)
            part = 1 if score > self.settings.threshold else 0.4 if score > self.own[spec] else 0
            if part:
                draw.rectangle((left, top + (1 - part) * height, right, top + height), color)
