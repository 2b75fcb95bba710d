"""Count photographs: rates with intervals, compared with the same person's clean pictures.

The table has a row for each detector and subject: garment, person, place, scene, distance (metres, nan where unknown),
pair, score, clean and operating_point; see `judging.judge`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float, Int, Shaped

from cloak_core.core.evaluation.intervals import RESAMPLES
from cloak_core.core.evaluation.statistics import (
    finite,
    operating_point,
    outcome_record,
    rate,
    rate_record,
    success_rate,
    undetected,
)
from cloak_core.studies.judging.listing import NOBODY, WITH, WITHOUT

CLUSTERS = ("person", "place")
"""Pictures of one person, and those of one place, succeed and fail together."""


def find_partners(subjects: pd.DataFrame) -> list[Int[np.ndarray, " _"]]:
    """Find each subject's clean pictures: the same person in the pair, or else in the same scene and distance.

    subjects: numbered from 0 by their index.
    """
    known = subjects.fillna({"distance": -1.0})
    clean = known[known["garment"] == WITHOUT]
    by_pair = clean[clean["pair"] != ""].groupby(["pair", "person"]).groups
    by_scene = clean[clean["scene"] != ""].groupby(["scene", "person", "distance"]).groups
    places = zip(*(known[name] for name in ("pair", "scene", "person", "distance")), strict=True)
    candidates = (by_pair.get((pair, who), by_scene.get((scene, who, far), [])) for pair, scene, who, far in places)
    return [np.array(partners, int) for partners in candidates]


def clean_scores(
    score: Float[np.ndarray, " N"], garment: Shaped[np.ndarray, " N"], partners: Sequence[Int[np.ndarray, " _"]]
) -> Float[np.ndarray, " N"]:
    """Compute the score that each subject is compared with: above a threshold if most clean partners are.

    nan without a partner. Clean subjects are compared with nothing: inf, always found.
    """
    most = [np.sort(score[p])[::-1][len(p) // 2] if len(p) else np.nan for p in partners]
    return np.where(garment == WITHOUT, np.inf, most)


def summarize_photographs(rows: pd.DataFrame, threshold: float, resamples: int = RESAMPLES) -> dict:
    """Count contract C7's figures: of the first detector, and of every one in `detectors`."""
    by_detector = {str(spec): of_spec for spec, of_spec in rows.groupby("detector", sort=False)}
    detectors = {spec: _detector_summary(of_spec, threshold, resamples) for spec, of_spec in by_detector.items()}
    rows, first = next(iter(by_detector.values())), next(iter(detectors.values()))
    people = rows[(rows["garment"] != NOBODY).to_numpy()]
    return {
        **{key: first[key] for key in (WITH, WITHOUT, "controls")},
        "people": people["person"].nunique(),
        "scenes": people["place"].nunique(),
        "threshold": threshold,
        "operating_points": {spec: operating_point(of_spec) for spec, of_spec in by_detector.items()},
        "detectors": detectors,
        "warnings": warnings(people),
    }


def _detector_summary(rows: pd.DataFrame, threshold: float, resamples: int) -> dict:
    own = operating_point(rows)
    record = lambda group: photograph_record(group, (threshold, own), resamples)
    garments = {WITH: rows[:0], WITHOUT: rows[:0]} | dict(list(rows.groupby("garment", sort=False)))
    empty = garments.pop(NOBODY, rows[:0])
    records = {name: record(group) for name, group in garments.items()}
    sides = {name: records.pop(name) for name in (WITH, WITHOUT)}
    groups = {"by_person": rows["person"]}
    if rows["scene"].astype(bool).any():
        groups["by_scene"] = rows["place"]
    if rows["distance"].notna().any():
        groups["by_distance"] = rows["distance"].map(lambda metres: "" if math.isnan(metres) else f"{metres:g}")
    people, by = rows[(rows["garment"] != NOBODY).to_numpy()], {}
    for name, labels in groups.items():
        parts = dict(list(people.groupby(labels[people.index])))
        by[name] = {
            key: {side: record(parts[key][parts[key]["garment"] == side]) for side in (WITH, WITHOUT)}
            for key in sorted(parts.keys() - {""}, key=_numbers_first)
        }
    alarms = {"false_alarms": finite(1 - success_rate(empty, threshold)), "n_nobody": len(empty)}
    return sides | {"controls": records} | by | alarms


def photograph_record(rows: pd.DataFrame, thresholds: tuple[float, float], resamples: int = RESAMPLES) -> dict:
    """Count one S of contract C6 for all people in a garment, at the judge's threshold and (`_own`) the detector's.

    detected: share of them that is found, of `n_all`. Of a cloak or a control, success: not found although the clean
    partner is, a share of all `n` with a partner, so that a person whom the clean picture misses is none; conditional:
    the share of the `n_conditional` whose clean partner is found. Of clean pictures, success is the share that is
    missed: the baseline miss rate. `renamed`, `gone`, `named`: see `outcome_record`; of all, told where every box is.
    """
    figures: dict = {"n": 0, "n_all": len(rows)}
    compared = rows[rows["clean"].notna().to_numpy()]
    estimate = lambda mine, hits: rate(mine, hits, CLUSTERS, resamples)
    for suffix, threshold in zip(("", "_own"), thresholds, strict=True):
        clean = (compared["clean"] > threshold).to_numpy()
        success = estimate(compared, undetected(compared, threshold) & clean)
        conditional = estimate(compared[clean], undetected(compared[clean], threshold))
        detected = estimate(rows, ~undetected(rows, threshold))
        for name, value in (("success", success), ("conditional", conditional), ("detected", detected)):
            figures |= rate_record(name + suffix, value)
        figures |= {f"n_conditional{suffix}": conditional.n, "n": success.n}
    return figures | outcome_record(rows, thresholds[0])


def warnings(people: pd.DataFrame) -> list[str]:
    """Say what the labels do not tell, and what follows for the figures. people: rows of one detector."""
    messages, cloaked = [], people[(people["garment"] == WITH).to_numpy()]
    alone = int(cloaked["clean"].isna().sum())
    if not len(cloaked):
        messages.append("no picture with the cloak")
    if not (people["garment"] == WITHOUT).any():
        messages.append("no picture without the cloak: what it hides cannot be told from what is missed anyway")
    elif alone:
        messages.append(f"{alone} cloaked pictures have no clean partner and are in no success")
    if (people["person"] == "").any():
        messages.append("not everybody's name is told: people without one are taken for one and the same")
    if (people["scene"] == "").any():
        messages.append(
            "not every scene is told: each pair is taken for a scene of its own, intervals may be too narrow"
        )
    if not people["boxed"].all():
        part = "not everybody's box is told" if people["boxed"].any() else "no boxes are told"
        messages.append(f"{part}: there, whoever is found anywhere in the picture counts as the person")
    return messages


def _numbers_first(key: str) -> tuple:
    try:
        return (0, float(key), key)
    except ValueError:
        return (1, 0.0, key)
