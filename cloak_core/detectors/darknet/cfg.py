"""Darknet's .cfg text as a list of sections that remember their line numbers."""

from dataclasses import dataclass, field
from pathlib import Path

from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_text

MAX_BYTES = 1 << 20
MAX_NUMBER = 2**31 - 1
"""Darknet reads its integers as C does; a size beyond them is a typing error."""


@dataclass(frozen=True)
class Section:
    """One `[kind]` block of a .cfg with its `key=value` options."""

    kind: str
    line: int
    source: str
    options: dict[str, str] = field(default_factory=dict)

    def error(self, message: str) -> InputError:
        """Make an InputError that says where in the .cfg the trouble is."""
        return InputError(f"{self.source}:{self.line}: [{self.kind}] {message}")

    def integer(self, key: str, default: int | None = None, low: int | None = None) -> int:
        """Read an integer option, at least `low`; without a default the option must be there."""
        if key not in self.options:
            if default is None:
                raise self.error(f"lacks {key}=")
            return default
        value = self._number(key, self.options[key], int)
        if low is not None and value < low:
            raise self.error(f"{key}={value} must be at least {low}")
        return value

    def number(self, key: str, default: float) -> float:
        return self._number(key, self.options[key], float) if key in self.options else default

    def listed(self, key: str, kind: type[int] | type[float]) -> list:
        """Read a comma-separated list of numbers, empty where the option is absent."""
        return [self._number(key, part, kind) for part in self.options.get(key, "").split(",") if part]

    def refuse(self, *keys: str, but: int = 0) -> None:
        """Refuse options that change the result and are not computed here; `but` is the value that changes nothing."""
        for key in keys:
            if self.options.get(key, "none") not in ("none", str(but), f"{but}.0"):
                raise self.error(f"{key}={self.options[key]} is not supported")

    def _number(self, key, text, kind):
        try:
            value = kind(text)
        except ValueError:
            value = None
        if value is None or not abs(value) <= MAX_NUMBER:
            raise self.error(f"{key}={text} is not {'an integer' if kind is int else 'a number'}")
        return value


def parse_cfg(text: str, source: str = "cfg") -> list[Section]:
    """Split .cfg text into sections, `[net]` first. InputError names `source` and the line of anything unreadable."""
    sections: list[Section] = []
    for number, raw in enumerate(text.splitlines(), start=1):
        line = "".join(raw.split("#")[0].split(";")[0].split())  # Darknet drops all blanks, inside a line too
        if line.startswith("["):
            sections.append(Section(line.strip("[]").lower(), number, source))
        elif line:
            key, equals, value = line.partition("=")
            if not equals or not sections:
                raise InputError(f"{source}:{number}: expected [section] or key=value, found {raw.strip()[:40]!r}")
            sections[-1].options[key] = value
    if not sections or sections[0].kind not in ("net", "network"):
        raise InputError(f"{source}: not a Darknet cfg, it does not begin with [net]")
    return sections


def read_cfg(path: Path) -> list[Section]:
    return parse_cfg(read_cfg_text(path), str(path))


def read_cfg_text(path: Path) -> str:
    """Read a .cfg file's text. InputError: no such file, or far too large for one (the weights, say)."""
    return read_text(path, MAX_BYTES, errors="replace")
