"""What a command must be given, as one line of usage, and what of it is missing."""

from __future__ import annotations

import dataclasses
import re
import typing
from pathlib import Path

from tyro.conf import Positional

from cloak_core.commands.base import Command

WORDS = {Path: "PATH", str: "TEXT", int: "N", float: "X"}
FOUR_DEEP = re.compile(r"^[│| ] {5}(\S.*?)\s*[│|]?\s*$", re.MULTILINE)
"""In tyro's box, whose frame may be blanks: names; their explanations stand deeper."""
POSITIONAL = typing.get_args(Positional[int])[-1]
"""How tyro marks an option that stands without a name."""


def usage(cls: type[Command], name: str) -> str:
    """Write one line: the command, what it must be given, and that there are options."""
    parts = [f"cloak {name}"]
    options = []
    for field, kind, extras in _own(cls):
        if POSITIONAL in extras:
            word = field.name.upper() + " ..." * (typing.get_origin(kind) in (tuple, list))
            parts.append(word if is_needed(field) else f"[{word}]")
        elif is_needed(field):
            options.append(f"{flag_name(field, extras)} {WORDS.get(kind, 'VALUE')}")
    return " ".join([*parts, *options, "[OPTIONS]"])


def missing(cls: type[Command], boxed: str) -> list[str]:
    """List the names of what tyro says is missing."""
    found = FOUR_DEEP.findall(boxed.partition("Missing from")[2].partition("Unrecognized")[0])
    flags = [line.split()[0] for line in found if line.startswith("--")]
    positional = [f.name.upper() for f, _, extras in _own(cls) if POSITIONAL in extras and is_needed(f)]
    words = [line for line in found if not line.startswith(("--", "cloak "))]
    return positional[: len(words)] + flags


def annotations_of(cls: type) -> list[tuple[dataclasses.Field, object, list]]:
    """List each field, its type, and what tyro is told about it."""
    hints = typing.get_type_hints(cls, include_extras=True)
    told = []
    for field in dataclasses.fields(cls):
        hint = hints[field.name]
        annotated = typing.get_origin(hint) is typing.Annotated
        kind, *extras = typing.get_args(hint) if annotated else (hint,)
        told.append((field, kind, extras))
    return told


def is_needed(field: dataclasses.Field) -> bool:
    """Tell whether the option has no default."""
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def flag_name(field: dataclasses.Field, extras: list) -> str:
    """Write the option as it is typed."""
    named = next((extra.name for extra in extras if getattr(extra, "name", None)), field.name)
    return f"--{named.replace('_', '-')}"


def _own(cls: type[Command]) -> list[tuple[dataclasses.Field, object, list]]:
    """List fields as `annotations_of`, without the groups of options, which all have defaults."""
    return [told for told in annotations_of(cls) if not dataclasses.is_dataclass(told[1])]
