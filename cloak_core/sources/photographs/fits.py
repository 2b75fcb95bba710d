"""Fits of many people, kept on disk and read when somebody is shown.

A fit takes about 160,000 bytes there. What is equal is stored once: pixels beyond the body borrow a row of the body.
Shares of pixels and shading are 16-bit steps (of 1 / 65535, and of the shading's range); positions on the body at rest
follow from the pose. Everything is then whole numbers below 65536, their low and high bytes apart, deflated.
"""

from __future__ import annotations

import contextlib
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import compress

import numpy as np
from jaxtyping import Integer
from safetensors.numpy import load, save

from cloak_core.files.caching import DiskCache, MemoryCache, cache_folder
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record
from cloak_core.files.reading import read_ahead
from cloak_core.jobs.job import Executor, Job, in_order
from cloak_core.jobs.processes import Processes
from cloak_core.sources.photographs.fitting import Fit, entries_of_rows, fit_all
from cloak_core.sources.photographs.people import People
from cloak_core.sources.photographs.person import Person
from cloak_core.sources.photographs.posing import Posed
from cloak_core.sources.photographs.shading import LIMITS

VERSION = 2
"""Raised by hand whenever fits of the same person come out differently.

2: stored compactly (`pack_fit`), which moves a pixel of a view by less than 0.001.
"""
LEAST_COVERED, MOST_SPILLED = 0.4, 0.6
"""Shares of the mask and of the body. Of 171 people in photographs, fits cover 0.61 to 0.92 and spill 0.01 to 0.44."""
LIMIT = 32 << 30
"""Bytes of all fits: 200,000 people."""
MEMORY_BYTES = 256 << 20
"""Of fits that stay unpacked: a hundred people."""
TOGETHER = 8
"""People of one job."""
UNFIT, UNCOVERED = "does not fit", "nothing is covered"
"""Why people are left out who are annotated well enough."""
ALONE = 2 * TOGETHER
"""With fewer people to fit, starting processes takes longer than they save."""
STEPS = 65535


class Fits(Sequence[Fit]):
    """Fitted people. Their fits are read when asked for; the last ones stay in memory."""

    def __init__(self, people: Iterable[Person], read: Callable[[Person], Fit]) -> None:
        """read: gives a person's fit."""
        self.people, self._read = tuple(people), read

    def __len__(self) -> int:
        return len(self.people)

    def __getitem__(self, index: int | slice) -> Fit | Fits:
        if isinstance(index, slice):
            return Fits(self.people[index], self._read)
        return self._read(self.people[index])

    def __iter__(self) -> Iterator[Fit]:
        return map(self._read, self.people)

    def where(self, chosen: Iterable[bool]) -> Fits:
        """Take the people for whom `chosen` is true."""
        return Fits(compress(self.people, chosen), self._read)

    def qualities(self) -> Iterator[Mapping[str, float]]:
        """Say how well each fits (`Fit.quality`), without unpacking what lies on disk."""
        quality_of = self._read.quality if isinstance(self._read, _Shelf) else lambda person: self._read(person).quality
        return map(quality_of, self.people)

    def expect(self, indices: Iterable[int]) -> None:
        """Have the system read photographs and fits of these people ahead of need."""
        for index in indices:
            read_ahead(self.people[index].crop.path)
            if isinstance(self._read, _Shelf):
                self._read.expect(self.people[index])


class _Shelf:
    """Gives fits from their files; what no file keeps stays in memory, packed."""

    def __init__(self) -> None:
        self._files = DiskCache(cache_folder("fits"), ".fit", LIMIT, "fits of people")
        self._unpacked = MemoryCache(MEMORY_BYTES)
        self._held: dict[str, bytes] = {}

    def packed(self, person: Person) -> bytes | None:
        """Look for a fit; None where nobody fitted her, or another process made room in the cache."""
        name = person_identity(person)
        data = self._files.get(name)
        return self._held.get(name) if data is None else data.tobytes()

    def put(self, person: Person, packed: bytes) -> None:
        name = person_identity(person)
        if not self._files.put(name, packed):
            self._held[name] = packed

    def expect(self, person: Person) -> None:
        self._files.expect(person_identity(person))

    def quality(self, person: Person) -> dict[str, float]:
        packed = self.packed(person)
        return self(person).quality if packed is None else _quality(load(packed))

    def __call__(self, person: Person) -> Fit:
        # The same pixels under another name are another person's words, which views show.
        key = person_identity(person), person.photograph, person.number
        fit = self._unpacked.get(key)
        if fit is None:
            packed = self.packed(person)
            if packed is None:
                packed = fit_some([person])[0]
                self.put(person, packed)
            fit = self._unpacked.put(key, unpack_fit(packed, person))
        return fit


def fit_people(
    people: People, on_progress: Callable[[int, int], None] | None = None, executor: Executor | None = None
) -> Fits:
    """Fit every person; those fitted before come from the cache. `on_progress` hears (people done, people in all).

    People whom the body does not fit (`fits_well`) are missing; `those_who_fit` counts them. InputError: it fits none.
    executor: who fits (Ray's workers); None: processes of this machine, one for each core. A job that is lost with its
    process is done again, and nothing that came back is.
    """
    shelf = _Shelf()
    missing = list({person_identity(p): p for p in people.people if shelf.packed(p) is None}.values())
    done = len(people) - len(missing)
    parts = [missing[start : start + TOGETHER] for start in range(0, len(missing), TOGETHER)]
    jobs = [Job(f"people {k * TOGETHER + 1} ...", fit_some, {"people": part}) for k, part in enumerate(parts)]
    run = executor.run if executor else in_order if len(missing) < ALONE else Processes().run
    if on_progress is not None:
        on_progress(done, len(people))
    with contextlib.closing(run(jobs)) as outcomes:
        for outcome in outcomes:
            outcome.require()
            for person, packed in zip(outcome.job.arguments["people"], outcome.result, strict=True):
                shelf.put(person, packed)
            done += len(outcome.result)
            if on_progress is not None:
                on_progress(done, len(people))
    fitting = [person for person in people.people if fits_well(shelf.quality(person))]
    if not fitting and len(people):
        raise InputError(f"{people.name}: the body fits none of its {len(people)} people (landmarks of other people?)")
    return Fits(fitting, shelf)


