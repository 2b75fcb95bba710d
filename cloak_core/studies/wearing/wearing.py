"""Dress people in photographs in anything and judge them, for `cloak wear` and the card."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float
from PIL import Image, ImageDraw
from torch import Tensor

from cloak_core.core.detector.protocol import Detector, detector_record
from cloak_core.core.evaluate import Patterns, measure_frozen
from cloak_core.core.evaluation import CLOTHING, NAMES, RESAMPLED, STANDARD
from cloak_core.core.evaluation.measure import OnProgress, check_asked, measure
from cloak_core.core.evaluation.results import CORNERS, NOBODY, Results
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.evaluation.statistics import (
    false_alarms,
    finite,
    operating_point,
    side_record,
    success_rate,
    success_record,
)
from cloak_core.core.logo import Cover, select_region
from cloak_core.core.pictures import save_picture
from cloak_core.core.source import Cast
from cloak_core.files.errors import InputError
from cloak_core.files.records import as_cell
from cloak_core.files.writing import new_folder, require_new, write_json, write_text
from cloak_core.patterns.controls import OwnClothing, controls
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.people import People
from cloak_core.studies.opening import clothes_cover, open_pattern
from cloak_core.studies.report.pictures import PAPER, font, to_pil
from cloak_core.studies.report.style import INK
from cloak_core.studies.report.words import short_name
from cloak_core.studies.trained_run import trained_against

CONTROLS = (*STANDARD, RESAMPLED)
"""What people wear beside what is judged, on shirt and trousers or what --logo says."""
GREY_HEADWEAR = "grey headwear"
"""A control where heads are covered: own clothing with as much of the head in grey, which alone may hide somebody."""


def wear_and_judge(
    colors: Sequence[str],
    people: Crowd,
    detectors: dict[str, Detector],
    backgrounds: Backgrounds,
    out: Path | None = None,
    settings: WearSettings | None = None,
    on_progress: OnProgress | None = None,
    more: Mapping[str, object] | None = None,
    logo: str | None = None,
) -> dict:
    """Dress people in each of `colors` and in the controls, and judge them.

    backgrounds: without people, for false alarms. out: a new folder for pictures/PERSON/before.jpg and after
    CLOTHES.jpg, sheet.jpg, scores.csv (a row for each detector, clothes and person) and wear.json; nothing is left of
    it where this fails.
    more: what the result says besides. logo: what cloths, pictures and controls cover (`clothes_cover`).
    Returns what `cloak wear --json` prints (contract C8). `InputError`: names COLORS, file or option.
    """
    settings = settings or WearSettings()
    check_asked(detectors)
    cover = clothes_cover(logo)
    patterns = {name: pattern.on(cover) if logo else pattern for pattern, _, name in map(open_pattern, colors)}
    for name in patterns:
        if len(patterns) < len(colors) or name in NAMES:
            raise InputError(f"{name}: given twice, or called as a control is")
    patterns |= controls(CONTROLS, OwnClothing(cover), settings.seed)
    head = np.intersect1d(cover.face_ids, select_region(sample_bodies(), "head"))
    if len(head):
        headwear = OwnClothing(Cover(head, cover.topology, name="headwear"))
        patterns[GREY_HEADWEAR] = controls(("grey",), headwear)["grey"]
    more = {"cover": cover.name} | dict(more or {})
    if out is None:
        return _judged(patterns, people, detectors, backgrounds, settings, on_progress, None) | more
    require_new(out)
    with new_folder(out) as folder:
        result = _judged(patterns, people, detectors, backgrounds, settings, on_progress, folder) | more
        write_json(folder / "wear.json", result)
    return result | {"out": str(out)}


def _judged(
    patterns: Patterns,
    people: Crowd,
    detectors: dict[str, Detector],
    backgrounds: Backgrounds,
    settings: WearSettings,
    on_progress: OnProgress | None,
    folder: Path | None,
) -> dict:
    """Dress every fitted person in everything and ask every detector; also about backgrounds without people."""
    wearers = people.wearers(patterns.values())
    points = {spec: detector.operating_point for spec, detector in detectors.items()}
    images = wearers.images(backgrounds, settings, next(iter(detectors.values())).device)
    album = None if folder is None else Album(folder, images.body_names, points)
    bare = np.arange(min(settings.bare, len(backgrounds)))
    on_images = None if album is None else album.add_all
    results, _ = measure_frozen(images, patterns, detectors, settings, on_progress, on_images, bare)
    if album is not None:
        album.write()
        write_text(folder / "scores.csv", _table(results, wearers.people))

    def record(spec: str, name: str) -> dict:
        """Count S of contract C8 with `seen_from`: the people seen from the front, from the side and from behind."""
        rows = results.rows(spec, name)
        counted = success_record(results, rows, settings.threshold) | side_record(rows, settings.threshold)
        return counted | {"cover": patterns[name].cover.name}

    return {
        "detectors": {spec: {name: record(spec, name) for name in results.controls} for spec in detectors},
        "people": len(wearers),
        "photographs": len(wearers.people.photographs),
        "left_out": wearers.people.left_out,
        "false_alarms": {spec: finite(false_alarms(results, spec, settings.threshold)) for spec in detectors},
        "operating_points": points,
        "fit": wearers.quality(),
    }


def _table(results: Results, people: People) -> str:
    """List every detector's score of every person in everything, as CSV."""
    shown = results.images[(results.images["control"] != NOBODY).to_numpy()].rename(columns={"control": "clothes"})
    shown = shown.assign(person=[people.people[pose].number for pose in shown["pose"]])
    columns = ["detector", "clothes", "photograph", "person", "seen_from", "score", "other", "other_name"]
    return shown[columns].map(as_cell).to_csv(index=False, float_format="%.4f", lineterminator="\n")


