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
from cloak_core.commands.help import flags, one_command, options_of, usage
from cloak_core.core.settings.retired import RETIRED
from cloak_core.core.settings.values import Parsable
from cloak_core.files.errors import InputError, suggestion

REGISTRY = ConstructorRegistry()


@REGISTRY.primitive_rule
def written(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
    """Read and write ranges and angles as they spell themselves; None for every other type."""
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
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            defaults = {} if default is None else {"default": default}
            config = (tyro.conf.FlagCreatePairsOff,)
            return tyro.cli(cls, prog=f"cloak {name}", args=arguments, config=config, registry=REGISTRY, **defaults)
    except SystemExit:
        why = _refusal(cls, name, box.getvalue(), arguments)
        raise InputError(f"{name}: {why} (cloak {name} --help)") from None


def _refusal(cls: type[Command], name: str, boxed: str, arguments: list[str]) -> str:
    """Say why tyro refused, on one line; with the usage where something is missing."""
    _, _, unknown = boxed.partition("Unrecognized options:")
    known = flags(cls)
    strange = [word for word in map(_flag, arguments) if word.startswith("--") and word not in known]
    gone = RETIRED.get(strange[0].lstrip("-").replace("-", "_")) if strange else None
    if gone:
        return f"this version has no {strange[0]}{f'; use {gone.instead}' if gone.instead else ''}"
    if strange and unknown:
        # Compared without dashes, which all have in common.
        meant = suggestion(strange[0].lstrip("-"), [flag.lstrip("-") for flag in known], 0.6)
        return f"unknown option {strange[0]}{meant.replace('mean ', 'mean --')}"
    needs, words = _missing(cls, boxed), [word for word in FOUR_DEEP.findall(unknown) if not word.startswith("cloak ")]
    if value := re.search(r"Missing value for argument '(\w+)'", boxed):
        # tyro says this of what stands without a name when the first word is an option it does not know.
        needs, words = [value[1].upper()], arguments[:1]
    if needs:
        prefix = f"unknown: {' '.join(words)}; " if words else ""
        return f"{prefix}needs {', '.join(needs)}; usage: {usage(cls, name)}"
    valued = re.search(r"Unrecognized options: (.*?)\s*[│|]?$", boxed, re.MULTILINE)
    switch = next((word for word in arguments if valued and word.endswith(f"={valued[1]}")), None)
    return f"{_flag(switch)}: a switch, which takes no value" if switch else _one_line(boxed)


def _flag(argument: str) -> str:
    """Give the option that an argument names, as help writes it: --tv_weight=3 is --tv-weight."""
    return argument.partition("=")[0].replace("_", "-")


def _missing(cls: type[Command], boxed: str) -> list[str]:
    """List the names of what tyro says is missing."""
    lines = FOUR_DEEP.findall(boxed.partition("Missing from")[2].partition("Unrecognized")[0])
    words = [line for line in lines if not line.startswith(("--", "cloak "))]
    positional = [option.flag for option in options_of(cls) if option.is_positional and option.is_needed]
    return positional[: len(words)] + [line.split()[0] for line in lines if line.startswith("--")]


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
    words = " ".join(kept).removeprefix("Value error ").removeprefix("Error parsing ")
    for form, worded in _WORDED.items():
        words = re.sub(form, worded, words)
    return words or "not understood"


def _choice_words(match: re.Match) -> str:
    """Word a wrong choice as settings do; tyro has the choices in the order of a set."""
    known = sorted(match[3].rstrip(",").replace("'", "").split(", "))
    named = match[2] if match[2].startswith("--") else match[2].upper()
    return f"{named}: {match[1]} is not one of {', '.join(known)}"


FOUR_DEEP = re.compile(r"^[│| ] {5}(\S.*?)\s*[│|]?\s*$", re.MULTILINE)
"""In tyro's box, whose frame may be blanks: names; their explanations stand deeper."""


_WORDED = {
    r"(?:Invalid choice )?invalid choice ('.*') for argument '(\S+)'\. Expected one of \((.*)\)\.": _choice_words,
    r"no type matching \S*INT could be instantiated from \[('.*?')\].*": r"\1 is not a whole number",
    r"no type matching \S*FLOAT could be instantiated from \[('.*?')\].*": r"\1 is not a number",
    r"invalid literal for int\(\) with base 10: ('.*')": r"\1 is not a whole number",
    r"could not convert string to float: ('.*')": r"\1 is not a number",
    r"^settings: (?=--)": "",
    r"^Missing argument Missing value for argument '(\S+)'.*": r"\1: needs a value",
    r"^Unrecognized options Unrecognized options: (.*)": r"not understood: \1",
}
"""What Python and tyro say of a value -> what it means to people."""
