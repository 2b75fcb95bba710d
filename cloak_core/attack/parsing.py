"""Text and plain values to numbers, angles and ranges, refused by the name of the option they came from."""

from __future__ import annotations

import math
import typing
from dataclasses import dataclass
from types import NoneType

from cloak_core.files.errors import InputError

MAX_TOML_BYTES = 1 << 20
SECTOR = 10.0
"""Degrees of a continuous range of azimuths that are dealt as one, at most."""


@dataclass(frozen=True)
class Azimuths:
    """Sectors of equal width: each draw lies in [start, start + width]."""

    starts: tuple[float, ...]
    """Degrees."""
    width: float
    """Degrees; 0 for single angles."""

    @property
    def centers(self) -> tuple[float, ...]:
        """Degrees."""
        return tuple(start + self.width / 2 for start in self.starts)


def parse_azimuths(spec: str, name: str = "--angles") -> Azimuths:
    """Single angles as `parse_angles` reads them, or "LOW..HIGH": any angle in between, in sectors of equal width."""
    low, dots, high = spec.partition("..")
    if not dots:
        return Azimuths(parse_angles(spec, name), 0.0)
    first, last = _number(low, spec, name), _number(high, spec, name)
    if last <= first:
        raise InputError(f"{name}: {spec!r} ends before it begins")
    if last - first > 360 or max(abs(first), abs(last)) > 360:
        raise InputError(f"{name}: {spec!r} is more than a full circle, or leaves [-360, 360] degrees")
    count = math.ceil((last - first) / SECTOR - 1e-9)
    width = (last - first) / count
    return Azimuths(tuple(first + i * width for i in range(count)), width)


def parse_angles(spec: str, name: str = "--angles") -> tuple[float, ...]:
    """Angles in degrees from "0", "-10,0,10" or "FIRST:LAST:STEP" (STEP 1 when left out, LAST included)."""
    parts = [_number(part, spec, name) for part in spec.replace(":", ",").split(",")]
    if ":" not in spec:
        angles = parts
    elif "," in spec or len(parts) not in (2, 3):
        raise InputError(f"{name}: {spec!r} is neither A,B,C nor FIRST:LAST:STEP")
    else:
        first, last, step = (*parts, 1.0)[:3]
        if step <= 0:
            raise InputError(f"{name}: the step of {spec!r} is not positive")
        if last < first:
            raise InputError(f"{name}: {spec!r} ends before it begins")
        # 1e-9: 0:1:0.1 has eleven angles although 1 / 0.1 may round below 10.
        count = math.floor((last - first) / step + 1e-9) + 1
        if count > 3600:
            raise InputError(f"{name}: {spec!r} are {count} angles, more than 3600")
        angles = [first + i * step for i in range(count)]
    angles = [round(angle, 9) + 0.0 for angle in angles]
    if max(map(abs, angles)) > 360:
        raise InputError(f"{name}: {spec!r} leaves [-360, 360] degrees")
    if len(set(angles)) < len(angles):
        raise InputError(f"{name}: {spec!r} names an angle twice")
    return tuple(angles)


def parse_range(spec: str, name: str) -> tuple[float, float]:
    """LOW, HIGH from "LOW:HIGH"; a single number is both."""
    parts = [_number(part, spec, name) for part in spec.split(":")]
    if len(parts) > 2:
        raise InputError(f"{name}: {spec!r} is neither a number nor LOW:HIGH")
    if parts[-1] < parts[0]:
        raise InputError(f"{name}: {spec!r} is an inverted range")
    return parts[0], parts[-1]


def parse_weights(spec: str, name: str) -> tuple[float, ...]:
    """Weights from "A,B,C": none negative, not all zero."""
    weights = tuple(_number(part, spec, name) for part in spec.split(","))
    if min(weights) < 0 or not max(weights) > 0:
        raise InputError(f"{name}: {spec!r} holds a negative weight, or none that counts")
    return weights


def option(name: str) -> str:
    """A field's name as the command line spells it."""
    return "--" + name.replace("_", "-")


def _number(text: str, spec: str, name: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{name}: {text.strip()!r} in {spec!r} is not a number")
    return value


def convert(name: str, value: object, kind: object) -> object:
    """A plain value as the type a field declares; InputError naming the option where it is of another."""
    kinds = typing.get_args(kind) or (kind,)
    if value is None and NoneType in kinds:
        return None
    if isinstance(value, bool):
        raise InputError(f"{option(name)}: {value} is neither a number nor a word")
    if str in kinds and isinstance(value, (int, float)):
        value = repr(value)  # angles = 0 in a TOML file
    if float in kinds and isinstance(value, int):
        value = float(value)
    if int in kinds and isinstance(value, float) and value.is_integer():
        value = int(value)
    if not isinstance(value, tuple(k for k in kinds if k is not NoneType)):
        wanted = " or ".join({str: "text", int: "a whole number", float: "a number"}.get(k, "none") for k in kinds)
        raise InputError(f"{option(name)}: {value!r} is not {wanted}")
    return value


def check_bounds(name: str, value: float | int | None, low: float | int, high: float | int, ends: str) -> None:
    """InputError unless value lies between low and high; ends such as "[)" say which of them belong to the range."""
    if value is None:
        return
    above = value >= low if ends[0] == "[" else value > low
    below = value <= high if ends[1] == "]" else value < high
    if not (above and below):  # NaN fails both
        limits = f"{ends[0]}{low:g}, {high:g}{ends[1]}"
        raise InputError(f"{option(name)}: {value} is not in {limits}")