def fit_some(people: Sequence[Person]) -> list[bytes]:
    """Fit people, packed (`pack_fit`): what a process of another core or machine does."""
    return [pack_fit(fit) for fit in fit_all(people)]


def person_identity(person: Person) -> str:
    """SHA-256 (hex) of a person as she is dressed: all of `Person.identity`, and how she is fitted."""
    return sha256_record({"person": person.identity, "version": VERSION})


def people_identity(people: Iterable[Person]) -> str:
    """SHA-256 (hex) of people in their order, as they are dressed; names of files and photographs decide nothing."""
    return sha256_record([person_identity(person) for person in people])


def fits_well(quality: Mapping[str, float]) -> bool:
    """Tell whether the body covers a person's mask well enough to lay colours onto it (`Fit.quality`)."""
    return quality["covered"] >= LEAST_COVERED and quality["spilled"] <= MOST_SPILLED


def those_who_fit(people: People, fits: Fits, reason: str = UNFIT) -> People:
    """Select the people of these fits, in their order; the others are left out, for this reason."""
    missing = len(people) - len(fits)
    left_out = people.left_out | ({reason: missing} if missing else {})
    return replace(people, people=fits.people, left_out=left_out)


def pack_fit(fit: Fit) -> bytes:
    """Pack a fit; its person is not in it."""
    lenders, first, row = np.unique(fit.lender, return_index=True, return_inverse=True)
    counts = np.diff(fit.crow)[first]
    entry = entries_of_rows(fit.crow[first], counts)
    low, high = LIMITS
    numbers = {
        "dressed": _bits(fit.pixels, fit.person.shape),
        "lends": _bits(lenders, fit.person.shape),
        "row": _squeezed(row),
        "count": _squeezed(counts),
        "main": _squeezed(fit.main[first]),
        "triangle": _squeezed(fit.triangle[entry]),
        "share": _squeezed(np.rint(fit.share[entry] * STEPS)),
        "shading": _squeezed(np.rint((fit.shading - low) / (high - low) * STEPS)),
    }
    few = {"tint": fit.tint, "transforms": fit.posed.transforms, "scale": np.array([fit.posed.scale])}
    few |= {f"quality_{name}": np.array([value]) for name, value in fit.quality.items()}
    return save(numbers | {name: np.ascontiguousarray(values, np.float64) for name, values in few.items()})


def unpack_fit(data: bytes, person: Person) -> Fit:
    """Unpack a person's fit."""
    stored = load(data)
    bits = (np.frombuffer(zlib.decompress(stored[name]), np.uint8) for name in ("dressed", "lends"))
    pixels, lenders = (np.flatnonzero(np.unpackbits(each, count=person.shape[0] * person.shape[1])) for each in bits)
    row, count, main, triangle, share, shading = (
        _unsqueezed(stored[name]) for name in ("row", "count", "main", "triangle", "share", "shading")
    )
    start = np.concatenate([[0], np.cumsum(count)])
    share = share / np.repeat(np.maximum(np.add.reduceat(share, start[:-1]), 1), count)  # a pixel is whole
    counts = count[row]
    entry = entries_of_rows(start[row], counts)
    low, high = LIMITS
    return Fit(
        person=person,
        pixels=pixels,
        lender=lenders[row],
        crow=np.concatenate([[0], np.cumsum(counts)]),
        triangle=triangle[entry],
        share=share[entry],
        main=main[row],
        shading=low + shading * ((high - low) / STEPS),
        tint=stored["tint"],
        posed=Posed(stored["transforms"], float(stored["scale"][0])),
        quality=_quality(stored),
    )


def _quality(stored: dict[str, np.ndarray]) -> dict[str, float]:
    return {key.removeprefix("quality_"): float(stored[key][0]) for key in stored if key.startswith("quality_")}


def _bits(pixels: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    chosen = np.zeros(shape[0] * shape[1], bool)
    chosen[pixels] = True
    return np.frombuffer(zlib.compress(np.packbits(chosen).tobytes(), 1), np.uint8)


def _squeezed(values: np.ndarray) -> np.ndarray:
    """Deflate whole numbers below 65536, their low and high bytes apart: the high ones repeat."""
    if len(values) and not 0 <= values.min() <= values.max() < 1 << 16:
        raise ValueError(f"numbers from {values.min()} to {values.max()} do not fit 16 bits")
    halves = values.astype("<u2").view(np.uint8).reshape(-1, 2).T
    return np.frombuffer(zlib.compress(halves.tobytes(), 1), np.uint8)


def _unsqueezed(data: np.ndarray) -> Integer[np.ndarray, " N"]:
    halves = np.frombuffer(zlib.decompress(data), np.uint8).reshape(2, -1)
    return halves.T.copy().view("<u2").reshape(-1).astype(np.int64)
