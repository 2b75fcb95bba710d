"""Fits of many people, kept on disk between runs."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import fields

import numpy as np
from safetensors.numpy import load, save

from cloak_core.files.caching import DiskCache, cache_folder
from cloak_core.files.identity import sha256_record
from cloak_core.sources.photographs.fitting import Fit, Fitter
from cloak_core.sources.photographs.people import People, Person

VERSION = 1
"""Raised by hand whenever fits of the same person come out differently."""
LIMIT = 2 << 30
_STORED = tuple(field.name for field in fields(Fit) if field.name not in ("person", "quality", "scale"))


def fit_people(people: People, on_progress: Callable[[int, int], None] | None = None) -> list[Fit]:
    """Fit every person; those fitted before come from the cache. `on_progress` hears (people done, people in all)."""
    files = DiskCache(cache_folder("fits"), ".safetensors", LIMIT, "fits of people")
    fitter: Fitter | None = None
    found = []
    for number, person in enumerate(people.people):
        name = sha256_record({"person": person.identity, "box": person.box, "version": VERSION})
        data = files.get(name)
        if data is None:
            fitter = fitter or Fitter()
            packed = _packed(fitter.fit(person))
            files.put(name, packed)
        # Read back either way: a fit has the same bits the first time and later.
        found.append(_unpacked(packed if data is None else data.tobytes(), person))
        if on_progress is not None:
            on_progress(number + 1, len(people))
    return found


def people_identity(people: People) -> str:
    """SHA-256 over all people as they are dressed: pixels, masks, landmarks, and how they are fitted."""
    digest = hashlib.sha256(f"fits {VERSION}".encode())
    for person in people.people:
        digest.update(f"{person.identity} {person.box}".encode())
    return digest.hexdigest()


def _packed(fit: Fit) -> bytes:
    arrays = {name: getattr(fit, name) for name in _STORED}
    small = {"triangle": np.int32, "main": np.int32, "pixels": np.int32, "crow": np.int32}
    small |= {"share": np.float32, "rest": np.float32, "shading": np.float32}
    arrays = {name: np.ascontiguousarray(array, small.get(name, array.dtype)) for name, array in arrays.items()}
    numbers = {f"quality_{name}": value for name, value in fit.quality.items()} | {"scale": fit.scale}
    return save(arrays | {name: np.array([value], np.float64) for name, value in numbers.items()})


def _unpacked(data: bytes, person: Person) -> Fit:
    stored = load(data)
    whole = {"triangle": np.int64, "main": np.int64, "pixels": np.int64, "crow": np.int64}
    arrays = {name: stored[name].astype(whole.get(name, np.float64)) for name in _STORED}
    quality = {key.removeprefix("quality_"): float(stored[key][0]) for key in stored if key.startswith("quality_")}
    return Fit(person=person, quality=quality, scale=float(stored["scale"][0]), **arrays)
