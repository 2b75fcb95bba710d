"""What detectors said of every image, as one tidy table: a row for each training, detector, control and image.

The table is a pandas DataFrame: it is what the field plots and tests with, and its columns are the numpy arrays that
the intervals are computed from, so no figure depends on it. Success rates, intervals and average precision are
group-bys over this table: `statistics`, `intervals` and `precision` compute them, and `studies/statistics_*.py` what
cards, films and photographs have of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float32
from pandas.api.types import is_numeric_dtype

from cloak_core.core.evaluation import CLOTHING, STANDARD
from cloak_core.core.evaluation.trials import COLUMNS, complete
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_npz
from cloak_core.files.writing import write_npz

FORMAT = "cloak measurement 1"
NOBODY = "nobody"
"""The control of bare backgrounds: images without a person, on which every reported person is a false alarm."""
BOX_COLUMNS = {"detector": np.int64, "control": np.int64, "image": np.int64, "score": np.float32, "hit": np.bool_}
BOX_COLUMNS |= {"iou": np.float64}
CORNERS = ("x1", "y1", "x2", "y2")
TRUE_BOX = tuple(f"body_{corner}" for corner in CORNERS)
"""Columns of what an image shows: the true box of its person, pixels."""


_MEASURED = {"training", "detector", "control", "image", "body", "score", "score_on", "clean", "other", "other_name"}
_MEASURED |= {"operating_point"}


@dataclass(frozen=True, eq=False)
class Results:
    """The tidy table of an evaluation, and the person boxes behind it.

    `images` has, for each row: training (which repetition, from 0), detector (spec) and control (categories in the
    order of measuring), image (its number), the columns of the trials, body (its name, None where absent), score (best
    person score anywhere in the image), score_on (best person score among boxes that overlap the body with IoU >= 0.5),
    clean (score of the same image under the body's own clothing), other and other_name (best score of another class
    on the body that was not there in own clothing, and that class; nan and "" where the detector does not tell),
    operating_point (the detector's own threshold; nan where unknown). Bare backgrounds are rows of the control
    `NOBODY`, without pose.

    `boxes`: person boxes after non-maximum suppression, an image's together, best first: training, detector, control,
    image, score, hit (the best one that overlaps the body with IoU >= 0.5), iou (nan in files of old versions), and
    its corners x1, y1, x2, y2 in pixels, which are not saved (nan where read back).
    """

    images: pd.DataFrame
    boxes: pd.DataFrame
    detectors: tuple[str, ...]
    controls: tuple[str, ...]
    """Without `NOBODY`; the first is the trained logo."""
    body_names: tuple[str, ...]
    background_names: tuple[str, ...]

    @property
    def trainings(self) -> int:
        """How many repetitions of the training were measured."""
        return int(self.images["training"].max()) + 1

    def rows(self, detector: str, control: str, **where: float | int) -> pd.DataFrame:
        """Select the rows of a detector under a control, in the order of images; `where`: columns with these values.

        Several trainings share their bodies' own clothing, grey and random colours: those are counted once.
        """
        table = self.images
        kept = (table["detector"] == detector).to_numpy() & (table["control"] == control).to_numpy()
        if control in (*STANDARD, NOBODY):
            kept &= table["training"].to_numpy() == 0
        for column, value in where.items():
            kept &= np.isclose(table[column].to_numpy(), value)
        return table[kept]

    def boxes_of(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Select the boxes in the images of these rows (of one detector and control)."""
        if not len(rows):
            return self.boxes[:0]
        first = rows.iloc[0]
        boxes = self._boxes_by.get((first["detector"], first["control"]), self.boxes[:0])
        shown = np.zeros((self.trainings, int(self.images["image"].max()) + 1), bool)
        shown[rows["training"].to_numpy(), rows["image"].to_numpy()] = True
        return boxes[shown[boxes["training"].to_numpy(), boxes["image"].to_numpy()]]

    @cached_property
    def _boxes_by(self) -> dict[tuple[str, str], pd.DataFrame]:
        """The boxes by detector and control: an evaluation has millions, and asks for few of them many times."""
        return dict(list(self.boxes.groupby(["detector", "control"], observed=True)))

    def scores(self, detector: str, control: str, training: int = 0) -> np.ndarray:
        """Select one training's scores [N] of one detector under one control, in the order of images."""
        rows = self.rows(detector, control)
        return rows.loc[rows["training"] == training, "score"].to_numpy()

    @property
    def trials(self) -> pd.DataFrame:
        """What the N images show: `trials.COLUMNS` and the columns of the source of views, in order."""
        first = self.rows(self.detectors[0], self.controls[0])
        columns = [name for name in self.images if name not in _MEASURED]
        return first.loc[first["training"] == 0, columns].reset_index(drop=True)

    def save(self, path: Path) -> None:
        """Write one training's results as a compressed .npz, in the format that earlier versions read."""
        if self.trainings > 1:
            raise ValueError("one training a file")
        trials = self.trials
        grid = (len(self.detectors), len(self.controls), len(trials))
        nobody = (self.images["control"] == NOBODY).to_numpy()
        person, bare = self.images[~nobody], self.images[nobody]
        others = ("other", "other_name") if person["other"].notna().any() else ()
        names = ("controls", "body_names", "background_names")
        arrays = {"format": np.array(FORMAT), "specs": np.array(self.detectors, np.str_)}
        arrays |= {name: np.array(getattr(self, name), np.str_) for name in names}
        arrays |= {name: _plain(person[name]).reshape(grid) for name in ("score", "score_on", *others)}
        arrays["bare"] = bare["score"].to_numpy().reshape(grid[0], -1)
        arrays["bare_background"] = bare["background"].to_numpy().reshape(grid[0], -1)[0]
        arrays["operating_points"] = person["operating_point"].to_numpy().reshape(grid)[:, 0, 0]
        arrays |= {f"trials_{name}": _plain(trials[name]) for name in trials if not name.startswith("shift_")}
        arrays["trials_shift"] = trials[["shift_x", "shift_y"]].to_numpy()
        codes = {name: self.boxes[name].cat.codes for name in ("detector", "control")}
        for name, kind in BOX_COLUMNS.items():
            arrays[f"boxes_{name}"] = np.asarray(codes.get(name, self.boxes[name]), kind)
        write_npz(path, compressed=True, **arrays)


def _plain(column: pd.Series) -> np.ndarray:
    """Convert a column to an array, text to an array of its own kind: objects are never read back."""
    return column.to_numpy() if is_numeric_dtype(column) else column.to_numpy().astype(np.str_)


def make_results(
    detectors: Mapping[str, float | None],
    controls: Sequence[str],
    trials: pd.DataFrame,
    score: Float32[np.ndarray, "D C N"],
    score_on: Float32[np.ndarray, "D C N"],
    bare: Float32[np.ndarray, "D M"],
    boxes: Mapping[str, np.ndarray],
    *,
    body_names: Sequence[str],
    background_names: Sequence[str],
    bare_background: np.ndarray | None = None,
    other: Float32[np.ndarray, "D C N"] | None = None,
    other_name: np.ndarray | None = None,
) -> Results:
    """Make the tidy table from scores of D detectors under C controls on N images and M bare backgrounds.

    detectors: spec -> operating point, None where unknown. trials: what the N images show, any columns. boxes: columns
    of `BOX_COLUMNS`, where detector and control are numbers, and `CORNERS` where known. bare_background: [M] indices of
    the backgrounds. other, other_name: [D, C, N] best score of another class on the body, and its name.
    """
    specs = tuple(detectors)
    points = [np.nan if point is None else point for point in detectors.values()]
    kinds = {"detector": pd.CategoricalDtype(specs)}
    kinds["control"] = pd.CategoricalDtype([*dict.fromkeys(controls), NOBODY])
    trials = complete(trials)
    person = _grid(kinds, score.shape, trials)
    person["score"], person["score_on"] = score.ravel(), score_on.ravel()
    clean = controls.index(CLOTHING) if CLOTHING in controls else None
    person["clean"] = np.nan if clean is None else np.broadcast_to(score[:, [clean]], score.shape).ravel()
    person["other"] = np.float32(np.nan) if other is None else other.ravel()
    person["other_name"] = "" if other_name is None else other_name.astype(object).ravel()
    person["operating_point"] = np.repeat(points, score.shape[1] * score.shape[2])
    count = bare.shape[1]
    behind = np.arange(count) if bare_background is None else bare_background
    nobody = _grid(kinds, (len(specs), 1, count), complete(pd.DataFrame({"background": behind})))
    nobody["control"] = pd.Categorical.from_codes(np.full(len(nobody), len(controls)), dtype=kinds["control"])
    nobody["score"] = bare.ravel()
    nobody["operating_point"] = np.repeat(points, count)
    nobody["other_name"] = ""
    for name in set(person) - set(nobody):
        # Concatenation would turn absent text and numbers into objects otherwise.
        nobody[name] = np.float32(np.nan) if is_numeric_dtype(person[name]) else ""
    images = pd.concat([person, nobody[person.columns]], ignore_index=True)
    images.insert(0, "training", 0)
    images["body"] = np.array([*body_names, None], object)[images["pose"].to_numpy()]
    return Results(images, _box_table(boxes, kinds), specs, tuple(controls), tuple(body_names), tuple(background_names))


def _grid(kinds: Mapping[str, pd.CategoricalDtype], shape: tuple[int, ...], trials: pd.DataFrame) -> pd.DataFrame:
    """Make a row for each of D detectors, C controls and N images, in this order, with what the images show."""
    detector, control, image = (index.ravel() for index in np.indices(shape))
    table = pd.DataFrame({"detector": pd.Categorical.from_codes(detector, dtype=kinds["detector"])})
    table["control"] = pd.Categorical.from_codes(control, dtype=kinds["control"])
    table["image"] = image
    for name in trials:
        table[name] = np.broadcast_to(trials[name].to_numpy(), shape).ravel()
    return table


def _box_table(boxes: Mapping[str, np.ndarray], kinds: Mapping[str, pd.CategoricalDtype]) -> pd.DataFrame:
    table = pd.DataFrame({name: np.asarray(boxes[name], kind) for name, kind in BOX_COLUMNS.items()})
    for name, kind in kinds.items():
        table[name] = pd.Categorical.from_codes(table[name].to_numpy(), dtype=kind)
    for name in CORNERS:
        table[name] = np.asarray(boxes[name], np.float32) if name in boxes else np.float32(np.nan)
    table.insert(0, "training", 0)
    return table


def pool(results: Sequence[Results]) -> Results:
    """Put repetitions of one training, judged on the same images, into one table: `training` counts them."""
    parts = [(part.images.assign(training=k), part.boxes.assign(training=k)) for k, part in enumerate(results)]
    images, boxes = (pd.concat(tables, ignore_index=True) for tables in zip(*parts, strict=True))
    first = results[0]
    return Results(images, boxes, first.detectors, first.controls, first.body_names, first.background_names)


def read_results(path: Path) -> Results:
    """Read what `Results.save` or an earlier version wrote; InputError names a file that is something else."""
    arrays = read_npz(path)
    if str(arrays.get("format")) != FORMAT:
        raise InputError(f"{path}: not a {FORMAT}")
    try:
        names = {k: tuple(map(str, arrays[k])) for k in ("specs", "controls", "body_names", "background_names")}
        points = arrays.get("operating_points", np.full(len(names["specs"]), np.nan))
        kept = {key.removeprefix("trials_"): values for key, values in arrays.items() if key.startswith("trials_")}
        kept["shift_x"], kept["shift_y"] = kept.pop("shift").T
        # Early versions had one elevation for all images and did not keep it.
        kept.setdefault("elevation", np.full(len(kept["pose"]), np.float32(np.nan)))
        trials = pd.DataFrame({name: kept[name] for name in dict.fromkeys((*COLUMNS, *kept))})
        boxes = {name: arrays[f"boxes_{name}"] for name in BOX_COLUMNS if name != "iou"}
        boxes["iou"] = arrays.get("boxes_iou", np.full(len(boxes["score"]), np.nan))
        return make_results(
            dict(zip(names["specs"], map(float, points), strict=True)),
            names["controls"],
            trials,
            *(arrays[name] for name in ("score", "score_on", "bare")),
            boxes,
            body_names=names["body_names"],
            background_names=names["background_names"],
            bare_background=arrays.get("bare_background"),
            other=arrays.get("other"),
            other_name=arrays.get("other_name"),
        )
    except KeyError as error:
        raise InputError(f"{path}: {error} is missing") from None
