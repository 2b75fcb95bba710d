"""Measure false alarms on pictures of patterned cloth that nobody wears."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import repeat

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.detector import THRESHOLD
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.core.geometry import face_centres, face_normals
from cloak_core.core.logo import load_logo
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.face_lists import read_colors
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.studies.hardening.decoys import TEXTURE, FlatCloth, Texture, draw_decoy, random_texture
from cloak_core.studies.trained_run import read_run
from cloak_core.zoo.entry import MARK, run_path, shelved

COUNT, BATCH = 200, 8
CLOAK, RANDOM = "cloak", "random"
"""Kinds of pattern: flat panels and other shapes in the colours of trained cloaks, and in patterns nobody trained."""
FLAT_COUNT = 100
"""Pictures of each flat kind."""
FLAT = ("flat cloak", "flat blocks", "flat noise", "flat plain", "flat clothing")
"""Kinds of upright rectangle: a trained cloak, blocks of random colours, noise in every pixel, one colour, and what
the bodies wear themselves."""
CELLS = 12
"""Blocks along each side of a rectangle of blocks."""


@torch.no_grad()
def pattern_scores(
    detectors: Mapping[str, Detector],
    backgrounds: Backgrounds,
    bodies: Bodies,
    *,
    size: int = 416,
    seed: int = 0,
) -> pd.DataFrame:
    """Score pictures without people, with patterned cloth and without it.

    Half of the `COUNT` pictures show a cloak of the zoo that these bodies can wear (where there is one), the others a
    random pattern. Returns a row for each detector and picture: detector, image, pattern (kind), score (best person
    score), plain (the same without the cloth).
    """
    rng = np.random.default_rng([seed, 0xDEC0])
    rows = []
    drawn = _pictures(backgrounds, cloak_textures(bodies), size, rng)
    for first in range(0, COUNT, BATCH):
        batch = [next(drawn) for _ in range(min(BATCH, COUNT - first))]
        with_cloth, without = (torch.stack([pair[k] for pair in batch]) for k in (0, 1))
        for spec, detector in detectors.items():
            scores = [max_person_score(detector(i.to(detector.device))).cpu().numpy() for i in (with_cloth, without)]
            rows += [
                {"detector": spec, "image": first + k, "pattern": batch[k][2], "score": score, "plain": plain}
                for k, (score, plain) in enumerate(zip(*scores, strict=True))
            ]
    return pd.DataFrame(rows)


@torch.no_grad()
def flat_scores(detector: Detector, backgrounds: Backgrounds, bodies: Bodies, seed: int = 0) -> pd.DataFrame:
    """Score pictures without people with one upright rectangle of each kind in `FLAT`, and without it.

    Returns the columns of `pattern_scores`. Every kind has the same pictures and places. Bodies that can wear no cloak
    of the zoo have no "flat cloak".
    """
    cloaks = cloak_textures(bodies)
    flat = FlatCloth(face_centres(bodies), face_normals(bodies))
    clothes = [flat.texture(np.asarray(outfit, np.float32)) for outfit in bodies.face_colors]
    rows = []
    size = 416
    for image in range(FLAT_COUNT):
        plain = backgrounds.image(image % len(backgrounds), (size, size)).float() / 255
        textures = _flat_textures(cloaks, clothes, np.random.default_rng([seed, 0xF1A7, image]))
        shown = [
            draw_decoy(plain, repeat(texture), np.random.default_rng([seed, 0xF1A8, image]), flat=True)
            for texture in textures.values()
        ]
        scores = max_person_score(detector(torch.stack([plain, *shown]).to(detector.device))).cpu().numpy()
        row = {"detector": detector.spec, "image": image, "plain": scores[0]}
        rows += [row | {"pattern": kind, "score": score} for kind, score in zip(textures, scores[1:], strict=True)]
    return pd.DataFrame(rows)


def pattern_alarms(detector: Detector, backgrounds: Backgrounds, bodies: Bodies, seed: int = 0) -> dict[str, dict]:
    """Measure how often patterned cloth that nobody wears is reported as a person, by kind of pattern.

    The kinds are those of `pattern_scores` and `FLAT`.

    Returns {KIND: {"alarms": share of pictures above 0.6, "alarms_own": above the detector's own threshold, "plain",
    "plain_own": the same of these pictures without the cloth, "n"}}.
    """
    mixed = pattern_scores({detector.spec: detector}, backgrounds, bodies, seed=seed)
    table = pd.concat([mixed, flat_scores(detector, backgrounds, bodies, seed)])
    alarms = {}
    for kind, rows in table.groupby("pattern"):
        rates = {"n": len(rows)}
        for end, threshold in (("", THRESHOLD), ("_own", detector.operating_point)):
            for name, column in (("alarms", "score"), ("plain", "plain")):
                rates[name + end] = round(float((rows[column].astype(float) > threshold).mean()), 4)
        alarms[str(kind)] = rates
    return alarms


def _pictures(
    backgrounds: Backgrounds, cloaks: Sequence[Texture], size: int, rng: np.random.Generator
) -> Iterator[tuple[Float[Tensor, "3 H W"], Float[Tensor, "3 H W"], str]]:
    """Pictures with cloth, without it, and the kind of pattern."""
    for number in range(COUNT):
        plain = backgrounds.image(number % len(backgrounds), (size, size)).float() / 255
        worn = bool(cloaks) and number % 2 == 0
        texture = cloaks[rng.integers(len(cloaks))] if worn else random_texture(rng, lambda plain=plain: plain)
        yield draw_decoy(plain, repeat(texture), rng), plain, CLOAK if worn else RANDOM


def _flat_textures(
    cloaks: Sequence[Texture], clothes: Sequence[Texture], rng: np.random.Generator
) -> dict[str, Texture]:
    """Draw a texture of each kind in `FLAT`."""
    side = TEXTURE // CELLS
    drawn = {
        "flat blocks": np.kron(rng.random((3, CELLS, CELLS)), np.ones((1, side, side))),
        "flat noise": rng.random((3, TEXTURE, TEXTURE)),
        "flat plain": np.tile(rng.random((3, 1, 1)), (1, TEXTURE, TEXTURE)),
        "flat clothing": clothes[rng.integers(len(clothes))],
    }
    if cloaks:
        drawn["flat cloak"] = cloaks[rng.integers(len(cloaks))]
    return {kind: drawn[kind].astype(np.float32) for kind in FLAT if kind in drawn}


def cloak_textures(bodies: Bodies) -> list[Texture]:
    """Lay the zoo's cloaks that these bodies can wear flat, by name."""
    textures = []
    centres, normals = face_centres(bodies), face_normals(bodies)
    for name in sorted(shelved()):
        folder = run_path(MARK + name)
        if read_run(folder).get("topology") == bodies.topology:
            logo = load_logo(bodies, folder / "logo.npy")
            flat = FlatCloth(centres[logo.face_ids], normals[logo.face_ids])
            textures.append(flat.texture(read_colors(folder / "colors.npy", len(logo))))
    return textures
