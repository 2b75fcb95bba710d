"""What a command must be given, as one line of usage, and what of it is missing."""

from __future__ import annotations

import dataclasses
import re
import typing
from pathlib import Path

from tyro.conf import Positional

from cloak_core.commands.base import Command

_WORDS = {Path: "PATH", str: "TEXT", int: "N", float: "X"}
FOUR_DEEP = re.compile(r"^[│| ] {5}(\S.*?)\s*[│|]?\s*$", re.MULTILINE)
"""In tyro's box, whose frame may be blanks: names; their explanations stand deeper."""
_MARK = typing.get_args(Positional[int])[-1]


def usage(cls: type[Command], name: str) -> str:
    """One line: the command, what it must be given, and that there are options."""
    parts = [f"cloak {name}"]
    options = []
    for field, kind, positional in _fields(cls):
        needed = _needed(field)
        if positional:
            word = field.name.upper() + " ..." * _is_many(kind)
            parts.append(word if needed else f"[{word}]")
        elif needed:
            options.append(f"{_flag(cls, field)} {_WORDS.get(kind, 'VALUE')}")
    return " ".join([*parts, *options, "[OPTIONS]"])


def missing(cls: type[Command], boxed: str) -> list[str]:
    """The names of what tyro says is missing."""
    found = FOUR_DEEP.findall(boxed.partition("Missing from")[2].partition("Unrecognized")[0])
    flags = [line.split()[0] for line in found if line.startswith("--")]
    positional = [f.name.upper() for f, _, positional in _fields(cls) if positional and _needed(f)]
    words = [line for line in found if not line.startswith(("--", "cloak "))]
    return positional[: len(words)] + flags


def _fields(cls: type[Command]) -> list[tuple[dataclasses.Field, object, bool]]:
    """Of each option of a command's own: its field, its type, whether it stands without a name."""
    hints = typing.get_type_hints(cls, include_extras=True)
    told = []
    for field in dataclasses.fields(cls):
        kind, *extras = typing.get_args(hints[field.name]) if _annotated(hints[field.name]) else (hints[field.name],)
        if not dataclasses.is_dataclass(kind):  # a group of options, all of which have defaults
            told.append((field, kind, _MARK in extras))
    return told


def _annotated(hint: object) -> bool:
    return typing.get_origin(hint) is typing.Annotated


def _needed(field: dataclasses.Field) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _is_many(kind: object) -> bool:
    return typing.get_origin(kind) in (tuple, list)


def _flag(cls: type[Command], field: dataclasses.Field) -> str:
    extras = typing.get_args(typing.get_type_hints(cls, include_extras=True)[field.name])[1:]
    named = next((extra.name for extra in extras if getattr(extra, "name", None)), field.name)
    return f"--{named.replace('_', '-')}"
