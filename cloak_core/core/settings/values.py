"""What options hold: numbers within bounds, ranges, angles, weights; each read from text once, and written back.

Everything here is plain Python, so that `cloak --help` need not wait for torch.
"""

from __future__ import annotations

import math
import types
import typing
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal

from cloak_core.files.errors import InputError

SECTOR = 10.0
"""Degrees of a continuous range of azimuths that are dealt as one, at most."""


@dataclass(frozen=True)
class Bounds:
    """Bounds of a number, or of both ends of a range; stands in a field's annotation."""

    low: float | int = 0
    high: float | int = math.inf
    ends: Literal["[]", "[)", "(]", "()"] = "[]"
    """Which of the bounds belong."""

    def __contains__(self, value: object) -> bool:
        """Tell whether a number, or both ends of a range, lie within; None does."""
        numbers = () if value is None else (value.low, value.high) if isinstance(value, Range) else (value,)
        # NaN fails every comparison.
        above = all(number >= self.low if self.ends[0] == "[" else number > self.low for number in numbers)
        return above and all(number <= self.high if self.ends[1] == "]" else number < self.high for number in numbers)

    def __str__(self) -> str:
        return f"{self.ends[0]}{self.low:g}, {self.high:g}{self.ends[1]}"


Positive = typing.Annotated[float, Bounds(ends="()")]
NotNegative = typing.Annotated[float, Bounds(ends="[)")]


class Parsable:
    """A value that options spell as text: `parse` reads what `str` writes. ValueError: text that is none."""

    metavar: ClassVar[str]

    @classmethod
    def parse(cls, text: str) -> Parsable:
        raise NotImplementedError


@dataclass(frozen=True)
class Range(Parsable):
    """From `low` to `high`, both included; a single number where they are equal."""

    metavar = "LOW:HIGH"
    low: float
    high: float

    @classmethod
    def parse(cls, text: str) -> Range:
        numbers = _numbers(text, ":")
        if len(numbers) > 2:
            raise ValueError(f"{text!r} is neither a number nor LOW:HIGH")
        if numbers[-1] < numbers[0]:
            raise ValueError(f"{text!r} is an inverted range")
        return cls(numbers[0], numbers[-1])

    @property
    def width(self) -> float:
        return self.high - self.low

    @property
    def middle(self) -> float:
        return (self.low + self.high) / 2

    def __str__(self) -> str:
        return _spelled((self.low, self.high) if self.width else (self.low,), ":")


class Angles(tuple[float, ...], Parsable):
    """Single angles in degrees, in [-360, 360], each once: "0", "-10,0,10" or FIRST:LAST:STEP (LAST included)."""

    metavar = "A:B:STEP"

    @classmethod
    def parse(cls, text: str) -> Angles:
        parts = _numbers(text.replace(":", ","), ",")
        if ":" not in text:
            return cls._checked(parts, text)
        if "," in text or len(parts) not in (2, 3):
            raise ValueError(f"{text!r} is neither A,B,C nor FIRST:LAST:STEP")
        first, last, step = (*parts, 1.0)[:3]
        if step <= 0:
            raise ValueError(f"the step of {text!r} is not positive")
        if last < first:
            raise ValueError(f"{text!r} ends before it begins")
        # 1e-9: 0:1:0.1 has eleven angles although 1 / 0.1 may round below 10.
        count = math.floor((last - first) / step + 1e-9) + 1
        if count > 3600:
            raise ValueError(f"{text!r} are {count} angles, more than 3600")
        return cls._checked((first + i * step for i in range(count)), text)

    @classmethod
    def _checked(cls, degrees: Iterable[float], text: str) -> Angles:
        angles = cls(round(angle, 9) + 0.0 for angle in degrees)
        if max(map(abs, angles)) > 360:
            raise ValueError(f"{text!r} leaves [-360, 360] degrees")
        if len(set(angles)) < len(angles):
            raise ValueError(f"{text!r} names an angle twice")
        return angles

    def __str__(self) -> str:
        step = round(self[1] - self[0], 9) if len(self) > 2 else 0.0
        even = step > 0 and all(round(self[0] + i * step, 9) == angle for i, angle in enumerate(self))
        return _spelled((self[0], self[-1], step), ":") if even else _spelled(self, ",")


