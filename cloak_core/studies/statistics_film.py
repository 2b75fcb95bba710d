"""Count films: hidden frames, runs of visible ones, first sight and tracks, from the results table.

A film's images have further columns: take (from 0), time (seconds in the take) and the body's true box; its boxes have
corners (see `Results`).

A plain tracker of boxes by their overlap asks whether a camera with the simplest of trackers would ever follow the
person. Boxes continue the track whose last box they overlap most (greedily, best pairs first), as in Bochinski,
Eiselein and Sikora, "High-speed tracking-by-detection without using image information", AVSS 2017; confirming and
losing a track are SORT's rules (Bewley et al., ICIP 2016). There is no motion model and no appearance model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
import torch
from jaxtyping import Bool, Float

from cloak_core.core.detector.scoring import box_iou
from cloak_core.core.evaluation.results import CORNERS, TRUE_BOX, Results
from cloak_core.core.evaluation.settings import FilmSettings
from cloak_core.core.evaluation.statistics import (
    finite,
    operating_point,
    outcome_record,
    rate,
    rate_record,
    success_rate,
    undetected,
)

CLUSTERS = ("take", "background")
"""Frames of one take, and those before one background, succeed and fail together."""
LEAST_PIXELS = 8
"""A body whose true box is narrower or lower than this is not in the picture."""


def summarize_film(results: Results, settings: FilmSettings, approaches: bool) -> dict:
    """Count contract C7's figures: of the first detector on the cloaked body, and of all in `detectors`.

    approaches: the camera comes nearer all the time. frames: of all takes; left_out: of these, without the body in
    the picture, counted in nothing else.
    """
    rows = {spec: {control: results.rows(spec, control) for control in results.controls} for spec in results.detectors}
    detectors = {
        spec: {name: film_record(results, frames, settings, approaches) for name, frames in by_control.items()}
        for spec, by_control in rows.items()
    }
    spec, cloak = results.detectors[0], results.controls[0]
    first = rows[spec][cloak]
    keys = ("hidden", "renamed", "gone", "longest_run", "first_sight_m", "tracks")
    return {
        "frames": len(first),
        **{key: detectors[spec][cloak][key] for key in keys},
        "takes": int(first["take"].max()) + 1,
        "threshold": settings.threshold,
        "left_out": int((~in_picture(first)).sum()),
        "detectors": detectors,
        "operating_points": {spec: operating_point(frames[cloak]) for spec, frames in rows.items()},
    }


def film_record(results: Results, frames: pd.DataFrame, settings: FilmSettings, approaches: bool) -> dict:
    """Figures of one detector and control, at the film's threshold and (`_own`) at the detector's own.

    hidden: share of frames without any reported person; hidden_iou: without one on the body; conditional: hidden where
    the same frame in own clothing is not; renamed, gone, named: see `outcome_record`; ci95: over takes, null for a
    single one. longest_run: frames in a row with a person, the median over takes. first_sight_m: distance of a take's
    first one where the camera approaches, likewise (takes without any are counted in never_seen). tracks: confirmed at
    the detector's own threshold, in all takes.
    """
    threshold, own = settings.threshold, operating_point(frames)
    takes = [take for _, take in frames.groupby("take")]
    shown = frames[in_picture(frames)]
    seen_clean = shown[(shown["clean"] > threshold).to_numpy()]
    several = shown["take"].nunique() > 1
    hits = rate_record("success", rate(shown, undetected(shown, threshold), CLUSTERS)) if several else {"ci95": None}
    record = {
        "hidden": finite(success_rate(shown, threshold)),
        "hidden_own": finite(success_rate(shown, own)),
        "hidden_iou": finite(success_rate(shown, threshold, "score_on")),
        "conditional": finite(success_rate(seen_clean, threshold)),
        **outcome_record(shown, threshold),
        "ci95": hits["ci95"],
        "n": len(shown),
    }
    for suffix, at in (("", threshold), ("_own", own)):
        seen = [~undetected(take, at) & in_picture(take) for take in takes]
        run = float(np.median(list(map(longest_run, seen))))
        record[f"longest_run{suffix}"] = int(run) if run.is_integer() else run
        at_first = [take["distance"].to_numpy()[is_detected] for take, is_detected in zip(takes, seen, strict=True)]
        distances = [float(values[0]) for values in at_first if len(values)]
        middle = finite(float(np.median(distances)), 4) if distances else None
        record[f"first_sight_m{suffix}"] = middle if approaches else None
        record[f"never_seen{suffix}"] = len(takes) - len(distances) if approaches else None
    tracks = [track(frame_boxes(results, take, own), settings) for take in takes]
    tracked = sum(len(set().union(*(one.boxes for one in of_take))) for of_take in tracks)
    record |= {"tracks": sum(map(len, tracks)), "tracked_takes": sum(map(bool, tracks))}
    return record | {"tracked": finite(tracked / len(frames))}


def in_picture(frames: pd.DataFrame) -> Bool[np.ndarray, " N"]:
    """Mark the frames that show enough of the body to be found."""
    x1, y1, x2, y2 = (frames[name].to_numpy() for name in TRUE_BOX)
    return (x2 - x1 >= LEAST_PIXELS) & (y2 - y1 >= LEAST_PIXELS)


def longest_run(seen: Bool[np.ndarray, " T"]) -> int:
    """Count the most frames in a row that are true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], seen, [False]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def frame_boxes(results: Results, frames: pd.DataFrame, above: float) -> list[Float[np.ndarray, "_ 5"]]:
    """List each frame's boxes (x1, y1, x2, y2, score) with a score above `above`, best first."""
    boxes = results.boxes_of(frames)
    boxes = boxes[boxes["score"].to_numpy() > above]
    by_image = {image: group[[*CORNERS, "score"]].to_numpy() for image, group in boxes.groupby("image")}
    return [by_image.get(image, np.zeros((0, 5), np.float32)) for image in frames["image"]]


