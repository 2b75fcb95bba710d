"""A page of pairs for raters who do not know what is what: the same person twice, in other clothes, without boxes."""

from __future__ import annotations

import base64
import csv
import io
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from PIL import Image

from cloak_core.evaluation.report.page import write_page
from cloak_core.evaluation.wearing.judging import Shot
from cloak_core.files.writing import write_text

SIDE = 360
"""Width and height of a picture on the page, pixels."""


class Rating:
    """Pairs drawn from all people and all pairs of clothes; which picture is left is drawn as well."""

    def __init__(self, folder: Path, people: Sequence[str], clothes: Sequence[str], count: int) -> None:
        """clothes: two names or more. count: of the pairs, at most.

        Each two clothes are compared as often as any others, on people in an order of their own.
        """
        self._folder, self._people = folder, people
        rng, both = np.random.default_rng(0), list(combinations(clothes, 2))
        asked = [both[k % len(both)] for k in range(min(count, len(people) * len(both)))]
        turns = [rng.permutation(len(people)) for _ in both]
        self._pairs = [
            (tuple(rng.permutation(names).tolist()), int(turns[k % len(both)][k // len(both)]))
            for k, names in enumerate(asked)
        ]
        rng.shuffle(self._pairs)
        self._wanted = {(name, person) for names, person in self._pairs for name in names}
        self._pictures: dict[tuple[str, int], str] = {}

    def add(self, shot: Shot) -> None:
        """Keep an image that a pair shows."""
        if (shot.name, shot.person) in self._wanted:
            pixels = (shot.image.permute(1, 2, 0).numpy() * 255).round().astype(np.uint8)
            picture = Image.fromarray(pixels).resize((SIDE, SIDE), Image.Resampling.LANCZOS)
            data = io.BytesIO()
            picture.save(data, "JPEG", quality=90)
            self._pictures[shot.name, shot.person] = (
                f"data:image/jpeg;base64,{base64.b64encode(data.getvalue()).decode()}"
            )

    def write(self) -> None:
        """Write rate.html, which does not say what is what, and rate-key.csv, which does."""
        shown = [[self._pictures[name, person] for name in names] for names, person in self._pairs]
        write_page(self._folder / "rate.html", "rate.html", {"title": "Which one?", "pairs": shown})
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(("pair", "left", "right", "person"))
        rows.writerows((k, *names, self._people[person]) for k, (names, person) in enumerate(self._pairs, 1))
        write_text(self._folder / "rate-key.csv", text.getvalue())