@dataclass(frozen=True)
class Azimuths(Parsable):
    """Angles to train at: single ones, or LOW..HIGH, anything in between in sectors of equal width."""

    metavar = "A:B:STEP|LOW..HIGH"
    of: Angles | Range

    @classmethod
    def parse(cls, text: str) -> Azimuths:
        if ".." not in text:
            return cls(Angles.parse(text))
        first, last, *more = _numbers(text, "..")
        if more:
            raise ValueError(f"{text!r} is neither angles nor LOW..HIGH")
        if last <= first:
            raise ValueError(f"{text!r} ends before it begins")
        if last - first > 360 or max(abs(first), abs(last)) > 360:
            raise ValueError(f"{text!r} is more than a full circle, or leaves [-360, 360] degrees")
        return cls(Range(first, last))

    @cached_property
    def starts(self) -> tuple[float, ...]:
        """Degrees: each draw lies in [start, start + width]."""
        if isinstance(self.of, Angles):
            return tuple(self.of)
        return tuple(self.of.low + i * self.width for i in range(self._sectors))

    @cached_property
    def width(self) -> float:
        """Degrees; 0 for single angles."""
        return 0.0 if isinstance(self.of, Angles) else self.of.width / self._sectors

    @property
    def centers(self) -> tuple[float, ...]:
        """Degrees."""
        return tuple(start + self.width / 2 for start in self.starts)

    @property
    def _sectors(self) -> int:
        return math.ceil(self.of.width / SECTOR - 1e-9)

    def __str__(self) -> str:
        return str(self.of) if isinstance(self.of, Angles) else _spelled((self.of.low, self.of.high), "..")


def _numbers(text: str, separator: str) -> tuple[float, ...]:
    """Read the finite numbers in a text. ValueError: one is none."""
    numbers = []
    for part in text.split(separator):
        try:
            number = float(part)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise ValueError(f"{part.strip()!r} in {text!r} is not a number")
        numbers.append(number)
    return tuple(numbers)


def _spelled(numbers: Iterable[float], separator: str) -> str:
    return separator.join(repr(float(number)).removesuffix(".0") for number in numbers)


def option(name: str) -> str:
    """Write a field's name as the command line spells it."""
    return "--" + name.replace("_", "-")


def from_plain(name: str, value: object, kind: object) -> object:
    """Convert what JSON, TOML or Python gives for a field to the type it declares. InputError names the option."""
    kind = unannotated(kind)
    kinds = typing.get_args(kind) if typing.get_origin(kind) in (types.UnionType, typing.Union) else (kind,)
    if value is None and types.NoneType in kinds:
        return None
    kind = unannotated(kinds[0])
    if isinstance(value, bool):
        raise InputError(f"{option(name)}: {value} is neither a number nor a word")
    if typing.get_origin(kind) is Literal:
        known = typing.get_args(kind)
        if value not in known:
            raise InputError(f"{option(name)}: {value!r} is not one of {', '.join(map(str, known))}")
        return known[known.index(value)]  # 4 for 4.0
    if issubclass(kind, Parsable):
        return _read(name, value, kind)
    if kind is float and isinstance(value, int):
        value = float(value)
    if kind is int and isinstance(value, float) and value.is_integer():
        value = int(value)
    if not isinstance(value, kind):
        expected = {str: "text", int: "a whole number", float: "a number"}[kind]
        raise InputError(f"{option(name)}: {value!r} is not {expected}")
    return value


def unannotated(kind: object) -> object:
    """Give the type inside an annotation."""
    return typing.get_args(kind)[0] if typing.get_origin(kind) is typing.Annotated else kind


def _read(name: str, value: object, kind: type[Parsable]) -> Parsable:
    if isinstance(value, kind):
        return value
    text = repr(value) if isinstance(value, (int, float)) else value  # angles = 0 in a TOML file
    if not isinstance(text, str):
        raise InputError(f"{option(name)}: {value!r} is not text")
    try:
        return kind.parse(text)
    except ValueError as error:
        raise InputError(f"{option(name)}: {error}") from None
