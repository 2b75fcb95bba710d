"""The parts of a card: the images that each shows the detector, and the rows that it keeps beside card.json.

The rows of a part are a table for each repetition of its training (`Results`), in the folder rows/.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cloak_core.core.evaluate import bare_backgrounds
from cloak_core.core.evaluation.controls import CLOTHING, LOGO, NATURAL
from cloak_core.core.evaluation.results import NOBODY, TRUE_BOX, Results, read_results
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.evaluation.trials import COLUMNS, draw_trials
from cloak_core.files.errors import InputError
from cloak_core.sources.photographs.fits import UNCOVERED, UNFIT
from cloak_core.studies.card.certainty import UNTRAINED
from cloak_core.studies.card.protocol import AGAINST, CLEAN_ANGLES, CLEAN_DISTANCES, CLEAN_ELEVATIONS, Size

ROWS = "rows"
"""Folder beside card.json."""
BESIDE = (CLOTHING, "random")
"""Controls beside every cloak."""


@dataclass(frozen=True)
class Part:
    """One measurement of a card."""

    name: str
    """"clean", "area 76%", "circle", "zoo NAME", "pattern NAME", "people"."""
    angles: tuple[float, ...] = ()
    """Test azimuths, degrees."""
    settings: Mapping[str, object] = field(default_factory=dict)
    """Evaluation settings by name; none for people in photographs."""
    repetitions: int = 1
    """How often the cloak is trained."""

    @property
    def files(self) -> list[str]:
        """Names of the files of rows, one for each repetition."""
        return [f"{file_part(self.name)}.{k}.npz" for k in range(self.repetitions)]


def file_part(part: str) -> str:
    """Write a part's name as part of a file's name."""
    return "".join(letter if letter.isalnum() or letter in "-_=" else "-" for letter in part)


def part_of_area(area: float) -> str:
    """Name the part of an area's cloak."""
    return f"area {area:.0%}"


def make_part(name: str, size: Size, seed: int, poses: int) -> Part:
    """Make the part of this name. poses: how many unseen bodies there are."""
    if name == "people":
        return Part(name)
    settings = {"size": size.pixels, "shift": min(50, size.pixels // 8), "seed": seed}
    if name == "clean":
        # Own clothing and untrained patterns from everywhere, and bare scenes.
        views = len(CLEAN_ANGLES) * len(CLEAN_ELEVATIONS) * len(CLEAN_DISTANCES) * poses
        settings |= {
            "elevations": CLEAN_ELEVATIONS,
            "distances": CLEAN_DISTANCES,
            "images_per_view": math.ceil(size.clean_images / views),
            "most_images": size.clean_images,
            "bare": size.bare,
            "controls": (CLOTHING, "grey", "random", *NATURAL),
        }
        return Part(name, CLEAN_ANGLES, settings)
    settings |= {"images_per_view": size.images_per_view, "controls": BESIDE, "bare": 1}
    angles = size.circle_angles if name == "circle" else size.front_angles
    trained = name == "circle" or name.startswith("area ")
    return Part(name, angles, settings, size.seeds if trained else 1)


def parts_of(told: Mapping, size: Size) -> list[Part]:
    """List the parts of a card in the order of measuring. told: what a card says itself (`schema.CARD`)."""
    names = ["clean"]
    if told["differentiable"]:
        names += [*map(part_of_area, size.areas), *["circle"] * size.circle]
    names += [f"zoo {row['name']}" for row in told["black_box"]["zoo"]]
    names += [f"pattern {row['name']}" for row in told["patterns"]]
    names += ["people"] * (told.get("photographs") is not None)
    poses = len(told["materials"]["unseen"]["poses"])
    return [make_part(name, size, told["made"]["seed"], poses) for name in names]


# --- rows


def keep_rows(folder: Path, part: Part, repetitions: Sequence[Results]) -> None:
    """Write a part's rows beside the card."""
    (folder / ROWS).mkdir(exist_ok=True)
    for name, results in zip(part.files, repetitions, strict=True):
        results.save(folder / ROWS / name)


def drop_other_rows(folder: Path, parts: Sequence[Part]) -> None:
    """Remove rows of parts that the card does not have: of an earlier card of another size, or with people."""
    kept = {name for part in parts for name in part.files}
    for path in (folder / ROWS).glob("*.npz"):
        if path.name not in kept:
            path.unlink()


def read_rows(folder: Path, told: Mapping, size: Size) -> dict[str, list[Results]]:
    """Read the rows of all parts of a card, by part, and check them. InputError: see `check_rows`."""
    rows = {}
    for part in parts_of(told, size):
        rows[part.name] = [read_results(folder / ROWS / name) for name in part.files]
        for name, results in zip(part.files, rows[part.name], strict=True):
            check_rows(f"{folder / ROWS / name}", part, results, told, size)
    return rows


def check_rows(name: str, part: Part, results: Results, told: Mapping, size: Size) -> None:
    """Check that one repetition's rows are of the images that the protocol asks for, and of this card's detector.

    name: of the file. InputError: what differs.
    """
    unseen, images, columns = told["materials"]["unseen"], results.images, (*COLUMNS, *TRUE_BOX)
    if part.name == "people":
        asked, columns = _people_asked(told, results, size), (*columns, "photograph", "seen_from")
    else:
        settings = EvaluateSettings(**part.settings)
        count = len(results.background_names)
        trials = draw_trials(len(unseen["poses"]), part.angles, count, unseen["outfits"], settings)
        asked = {
            "bodies": (list(results.body_names), unseen["poses"]),
            "controls": (results.controls, (LOGO, *dict.fromkeys((CLOTHING, *settings.controls)))),
            "images": (_numbers(results.trials), _numbers(trials)),
            "bare scenes": (
                images.loc[(images["control"] == NOBODY).to_numpy(), "background"].tolist(),
                bare_backgrounds(count, settings).tolist(),
            ),
        }
    asked["columns"] = set(results.trials), set(columns)
    asked["detector"] = results.detectors, (told["spec"],)
    asked["operating point"] = set(images["operating_point"]), {told["operating_point"]}
    asked["number of backgrounds"] = len(results.background_names), told["materials"]["unseen_backgrounds"]["count"]
    asked["scores from 0 to 1"] = bool(images["score"].between(0, 1).all()), True
    for what, (found, expected) in asked.items():
        if found != expected:
            raise InputError(f"{name}: {what}: {found!r:.60}; this card and its size ask for {expected!r:.60}")


def _numbers(trials: object) -> list:
    return np.nan_to_num(trials[list(COLUMNS)].to_numpy(np.float64), nan=-1).tolist()


def _people_asked(told: Mapping, results: Results, size: Size) -> dict[str, tuple[object, object]]:
    """Compare the rows of people in photographs: each of them once, in the cloaks and patterns of the card."""
    people, rendered = told["materials"]["shown_people"]["count"], [row["name"] for row in told["patterns"]]
    left_out = sum(told["photographs"]["left_out"].get(reason, 0) for reason in (UNFIT, UNCOVERED))
    worn, made = results.controls[: -len(UNTRAINED)], [AGAINST] * told["differentiable"]
    return {
        "people": (results.trials["pose"].tolist(), list(range(people - left_out))),
        "controls": (results.controls[len(worn) :], UNTRAINED),
        "cloak made against it": ([name for name in worn if name == AGAINST], made),
        "patterns": ([name for name in worn if name in rendered], rendered),
        "size": (len(results.trials) <= size.people and sum("@" in name for name in worn) <= size.patterns, True),
    }
