"""A card before anything is measured, to check the keys of a gate: its places hold, its figures do not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from cloak_core.core.evaluation.controls import CLOTHING, LOGO
from cloak_core.core.evaluation.results import BOX_COLUMNS, CORNERS, TRUE_BOX, Results, make_results
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.evaluation.trials import draw_trials
from cloak_core.studies.card.figures import card_of
from cloak_core.studies.card.protocol import AGAINST, GREY_HEAD, HEADS, UNTRAINED, Part, Size, parts_of
from cloak_core.zoo.entry import MARK


def expected_card(told: Mapping, size: Size, worn: Sequence[str]) -> dict:
    """Make the card of a call from rows in which a detector finds everybody in own clothing, and nobody else.

    told: what the card will say itself (`schema.CARD`); worn: the patterns of people in photographs, by name.
    """
    zoo = [MARK + row["name"] for row in told["black_box"]["zoo"] if not row["trained_against_it"]]
    shown = (*[AGAINST] * told["differentiable"], *zoo[:1], *worn, *HEADS, GREY_HEAD, *UNTRAINED)
    card = card_of(told, size, {part.name: [_rows(part, told, shown)] for part in parts_of(told, size)})
    if card["photographs"] and zoo:
        rows = card["photographs"]["rows"]
        rows |= dict.fromkeys(zoo, rows[zoo[0]])  # which of them people wear is known when all are measured
    return {key: value for key, value in card.items() if value is not None}


def _rows(part: Part, told: Mapping, shown: Sequence[str]) -> Results:
    """Make up the rows of a part. shown: what people in photographs wear."""
    if part.name == "people":
        controls, bodies = shown, ("front", "side", "back")
        trials = pd.DataFrame({"pose": range(3), "background": 0, "photograph": "", "seen_from": bodies})
    else:
        settings, unseen = EvaluateSettings(**part.settings), told["materials"]["unseen"]
        controls, bodies = (LOGO, *dict.fromkeys((CLOTHING, *settings.controls))), unseen["poses"]
        trials = draw_trials(len(bodies), part.angles, 1, unseen["outfits"], settings)
    trials = trials.assign(**dict.fromkeys(TRUE_BOX, 0.0))
    score = np.zeros((1, len(controls), len(trials)), np.float32)
    score[:, controls.index(CLOTHING)] = 1
    boxes = {name: np.zeros(0, kind) for name, kind in BOX_COLUMNS.items()} | {name: np.zeros(0) for name in CORNERS}
    bare = np.zeros((1, 1), np.float32)
    names = {"body_names": bodies, "background_names": ("",), "other_name": np.full(score.shape, "other")}
    own = {told["spec"]: told["operating_point"]}
    return make_results(own, controls, trials, score, score, bare, boxes, other=np.ones_like(score), **names)