# --- pictures of dressed people, with the boxes that detectors still draw
#
# They show real people: none of them is ever published with the project.

COLORS = ((224, 52, 28), (30, 110, 220), (20, 150, 80), (190, 60, 190), (230, 150, 0), (0, 160, 170))
SHEET_PEOPLE = 12
TILE, CAPTION, TITLE, HEAD = 240, 22, 26, 50
"""Of the sheet, pixels: a picture's side, the strip below it, the line above a row, and that above all."""
FOUND, HIDDEN = (26, 122, 70), (176, 58, 36)
"""As on a card: green is a detector that is right, red a person who is hidden from it."""
ROWS = {
    CLOTHING: "own clothing, the photograph as it is",
    "grey": "grey all over the clothes",
    "random": "random colours all over the clothes",
    "resampled": "own clothing, laid on as the cloak is",
}
"""What the controls' rows are."""


class Album:
    """Writes pictures/PERSON/before.jpg and after CLOTHES.jpg, and a contact sheet with the controls as well.

    The sheet has a column for each of a few people, named above it, and a row for each thing that they wear; below
    every picture stands whether she is found or hidden.
    """

    def __init__(self, folder: Path, people: Sequence[str], thresholds: Mapping[str, float]) -> None:
        """thresholds: each detector's own, by its spec; boxes above it are drawn."""
        self._folder, self._people, self._thresholds = folder, people, thresholds
        step = max(1, len(people) // SHEET_PEOPLE)
        self._shown = list(range(0, len(people), step))[:SHEET_PEOPLE]
        self._tiles: dict[str, dict[int, Image.Image]] = {}
        self._scores: dict[str, list[float | None]] = {}

    def add_all(self, clothes: str, people: np.ndarray, images: Float[Tensor, "B 3 H W"], boxes: pd.DataFrame) -> None:
        """Write the images of these people in the same clothes; see `OnImages`."""
        for person, image in zip(people.tolist(), images, strict=True):
            self.add(clothes, person, to_pil(image), boxes[(boxes["image"] == person).to_numpy()])

    def add(self, clothes: str, person: int, image: Image.Image, boxes: pd.DataFrame) -> None:
        """Write one image, with each detector's boxes in a colour of its own; boxes: as in `Results.boxes`."""
        if clothes not in NAMES or clothes == CLOTHING:
            picture = image.copy()
            self._draw_boxes(picture, boxes, 1.0)
            name = "before" if clothes == CLOTHING else f"after {file_name(clothes)}"
            place = self._folder / "pictures" / file_name(self._people[person])
            place.mkdir(parents=True, exist_ok=True)
            save_picture(place / f"{name}.jpg", picture, quality=90)
        # Boxes and scores are drawn at the sheet's own size: shrunk with the picture nobody could read them.
        tile = image.resize((TILE, TILE), Image.Resampling.LANCZOS)
        best = self._draw_boxes(tile, boxes, TILE / image.width)
        self._scores.setdefault(clothes, []).extend(best)
        if person in self._shown:
            self._tiles.setdefault(clothes, {})[person] = _captioned(tile, best)

    def _draw_boxes(self, picture: Image.Image, boxes: pd.DataFrame, scale: float) -> list[float | None]:
        """Draw what is above each detector's threshold; return the best score of each, None where she is hidden."""
        draw, best = ImageDraw.Draw(picture), []
        for d, threshold in enumerate(self._thresholds.values()):
            above, color = (boxes["detector"] == d) & (boxes["score"] > threshold), COLORS[d % len(COLORS)]
            rows = boxes.loc[above, [*CORNERS, "score"]].to_numpy()
            for *corners, score in rows.tolist():
                x1, y1, x2, y2 = (scale * corner for corner in corners)
                if x2 > x1 and y2 > y1:
                    draw.rectangle((x1, y1, x2, y2), outline=color, width=2)
                    draw.text((x1 + 3, max(y1, 0) + 1), f"{score:.2f}", color, font(13, bold=True))
            best.append(float(rows[:, 4].max()) if len(rows) else None)
        return best

    def write(self) -> None:
        """Write sheet.jpg."""
        height = TILE + CAPTION + TITLE
        sheet = Image.new("RGB", (max(TILE * len(self._shown), 720), HEAD + height * len(self._tiles)), PAPER)
        draw = ImageDraw.Draw(sheet)
        left = 6
        for d, (spec, threshold) in enumerate(self._thresholds.items()):
            words = f"{short_name(spec)}, boxes above {threshold:g}"
            draw.text((left, 4), words, COLORS[d % len(COLORS)], font(15, bold=True))
            left += round(draw.textlength(words, font(15, bold=True))) + 24
        for column, person in enumerate(self._shown):
            draw.text((column * TILE + 6, 28), self._people[person][-26:], INK, font(13))
        count = len(self._people)
        whose = "" if count == len(self._shown) else f" ({count} people judged, {len(self._shown)} of them shown)"
        for row, (name, tiles) in enumerate(self._tiles.items()):
            top = HEAD + row * height
            scores = self._scores[name]
            words = f"{ROWS.get(name, name)}: hidden in {scores.count(None)} of {len(scores)}{whose}"
            draw.text((6, top + 4), words, INK, font(15, bold=True))
            for column, person in enumerate(self._shown):
                if person in tiles:
                    sheet.paste(tiles[person], (column * TILE, top + TITLE))
        save_picture(self._folder / "sheet.jpg", sheet, quality=88)


def _captioned(tile: Image.Image, best: Sequence[float | None]) -> Image.Image:
    """Put below a picture whether she is found or hidden, on red where no detector finds her."""
    scores = [score for score in best if score is not None]
    words = "hidden" if not scores else f"found {max(scores):.2f}"
    if len(best) > 1 and scores and len(scores) < len(best):
        words = f"found by {len(scores)} of {len(best)}, {max(scores):.2f}"
    whole = Image.new("RGB", (TILE, TILE + CAPTION), FOUND if scores else HIDDEN)
    whole.paste(tile, (0, 0))
    ImageDraw.Draw(whole).text((6, TILE + 2), words, (255, 255, 255), font(14, bold=True))
    return whole


def file_name(name: str) -> str:
    """A name as a file's: letters, digits, dots, dashes."""
    return re.sub(r"[^A-Za-z0-9._=-]+", "-", name).strip("-.") or "unnamed"


# --- how wide a picture hides best as cloth, chosen on people and detectors that do not judge

AUTO = "@tile=auto"
WIDTHS = (0.1, 0.15, 0.2, 0.25, 0.35, 0.5, 0.7, 1.0)
"""Metres that are tried."""


def choose_widths(
    colors: Sequence[str],
    people: Cast,
    detectors: Mapping[str, Detector],
    judging: tuple[Crowd, Mapping[str, Detector]],
    backgrounds: Backgrounds,
    settings: WearSettings,
    on_progress: OnProgress | None = None,
    logo: str | None = None,
) -> tuple[list[str], dict[str, dict]]:
    """Replace each `@tile=auto` of COLORS by the width that hides most.

    people, detectors: whom the choice is made on. judging: the people and detectors that judge afterwards. Returns
    COLORS, and by each that had an `@tile=auto` what `width_curve` measured.
    InputError: a width is to be chosen, but on nobody, or on somebody who judges.
    """
    asked = [color for color in colors if AUTO in color]
    if not asked:
        return list(colors), {}
    for option, value in (("--width-people", people), ("--width-detector", detectors)):
        if not value:
            raise InputError(f"{asked[0]}: needs {option}, on whom the width is chosen, and who does not judge")
    _check_strangers(people, detectors, *judging)
    curves = {color: width_curve(color, people, detectors, backgrounds, settings, on_progress, logo) for color in asked}
    at_width = lambda color: color.replace(AUTO, f"@tile={curves[color]['chosen']:g}")
    return [at_width(color) if color in curves else color for color in colors], curves


def width_curve(
    color: str,
    people: Crowd,
    detectors: Mapping[str, Detector],
    backgrounds: Backgrounds,
    settings: WearSettings,
    on_progress: OnProgress | None = None,
    logo: str | None = None,
) -> dict:
    """Judge a picture, PICTURE@tile=auto, at each of `WIDTHS`, on shirt and trousers or `logo` (`clothes_cover`).

    Returns "detectors" {SPEC: {METRES: {"success", "success_own"}}}, "people", "photographs", and "chosen": the width
    in metres with the largest mean of both rates over the detectors, the narrower one of equals.
    """
    opened = [open_pattern(color.replace(AUTO, f"@tile={metres:g}"))[0] for metres in WIDTHS]
    patterns = {f"{metres:g}": worn.on(clothes_cover(logo)) for metres, worn in zip(WIDTHS, opened, strict=True)}
    images = people.images(backgrounds, settings, next(iter(detectors.values())).device)
    results = measure(images, patterns, detectors, batch=settings.batch, on_progress=on_progress)

    def rates_of(spec: str, metres: str) -> dict[str, float | None]:
        rows = results.rows(spec, metres)
        thresholds = {"success": settings.threshold, "success_own": operating_point(rows)}
        return {name: None if at is None else finite(success_rate(rows, at)) for name, at in thresholds.items()}

    rates = {spec: {metres: rates_of(spec, metres) for metres in patterns} for spec in detectors}
    measured = [[one[metres][name] for one in rates.values() for name in one[metres]] for metres in patterns]
    means = [np.mean([rate for rate in of_width if rate is not None]) for of_width in measured]
    chosen = WIDTHS[int(np.argmax(means))]
    return {"chosen": chosen, "people": len(people), "photographs": len(people.people.photographs), "detectors": rates}


def _check_strangers(
    people: Crowd, detectors: Mapping[str, Detector], judges: Crowd, judging: Mapping[str, Detector]
) -> None:
    """Refuse people (by their photographs) and detectors (by their weights) that also judge. InputError."""
    judged = {person.identity for person in judges.people}
    both = set(people.pictures()) & set(judges.pictures())
    both |= {person.photograph for person in people.people if person.identity in judged}
    if both:
        raise InputError(f"--width-people: {min(both)} judges as well (take the other half: PEOPLE.json[0::2])")
    judge = trained_against({"detectors": list(map(detector_record, judging.values()))}, detectors)
    if any(judge.values()):
        raise InputError(f"--width-detector: {next(spec for spec in judge if judge[spec])} judges as well")
