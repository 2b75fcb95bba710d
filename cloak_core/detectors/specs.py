"""A detector as one line of text, `FAMILY:WHAT@OPTIONS`, taken apart."""

import re
from dataclasses import dataclass

from cloak_core.detectors.pixels import PixelFormat
from cloak_core.files.errors import InputError
from cloak_core.files.specs import split_spec

PERSON = "person"
"""The class that is looked for unless told otherwise."""
_NUMBER = r"[0-9.]+(?:e-?[0-9]+)?"
MAX_SIDE = 4096
"""Pixels of a side of a network's input: beyond it, one image takes minutes and the machine's memory."""
OPTIONS = {
    "size": r"\d+(?:x\d+)?",
    "letterbox": "letterbox|stretch",
    "person": "person=[^,@]+",
    "bgr": "bgr|rgb",
    "range": "range=(?:1|255)",
    "mean": f"mean={_NUMBER}(?:/{_NUMBER}){{2}}",
    "std": f"std={_NUMBER}(?:/{_NUMBER}){{2}}",
    "conf": f"conf={_NUMBER}",
}
"""How each option after the @ is written; `parse_spec` says what becomes of it."""
_ANY = "|".join(OPTIONS.values())
_OPTIONS = re.compile(rf"^(?P<what>.*)@(?P<options>(?:{_ANY})(?:,(?:{_ANY}))*)$", re.DOTALL)


@dataclass(frozen=True)
class Request:
    """A spec taken apart, `darknet:a.cfg:a.weights@416,letterbox,person=cyclist`, and what is asked for beside it."""

    spec: str
    family: str
    what: str
    """All between the family and the options."""
    input_size: tuple[int, int] | None = None
    """The network's (height, width); None for the detector's own."""
    letterbox: bool = False
    stretch: bool = False
    """Stretch images to the network's input even where its family letterboxes them."""
    person_class: str | None = None
    """Name or index of the class to look for; None where nobody said."""
    pixels: PixelFormat | None = None
    """How the network wants its pixels; None as its family does."""
    confidence: float | None = None
    """The score above which the detector, as it is used, reports a box; None for its own default."""
    fold: bool = True
    """Fold batch norm, and lay memory out for speed; False to measure against."""
    download: bool = False
    """Whether missing official weights may be fetched."""

    @property
    def parts(self) -> list[str]:
        """What stands between the colons after the family; nothing where there is nothing."""
        return split_spec(self.what) if self.what else []

    @property
    def person(self) -> str:
        """The class to look for."""
        return self.person_class or PERSON


def parse_spec(spec: str) -> Request:
    """Take a spec apart. InputError: an option given twice, one that is no number or outside its range."""
    match = _OPTIONS.match(spec)
    what, options = (match["what"], match["options"].split(",")) if match else (spec, [])
    said: dict[str, str] = {}
    numbers: dict[str, tuple[float, ...]] = {}
    for option in options:
        kind = next(kind for kind, form in OPTIONS.items() if re.fullmatch(form, option))
        if kind in said:
            raise InputError(f"detector {spec!r}: {kind} is given twice")
        said[kind] = option.partition("=")[2] or option
        if kind in ("range", "mean", "std", "conf"):
            try:
                numbers[kind] = tuple(float(part) for part in said[kind].split("/"))
            except ValueError:
                raise InputError(f"detector {spec!r}: {option} holds something that is no number") from None
    (confidence,) = numbers.pop("conf", (None,))
    if confidence is not None and not 0 < confidence < 1:
        raise InputError(f"detector {spec!r}: conf={confidence:g} is not in (0, 1)")
    if 0 in numbers.get("std", ()):
        raise InputError(f"detector {spec!r}: a standard deviation of 0 in std={said['std']}")
    pixels = None
    if numbers or "bgr" in said:
        (scale,) = numbers.pop("range", (1.0,))
        pixels = PixelFormat(bgr=said.get("bgr") == "bgr", range=scale, **numbers)
    sides = [int(side) for side in said["size"].split("x")] if "size" in said else []
    size = check_size((sides[0], sides[-1]), f"detector {spec}") if sides else None
    family, _, what = what.partition(":")
    return Request(
        spec,
        family,
        what,
        input_size=size,
        letterbox=said.get("letterbox") == "letterbox",
        stretch=said.get("letterbox") == "stretch",
        person_class=said.get("person"),
        pixels=pixels,
        confidence=confidence,
    )


def check_size(size: tuple[int, int], what: object) -> tuple[int, int]:
    """Return a network's input size (height, width). InputError: a side of no pixel, or beyond `MAX_SIDE`."""
    if not (1 <= min(size) and max(size) <= MAX_SIDE):
        raise InputError(
            f"{what}: an input size of {size[0]}x{size[1]} is not possible (1 to {MAX_SIDE} a side; @HEIGHTxWIDTH)"
        )
    return size
