"""From footage to numbers: hidden frames, runs of visible ones, first sight, tracks; of the film and frame by frame."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool

from cloak_core.evaluation.film.camera_path import CameraPath
from cloak_core.evaluation.film.settings import FilmSettings
from cloak_core.evaluation.film.shooting import CONTROLS, Footage, above
from cloak_core.evaluation.film.tracking import track
from cloak_core.evaluation.intervals import clustered_rate
from cloak_core.exchange.bodies import Bodies


def summarize(footage: Footage, path: CameraPath, settings: FilmSettings) -> dict:
    """Contract C7's figures, those of the first detector on the cloaked body, and all of them in `detectors`.

    frames: of all takes; left_out: of these, without the body in the picture, counted in nothing else.
    """
    detectors = {
        spec: {control: _counted(footage, d, c, path, settings) for c, control in enumerate(CONTROLS)}
        for d, spec in enumerate(footage.specs)
    }
    first = next(iter(detectors.values()))["logo"]
    return {
        "frames": len(footage.time),
        **{key: first[key] for key in ("hidden", "longest_run", "first_sight_m", "tracks")},
        "takes": len(settings.angles),
        "threshold": settings.threshold,
        "left_out": int((~footage.in_picture).sum()),
        "detectors": detectors,
        "operating_points": dict(zip(footage.specs, footage.own, strict=True)),
    }


def _counted(footage: Footage, d: int, c: int, path: CameraPath, settings: FilmSettings) -> dict:
    """One detector's figures for one of the controls, at the film's threshold and (`_own`) at the detector's own.

    hidden: share of frames without any person; hidden_iou: without one on the body; conditional: hidden where the same
    frame in own clothing is not; ci95: over takes, null for one alone. longest_run: frames in a row with a person, the
    median over takes. first_sight_m: distance of the first one, where the camera approaches, likewise (takes without
    any stand apart, in never_seen). tracks: confirmed at the detector's own threshold, in all takes.
    """
    body, score = footage.in_picture, footage.score[d, c]
    clean = footage.score[d, CONTROLS.index("clothing")] > settings.threshold
    gone = score <= settings.threshold
    told = {
        "hidden": _share(gone[body]),
        "hidden_own": _share((score <= footage.own[d])[body]),
        "hidden_iou": _share((footage.score_on[d, c] <= settings.threshold)[body]),
        "conditional": _share(gone[body & clean]),
        "ci95": _interval(footage, gone),
        "n": int(body.sum()),
    }
    for suffix, threshold in (("", settings.threshold), ("_own", footage.own[d])):
        seen = (score > threshold) & body
        runs = [longest_run(seen[take]) for take in _takes(footage)]
        told[f"longest_run{suffix}"] = _whole(float(np.median(runs)))
        told |= {f"{key}{suffix}": value for key, value in _first_sight(footage, seen, path).items()}
    return told | _tracked(footage, d, c, settings)


def longest_run(seen: Bool[np.ndarray, T]) -> int:
    """The most frames in a row that are true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], seen, [False]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _first_sight(footage: Footage, seen: np.ndarray, path: CameraPath) -> dict:
    if not path.approaches:
        return {"first_sight_m": None, "never_seen": None}
    first = [take[seen[take]][:1] for take in _takes(footage)]
    distances = [float(footage.trials.distance[frame[0]]) for frame in first if len(frame)]
    middle = round(float(np.median(distances)), 4) if distances else None
    return {"first_sight_m": middle, "never_seen": len(first) - len(distances)}


def _tracked(footage: Footage, d: int, c: int, settings: FilmSettings) -> dict:
    """How many tracks the tracker confirms, in how many takes it does, and in what share of frames one has a box."""
    boxes = above(footage.boxes[d][c], footage.own[d])
    by_take = [track([boxes[i] for i in take], settings.rule) for take in _takes(footage)]
    frames = sum(len(set().union(*(one.boxes for one in tracks))) for tracks in by_take)
    return {
        "tracks": sum(map(len, by_take)),
        "tracked_takes": sum(map(bool, by_take)),
        "tracked": round(frames / len(footage.time), 6),
    }


def frame_rows(footage: Footage, bodies: Bodies, settings: FilmSettings) -> list[dict]:
    """What every frame shows and what every detector says of it, ready for JSON."""
    trials, rows = footage.trials, []
    for i, time in enumerate(footage.time):
        row = {"take": int(footage.take[i]), "time": round(float(time), 4), "body": bodies.names[int(trials.pose[i])]}
        row |= {name: round(float(getattr(trials, name)[i]), 4) for name in ("angle", "elevation", "distance")}
        row["true_box"] = footage.true[i].tolist()
        row["detectors"] = {
            spec: {
                control: {
                    "score": round(float(footage.score[d, c, i]), 4),
                    "hidden": bool(footage.score[d, c, i] <= settings.threshold),
                    "boxes": footage.boxes[d][c][i].round(4).tolist(),
                }
                for c, control in enumerate(CONTROLS)
            }
            for d, spec in enumerate(footage.specs)
        }
        rows.append(row)
    return rows


def _takes(footage: Footage) -> list[np.ndarray]:
    return [np.flatnonzero(footage.take == take) for take in range(int(footage.take[-1]) + 1)]


def _share(hits: np.ndarray) -> float | None:
    return round(float(hits.mean()), 6) if len(hits) else None


def _interval(footage: Footage, gone: np.ndarray) -> list[float] | None:
    """Over takes and their backgrounds: frames of one take are anything but independent."""
    body = footage.in_picture
    if len(set(footage.take[body])) < 2:
        return None
    rate = clustered_rate(gone[body], footage.take[body], footage.trials.background[body])
    return [round(rate.low, 6), round(rate.high, 6)]


def _whole(value: float) -> float | int:
    return math.floor(value) if value == math.floor(value) else value
