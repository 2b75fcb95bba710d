"""Options to a command, through tyro: text becomes values here, and once."""

from __future__ import annotations

import contextlib
import io
import re
import types
import typing

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from cloak_core.commands.base import Command
from cloak_core.commands.help import FOUR_DEEP, missing, one_command, usage
from cloak_core.core.settings.values import Parsable
from cloak_core.files.errors import InputError

REGISTRY = ConstructorRegistry()


@REGISTRY.primitive_rule
def written(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
    """Read and write ranges, angles and weights as they spell themselves; None for every other type."""
    kinds = typing.get_args(info.type) if info.type_origin in (types.UnionType, typing.Union) else (info.type,)
    kind, optional = kinds[0], types.NoneType in kinds
    if not (isinstance(kind, type) and issubclass(kind, Parsable)):
        return None

    def read(words: list[str]) -> Parsable | None:
        return None if optional and words == ["None"] else kind.parse(words[0])

    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="{None}|" * optional + kind.metavar,
        instance_from_str=read,
        is_instance=lambda value: isinstance(value, kind) or (optional and value is None),
        str_from_instance=lambda value: [str(value)],
    )


def parse(cls: type[Command], name: str, arguments: list[str]) -> Command:
    """Parse the options of `cloak NAME`; print help where asked (SystemExit). InputError: tyro's box as one line."""
    default = cls.default(arguments) if hasattr(cls, "default") else None
    if {"-h", "--help", "--help-all"} & set(arguments):
        print(one_command(cls, name, default, "--help-all" in arguments), end="")
        raise SystemExit(0)
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            given = {} if default is None else {"default": default}
            config = (tyro.conf.FlagCreatePairsOff,)
            return tyro.cli(cls, prog=f"cloak {name}", args=arguments, config=config, registry=REGISTRY, **given)
    except SystemExit:
        why = _refusal(cls, name, said.getvalue(), arguments)
        raise InputError(f"{name}: {why} (cloak {name} --help)") from None


def _refusal(cls: type[Command], name: str, boxed: str, arguments: list[str]) -> str:
    """Say why tyro refused, on one line; with the usage where something is missing."""
    needs = missing(cls, boxed)
    _, _, unknown = boxed.partition("Unrecognized options:")
    words = [word for word in FOUR_DEEP.findall(unknown) if not word.startswith("cloak ")]
    if value := re.search(r"Missing value for argument '(\w+)'", boxed):
        # tyro says this of what stands without a name when the first word is an option it does not know.
        needs, words = [value[1].upper()], arguments[:1]
    if not needs:
        return _one_line(boxed)
    strange = f"unknown: {' '.join(words)}; " if words else ""
    return f"{strange}needs {', '.join(needs)}; usage: {usage(cls, name)}"


def _one_line(boxed: str) -> str:
    """Take the first paragraph of tyro's boxed message, without the box."""
    # Boxes are of plain characters where the terminal has no others.
    lines = [re.sub(r"^[╭╰+][─-]+.*|^[│|] ?|\s*[│|]$", "", line).strip() for line in boxed.splitlines()]
    kept: list[str] = []
    for line in lines:
        if kept and (line.startswith("For full helptext") or line == "Argument helptext:"):
            break
        if line.strip("─-"):
            kept.append(line)
    return re.sub(_CHOICE, _choice_words, " ".join(kept)).removeprefix("Error parsing ") or "not understood"


_CHOICE = r"invalid choice ('.*') for argument '(--\S+)'\. Expected one of \((.*)\)\."


def _choice_words(found: re.Match) -> str:
    """Word a wrong choice as settings do; tyro has the choices in the order of a set."""
    known = sorted(found[3].rstrip(",").replace("'", "").split(", "))
    return f"{found[2]}: {found[1]} is not one of {', '.join(known)}"