def frame_rows(results: Results, threshold: float) -> list[dict]:
    """Tell what every frame shows and what every detector says of it, ready for JSON."""
    rows = {(spec, control): results.rows(spec, control) for spec in results.detectors for control in results.controls}
    verdicts = {key: _frame_verdicts(results, frames, threshold) for key, frames in rows.items()}
    table_rows = []
    for k, frame in enumerate(next(iter(rows.values())).to_dict("records")):
        place = {name: round(float(frame[name]), 4) for name in ("time", "angle", "elevation", "distance")}
        detectors = {
            spec: {control: verdicts[spec, control][k] for control in results.controls} for spec in results.detectors
        }
        table_rows.append(
            {
                "take": int(frame["take"]),
                "time": place.pop("time"),
                "body": frame["body"],
                **place,
                "true_box": [float(frame[name]) for name in TRUE_BOX],
                "detectors": detectors,
            }
        )
    return table_rows


def _frame_verdicts(results: Results, rows: pd.DataFrame, threshold: float) -> list[dict]:
    boxes = frame_boxes(results, rows, min(threshold, operating_point(rows)))
    columns = zip(rows["score"], undetected(rows, threshold), rows["other"], rows["other_name"], boxes, strict=True)
    return [
        {
            "score": round(float(score), 4),
            "hidden": bool(gone),
            "other": finite(other, 4),
            "other_name": name or None,
            "boxes": reported.round(4).tolist(),
        }
        for score, gone, other, name, reported in columns
    ]


@dataclass(eq=False)
class Track:
    """One track: the frames in which it has a box, and which box."""

    number: int = 0
    """From 1 in the order of confirmation; 0 while it is not confirmed."""
    boxes: dict[int, int] = field(default_factory=dict)
    """Frame -> index among that frame's boxes."""
    last: np.ndarray | None = None
    missed: int = 0


def track(frames: Sequence[Float[np.ndarray, "_ 5"]], settings: FilmSettings) -> list[Track]:
    """Find the confirmed tracks through frames of boxes (x1, y1, x2, y2, score), in the order of confirmation.

    A track is confirmed by `track_hits` frames in a row; then it outlives `track_misses` without a box that overlaps
    its last one by `track_iou`. Its boxes include those before it was confirmed.
    """
    live: list[Track] = []
    confirmed: list[Track] = []
    for index, boxes in enumerate(frames):
        matched = _match(live, boxes, settings.track_iou)
        for position, one in enumerate(live):
            one.missed += 1
            if position in matched:
                one.missed, one.boxes[index], one.last = 0, matched[position], boxes[matched[position]]
        live += [Track(boxes={index: b}, last=box) for b, box in enumerate(boxes) if b not in matched.values()]
        live = [one for one in live if one.missed <= (settings.track_misses if one.number else 0)]
        for one in live:
            if not one.number and len(one.boxes) >= settings.track_hits:
                confirmed.append(one)
                one.number = len(confirmed)
    return confirmed


def _match(live: Sequence[Track], boxes: Float[np.ndarray, "n 5"], least: float) -> dict[int, int]:
    """Match tracks (by position) to boxes (by index), the largest overlaps first."""
    if not live or not len(boxes):
        return {}
    last = torch.from_numpy(np.stack([one.last for one in live])[:, None, :4])
    overlap = box_iou(last, torch.from_numpy(boxes[:, :4])).numpy()
    matches: dict[int, int] = {}
    for flat in np.argsort(-overlap, axis=None, kind="stable"):
        position, box = divmod(int(flat), len(boxes))
        if overlap[position, box] < least:
            break
        if position not in matches and box not in matches.values():
            matches[position] = box
    return matches
