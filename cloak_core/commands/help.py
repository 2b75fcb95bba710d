"""What `--help` prints, made of the commands' fields and docstrings."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import shutil
import textwrap
import types
import typing
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tyro.conf import Positional

from cloak_core.commands.base import Command

COLUMN = 26
"""Where explanations begin."""


@dataclasses.dataclass(frozen=True)
class Option:
    """One option as help shows it."""

    name: str
    """As it is typed, with what it takes."""
    words: str
    positional: bool = False


def all_commands(groups: dict[str, dict[str, type[Command]]]) -> str:
    """Write the help of `cloak` itself: every command under its group."""
    lines = ["usage: cloak COMMAND [OPTIONS]   (cloak COMMAND --help says what it takes)"]
    for title, commands in groups.items():
        lines += ["", f"{title}:"]
        for name, cls in commands.items():
            lines += _entry(f"cloak {name}", summary(cls.__doc__ or ""), COLUMN + 2)
    return "\n".join(lines) + "\n"


def one_command(cls: type[Command], name: str, default: Command | None, everything: bool) -> str:
    """Write the help of one command.

    default: where options' defaults are taken from; everything: also what few people use.
    """
    about, *more = [" ".join(part.split()) for part in inspect.cleandoc(cls.__doc__ or "").split("\n\n")]
    lines = [f"usage: {usage(cls, name)}", ""]
    for paragraph in (about, *more):
        lines += [*textwrap.wrap(paragraph, _width()), ""]
    lines += ["Example:", *_wrapped_command(f"cloak {name} {cls.example}")]
    groups = list(_groups(cls, default))
    hidden = 0
    if cls.common and not everything:
        known = [option for _, _, options in groups for option in options]
        shown = [o for word in cls.common for o in known if o.name.split()[0] == f"--{word}"]
        hidden = len(known) - len(shown)
        groups = [("Options", "", shown)]
    for title, words, options in groups:
        for positional in (True, False):
            if chosen := [option for option in options if option.positional is positional]:
                lines += ["", *textwrap.wrap("Arguments:" if positional else f"{title}: {words}", _width())]
                for option in chosen:
                    lines += _entry(option.name, option.words, COLUMN)
    if hidden:
        lines += ["", f"{hidden} more options: cloak {name} --help-all"]
    return "\n".join(lines) + "\n"


@cache
def flags(cls: type[Command]) -> dict[str, str]:
    """List a command's options as they are typed, --steps, each with the first sentence of what it means."""
    options = (option for _, _, options in _groups(cls, None) for option in options if not option.positional)
    return {option.name.split()[0]: summary(option.words) for option in options}


def summary(words: str) -> str:
    """Take a docstring's first sentence: up to a full stop that a capital follows."""
    paragraph = " ".join(words.strip().partition("\n\n")[0].split())
    return re.split(r"(?<=\.) (?=[A-Z])", paragraph)[0]


def _groups(cls: type, default: object) -> Iterator[tuple[str, str, list[Option]]]:
    """Yield the command's own options, then each group of them: its title, what it is about, and the options.

    Options that a class inherits come last, --json at the very end; groups begin with detectors and end with computing.
    """
    own: list[Option] = []
    groups = []
    inherited = lambda told: (told[0].name == "json", told[0].name not in cls.__annotations__)
    for field, kind, extras in sorted(annotations_of(cls), key=inherited):
        if any(repr(extra) == "Suppress" for extra in extras):
            continue
        value = _default(field, default)
        if dataclasses.is_dataclass(kind) and not hasattr(kind, "metavar"):
            title = next((extra.name for extra in extras if getattr(extra, "name", None)), field.name)
            about = " ".join((kind.__doc__ or "").partition("\n\n")[0].split())
            options = [option for _, _, found in _groups(kind, value) for option in found]
            groups.append((title[0].upper() + title[1:], about, options))
        else:
            own.append(_option(cls, field, kind, extras, value))
    yield "Options", "", own
    yield from sorted(groups, key=lambda group: {"Detectors": 0, "Computing": 2}.get(group[0], 1))


def _option(cls: type, field: dataclasses.Field, kind: object, extras: list, value: object) -> Option:
    helped = next((extra.help for extra in extras if getattr(extra, "help", None)), None)
    words = helped or _documented(cls).get(field.name, "")
    positional = POSITIONAL in extras
    flag = field.name.upper() if positional else flag_name(field, extras)
    if kind is bool and value is True:
        flag = flag.replace("--", "--no-", 1)
    repeated = any(repr(extra) == "UseAppendAction" for extra in extras)
    takes = "" if kind is bool else _takes(typing.get_args(kind)[0] if repeated else kind)
    if positional:
        flag, takes = flag + " ..." * (typing.get_origin(kind) is tuple), ""
    if is_needed(field):
        words += "" if positional else " (required)"
    elif value is not None and type(value) is not bool and value not in ((), "") and "(default" not in words:
        words += f" (default: {_written(value)})"
    return Option(f"{flag} {takes}".rstrip(), words + " May be repeated." * repeated, positional)


def _takes(kind: object) -> str:
    """Name what stands behind an option."""
    if typing.get_origin(kind) is typing.Annotated:
        return _takes(typing.get_args(kind)[0])
    if typing.get_origin(kind) in (types.UnionType, typing.Union):
        kinds = [k for k in typing.get_args(kind) if k is not types.NoneType]
        return "|".join(map(_takes, kinds))
    if typing.get_origin(kind) is typing.Literal:
        return "{" + ",".join(map(str, typing.get_args(kind))) + "}"
    if typing.get_origin(kind) is tuple:
        first, *rest = typing.get_args(kind)
        return f"{_takes(first)} ..." if rest == [...] else " ".join(map(_takes, (first, *rest)))
    return getattr(kind, "metavar", None) or WORDS.get(kind, "VALUE")


def _written(value: object) -> str:
    return " ".join(map(str, value)) if type(value) is tuple else str(value)


def _default(field: dataclasses.Field, instance: object) -> object:
    """Find the field's value in `instance`, or its default; None where it has none."""
    if instance is not None:
        return getattr(instance, field.name)
    if field.default is not dataclasses.MISSING:
        return field.default
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return None


def _documented(cls: type) -> dict[str, str]:
    """Read the string below each field, also of the classes above."""
    found: dict[str, str] = {}
    for above in reversed(cls.__mro__):
        if dataclasses.is_dataclass(above):
            (tree,) = ast.parse(textwrap.dedent(inspect.getsource(above))).body
            for field, below in zip(tree.body, tree.body[1:], strict=False):
                match field, below:
                    case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(words))):
                        found[name] = " ".join(words.split())
    return found


def _entry(name: str, words: str, column: int) -> list[str]:
    """Write a name, and beside it what it means; below it where the name is long."""
    wrapped = textwrap.wrap(words, max(_width() - column, 24), break_long_words=False, break_on_hyphens=False) or [""]
    lines = [" " * column + line for line in wrapped]
    head = f"  {name}"
    if len(head) + 2 > column:
        return [head, *lines]
    return [head.ljust(column) + wrapped[0], *lines[1:]]


def _wrapped_command(line: str) -> list[str]:
    """Wrap a command so that a shell takes it as it stands."""
    parts = textwrap.wrap(line.strip(), _width() - 6, break_long_words=False, break_on_hyphens=False)
    return ["  " + " \\\n    ".join(parts)]


def _width() -> int:
    return min(shutil.get_terminal_size().columns, 100)


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
