"""From what detectors say of photographs to rates with intervals; a person whom the clean picture misses is no
success."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32

from cloak_core.evaluation.intervals import Rate, clustered_rate
from cloak_core.evaluation.photographs.listing import NOBODY, WITH, WITHOUT, Subject
from cloak_core.evaluation.photographs.looking import Looks
from cloak_core.evaluation.photographs.settings import JudgeSettings


@dataclass(frozen=True, eq=False)
class Sample:
    """Who is seen where in N subjects' pictures, and which clean ones each is compared with."""

    garment: np.ndarray
    person: np.ndarray
    place: np.ndarray
    partners: list[np.ndarray]
    """Of each subject: the same person's clean pictures of the pair, or else of the same scene and distance."""


def summarize(looks: Looks, settings: JudgeSettings) -> dict:
    """Contract C7's figures, those of the first detector, and of every one in `detectors`."""
    sample = make_sample(looks.subjects)
    detectors = {
        spec: _detector(looks, sample, looks.score[d], own, settings)
        for d, (spec, own) in enumerate(zip(looks.specs, looks.own, strict=True))
    }
    people = [subject for subject in looks.subjects if subject.garment != NOBODY]
    return {
        **{key: value for key, value in detectors[looks.specs[0]].items() if key in (WITH, WITHOUT, "controls")},
        "people": len({subject.person for subject in people}),
        "scenes": len({subject.place for subject in people}),
        "pictures": len(looks.pictures),
        "threshold": settings.threshold,
        "operating_points": dict(zip(looks.specs, looks.own, strict=True)),
        "detectors": detectors,
        "skipped": looks.skipped,
        "warnings": _warnings(people, sample),
    }


def make_sample(subjects: list[Subject]) -> Sample:
    """Labels as arrays, and everybody's clean partners."""
    by_pair: dict[tuple, list[int]] = {}
    by_scene: dict[tuple, list[int]] = {}
    for i, one in enumerate(subjects):
        if one.garment == WITHOUT:
            if one.pair:
                by_pair.setdefault((one.pair, one.person), []).append(i)
            if one.scene:
                by_scene.setdefault((one.scene, one.person, one.distance), []).append(i)
    partners = [
        np.array(by_pair.get((one.pair, one.person)) or by_scene.get((one.scene, one.person, one.distance), []), int)
        for one in subjects
    ]
    columns = (np.array([getattr(one, name) for one in subjects]) for name in ("garment", "person", "place"))
    return Sample(*columns, partners)


def _detector(looks: Looks, sample: Sample, score: np.ndarray, own: float, settings: JudgeSettings) -> dict:
    told = lambda garment, mask=True: record(sample, score, garment, settings, own, mask)
    controls = [name for name in dict.fromkeys(sample.garment.tolist()) if name not in (WITH, WITHOUT, NOBODY)]
    groups = {"by_person": sample.person}
    if any(one.scene for one in looks.subjects):
        groups["by_scene"] = sample.place
    if any(one.distance is not None for one in looks.subjects):
        metres = ["" if one.distance is None else f"{one.distance:g}" for one in looks.subjects]
        groups["by_distance"] = np.array(metres)
    found = {WITH: told(WITH), WITHOUT: told(WITHOUT), "controls": {name: told(name) for name in controls}}
    for name, labels in groups.items():
        keys = sorted({str(k) for k in labels[sample.garment != NOBODY] if k}, key=_numbers_first)
        found[name] = {key: {side: told(side, labels == key) for side in (WITH, WITHOUT)} for key in keys}
    empty = sample.garment == NOBODY
    found["false_alarms"] = _finite(float((score[empty] > settings.threshold).mean())) if empty.any() else None
    found["n_nobody"] = int(empty.sum())
    return found


def record(
    sample: Sample,
    score: Float32[np.ndarray, N],
    garment: str,
    settings: JudgeSettings,
    own: float,
    mask: Bool[np.ndarray, N] | bool = True,
) -> dict:
    """One S of contract C6 about everybody in a garment, at the judge's threshold and (`_own`) the detector's.

    detected: share of them that is found, of `n_all`. Of a cloak or a control, success: not found although the clean
    partner is, a share of all `n` with a partner, so that a person whom the clean picture misses is none; conditional:
    the share of the `n_conditional` whose clean partner is found. Of several partners more than half must be. Of
    `without` itself, success is the share that is missed: what no cloak may take credit for.
    """
    mine = mask & (sample.garment == garment)
    told: dict = {"n": 0, "n_all": int(mine.sum())}
    for suffix, threshold in (("", settings.threshold), ("_own", own)):
        found = score > threshold
        partner = np.array([len(p) > 0 for p in sample.partners], bool)
        clean = np.array([len(p) > 0 and found[p].mean() > 0.5 for p in sample.partners], bool)
        if garment == WITHOUT:
            partner, clean = np.ones_like(mine), np.ones_like(mine)
        rate = lambda hits, where: _rate(sample, hits, where, settings.resamples)
        success, conditional = rate(~found & clean, mine & partner), rate(~found, mine & partner & clean)
        detected = rate(found, mine)
        told |= {
            f"success{suffix}": _finite(success.value),
            f"ci95{suffix}": _interval(success),
            f"conditional{suffix}": _finite(conditional.value),
            f"ci95_conditional{suffix}": _interval(conditional),
            f"n_conditional{suffix}": conditional.n,
            f"detected{suffix}": _finite(detected.value),
            f"ci95_detected{suffix}": _interval(detected),
        }
        told["n"] = success.n
    return told


def _rate(sample: Sample, hits: np.ndarray, where: np.ndarray, resamples: int) -> Rate:
    return clustered_rate(hits[where], *_codes(sample.person[where], sample.place[where]), resamples=resamples)


def _codes(*columns: np.ndarray) -> list[np.ndarray]:
    """Labels as whole numbers."""
    return [np.unique(column, return_inverse=True)[1].astype(np.int64) for column in columns]


def _warnings(people: list[Subject], sample: Sample) -> list[str]:
    said, cloaked = [], sample.garment == WITH
    alone = sum(not len(p) for p, mine in zip(sample.partners, cloaked, strict=True) if mine)
    if not cloaked.any():
        said.append("no picture with the cloak")
    if not (sample.garment == WITHOUT).any():
        said.append("no picture without the cloak: what it hides cannot be told from what is missed anyway")
    elif alone:
        said.append(f"{alone} cloaked pictures have no clean partner and are in no success")
    if any(not one.person for one in people):
        said.append("not everybody's name is told: people without one are taken for one and the same")
    if any(not one.scene for one in people):
        said.append("not every scene is told: each pair is taken for a scene of its own, intervals may be too narrow")
    boxed = sum(one.box is not None for one in people)
    if boxed < len(people):
        part = "not everybody's box is told" if boxed else "no boxes are told"
        said.append(f"{part}: there, whoever is found anywhere in the picture counts as the person")
    return said


def _numbers_first(key: str) -> tuple:
    try:
        return (0, float(key), key)
    except ValueError:
        return (1, 0.0, key)


def _interval(rate: Rate) -> list[float | None]:
    return [_finite(rate.low), _finite(rate.high)]


def _finite(value: float) -> float | None:
    return round(value, 6) if math.isfinite(value) else None
