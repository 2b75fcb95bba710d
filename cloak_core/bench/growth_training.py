"""What grows in training: people in photographs, detectors that are trained against, squares of a cloth."""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from cloak_core.bench.step import Bench
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.settings import make_settings
from cloak_core.detectors.loading import load_detector
from cloak_core.files.writing import write_json
from cloak_core.patterns.controls import OwnClothing, controls
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.photographs.annotation import BLAZEPOSE
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.people import People, Person, load_people
from cloak_core.studies.coco import run_lengths
from cloak_core.studies.opening import clothes_cover

BATCH = 8
STEPS = 12
"""Timed steps; with people each shows others."""
WORN = 64
"""People who are dressed, spread over all; their time is that of all of them."""
SIZE = 416
LEAST, MOST = 110, 400
"""Heights of simulated people, pixels."""
SHARD = 1000
"""People of one file."""


def grow_people(count: int, people: str, images: Path | None) -> dict[str, float]:
    """Read, fit, train on and dress `count` simulated people, from nothing on disk: seconds of each, and in all.

    read: the first time; again: as the next command reads them; fit: all of them, on all cores; step, floor:
    milliseconds of an update on `BATCH` of them, and of its detector alone; wear: everybody dressed once; disk:
    kilobytes of fits a person.
    """
    seconds: dict[str, float] = {}

    def timed(name: str, action: Callable[[], object]) -> object:
        started = time.perf_counter()
        result = action()
        seconds[name] = time.perf_counter() - started
        return result

    with tempfile.TemporaryDirectory() as folder:
        listed = write_simulated(load_people(people, images), count, Path(folder, "people"))
        os.environ["CLOAK_CACHE"] = str(Path(folder, "cache"))
        everybody = timed("read_s", lambda: load_people(listed))
        timed("again_s", lambda: load_people(listed))
        crowd = Crowd(everybody)
        fits = timed("fit_s", lambda: crowd.fits)
        stored = sum(path.stat().st_size for path in Path(folder, "cache", "fits").iterdir())
        settings = make_settings("photographs", batch=BATCH, size=SIZE, steps=1000)
        bench = Bench(load_scene("sample[0:1]"), None, load_backgrounds("procedural:train:8"), settings, crowd)
        step = bench.measure([load_detector("builtin")], STEPS)
        grey = controls(("grey",), OwnClothing(clothes_cover()))["grey"]
        shown = crowd.images(load_backgrounds("procedural:test:1"), WearSettings(size=SIZE))
        some = np.linspace(0, len(fits) - 1, min(WORN, len(fits))).astype(int).tolist()
        timed("wear_s", lambda: [shown.render([k], grey) for k in some])
        seconds["wear_s"] *= len(fits) / len(some)
        figures = {"step_ms": step["step_ms"], "floor_ms": step["floor_ms"], "disk_kB": stored / len(fits) / 1000}
        return {"seconds": seconds["read_s"] + seconds["fit_s"]} | seconds | figures


def grow_step(detectors: int = 1, squares: int | None = None) -> dict[str, float]:
    """Train against copies of the embedded detector, or with a cloth of about so many squares: seconds of a step."""
    changes: dict[str, object] = {"batch": 2, "size": 224, "steps": 1000}
    if squares is not None:
        changes |= {"pattern": "tile", "tile_cm": 50.0, "feature_cm": 50.0 / round(math.sqrt(squares))}
    settings = make_settings("best", **changes)
    bench = Bench(load_scene("sample[0:1]"), None, load_backgrounds("procedural:train:8"), settings)
    step = bench.measure([load_detector("builtin") for _ in range(detectors)], STEPS)
    return {"seconds": step["step_ms"] / 1000, "floor_ms": step["floor_ms"]}


def write_simulated(people: People, count: int, folder: Path) -> Path:
    """Write `count` people in COCO's format, `SHARD` a file, and the list of these files, which is returned.

    Each is one of `people`, scaled and recoloured, and has a photograph of her own.
    """
    folder.mkdir(parents=True)
    names = []
    for start in range(0, count, SHARD):
        numbers = range(start, min(start + SHARD, count))
        made = [_simulated(people.people[number % len(people)], number, folder) for number in numbers]
        names.append(f"people-{start // SHARD}.json")
        images, annotations = zip(*made, strict=True)
        write_json(folder / names[-1], {"images": images, "annotations": annotations})
    path = folder / "people.txt"
    path.write_text("\n".join(names) + "\n", encoding="utf-8")
    return path


def _simulated(person: Person, number: int, folder: Path) -> tuple[dict, dict]:
    """Save a scaled and recoloured photograph of a person; COCO's records of the image and of the person."""
    random = np.random.default_rng(number)
    rows = np.flatnonzero(person.mask.any(axis=1))
    scale = float(np.clip(random.uniform(0.7, 1.15), *np.array([LEAST, MOST]) / (rows[-1] + 1 - rows[0])))
    size = round(person.image.shape[1] * scale), round(person.image.shape[0] * scale)
    recolored = np.clip(person.image * random.uniform(0.75, 1.25, 3), 0, 255).astype(np.uint8)
    picture = Image.fromarray(recolored).resize(size, Image.Resampling.BILINEAR)
    picture.save(folder / f"{number}.jpg", quality=90)
    mask = np.array(Image.fromarray(person.mask).resize(size, Image.Resampling.NEAREST))
    y, x = np.nonzero(mask)
    landmarks = person.landmarks.moved((0.0, 0.0), scale)
    points, depth, visibility = np.zeros((33, 2)), np.zeros(33), np.zeros(33)
    points[list(BLAZEPOSE)], visibility[list(BLAZEPOSE)] = landmarks.xy, landmarks.visibility
    if landmarks.depth is not None:
        depth[list(BLAZEPOSE)] = -landmarks.depth
    pose = {"xy": points.ravel(), "visibility": visibility, "z": depth}
    return {"id": number, "file_name": f"{number}.jpg", "width": size[0], "height": size[1]}, {
        "id": number,
        "image_id": number,
        "iscrowd": 0,
        "bbox": [int(x.min()), int(y.min()), int(np.ptp(x)) + 1, int(np.ptp(y)) + 1],
        "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
        "blazepose": {name: values.round(2).tolist() for name, values in pose.items()},
    }
