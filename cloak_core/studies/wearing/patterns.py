"""Folders of published patterns: what patterns.toml says of each picture, and how its authors put it on."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

from cloak_core.core.pictures import read_picture
from cloak_core.files.errors import InputError
from cloak_core.files.reading import is_number, read_toml

LIST = "patterns.toml"
FORMS = {"cloth": "tile", "patch": "patch"}
"""How a picture is put on, and what `cloak wear` calls it."""
METRES = (0.01, 5.0)
"""Least and largest width of a pattern on the body."""


@dataclass(frozen=True)
class Pattern:
    """A table of patterns.toml; its heading names the pattern."""

    name: str
    file: Path
    put_on: str
    """cloth: repeats all over the clothes; patch: once, on the chest."""
    metres: float
    """Width of the picture on the body."""
    trained_on: str
    source: str
    licence: str

    @property
    def spec(self) -> str:
        """What `cloak wear` takes: FILE@tile=METRES or FILE@patch=METRES."""
        return f"{self.file}@{FORMS[self.put_on]}={self.metres:g}"


def pattern_specs(named: str) -> list[str]:
    """List the pictures of a folder with patterns.toml (or of that file), ready to wear; anything else as it is.

    InputError: names file and field, or what a folder lacks that is neither one of patterns nor a run.
    """
    path = Path(named)
    if path.name == LIST or (path / LIST).is_file():
        return [pattern.spec for pattern in read_patterns(path.parent if path.name == LIST else path)]
    if path.is_dir() and not (path / "config.json").exists():
        needs = f"{LIST} with a table for each picture, [name] with {', '.join(_FIELDS)}"
        raise InputError(f"{path}: no run (no config.json), and as a folder of patterns it lacks {needs}")
    return [named]


def read_patterns(folder: Path) -> list[Pattern]:
    """Read patterns.toml in a folder of pictures. InputError: names the file, the table and the field."""
    path = folder / LIST
    tables = read_toml(path)
    if not tables or not all(isinstance(table, dict) for table in tables.values()):
        raise InputError(f"{path}: expected a table for each picture, [name] with {', '.join(_FIELDS)}")
    return [_pattern(path, name, table) for name, table in tables.items()]


_FIELDS = tuple(field.name for field in fields(Pattern) if field.name != "name")


def _pattern(path: Path, name: str, table: dict) -> Pattern:
    for field in _FIELDS:
        if field not in table:
            raise InputError(f"{path}: [{name}] lacks {field}")
    for field in set(table) - set(_FIELDS):
        raise InputError(f"{path}: [{name}] has {field}, which is none of {', '.join(_FIELDS)}")
    for field in set(_FIELDS) - {"metres"}:
        if not isinstance(table[field], str):
            raise InputError(f"{path}: [{name}] {field} is {table[field]!r}, not text")
    if table["put_on"] not in FORMS:
        raise InputError(f"{path}: [{name}] put_on is {table['put_on']!r}, neither cloth nor patch")
    if not is_number(table["metres"]) or not METRES[0] <= table["metres"] <= METRES[1]:
        raise InputError(f"{path}: [{name}] metres is {table['metres']!r}, not between {METRES[0]:g} and {METRES[1]:g}")
    picture = path.parent / table["file"]
    if not picture.resolve().is_relative_to(path.parent.resolve()):
        raise InputError(f"{path}: [{name}] file '{table['file']}' lies outside its folder")
    if not picture.is_file():
        raise InputError(f"{path}: [{name}] file '{table['file']}' is missing")
    read_picture(picture)
    return Pattern(name, **(table | {"file": picture, "metres": float(table["metres"])}))
