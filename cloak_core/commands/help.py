"""What `--help` prints, made of the commands' fields and docstrings."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import itertools
import re
import shutil
import textwrap
import types
import typing
from functools import cache
from pathlib import Path

from tyro.conf import Positional

from cloak_core.commands.base import Command

COLUMN = 30
"""Where explanations begin."""
WORDS = {Path: "PATH", str: "TEXT", int: "N", float: "X"}
POSITIONAL = typing.get_args(Positional[int])[-1]
"""How tyro marks an option that stands without a name."""
SHARED = {
    "scene": "Bodies: scene folder, .npz, or sample[:train|unseen].",
    "people": "People in photographs: COCO file of masks, and keypoints or BlazePose landmarks; FILE[0::2] takes every "
    "second photograph.",
    "images": "Folder of these photographs (default: beside the file, or images/ there).",
    "backgrounds": "Images without people: folder, or procedural[:train|test][:COUNT[:SEED]].",
    "detector": "Detector: builtin, onnx:FILE, darknet:CFG:WEIGHTS ... (cloak detectors list).",
    "logo": "Faces to colour: face list (.npy), or regions of the scene, chest+thighs.",
    "angles": "Azimuths, degrees: FIRST:LAST:STEP with LAST included, or a comma list.",
    "distances": "Camera distances, metres.",
    "elevations": "Camera elevations, degrees.",
    "size": "Width and height of the images, pixels.",
    "shift": "Move the body by up to this many pixels along both axes.",
    "images_per_view": "Images of every body at every angle, elevation and distance.",
    "most_images": "Most images; fewer are drawn by the seed.",
    "hide": "What cloaks hide: the class person, or every class on the body.",
    "steps": "Updates of the colours.",
    "seed": "Seed of every random draw.",
    "seeds": "Repetitions, each with another seed.",
    "detectors_per_step": "Detectors to ask in each step, drawn at random (default: all).",
    "repeats": "Timed repetitions behind each median.",
    "device": "Torch device: auto (CUDA where it works, else CPU), cpu, cuda, cuda:1.",
    "threads": "CPU threads of torch; equal bits need equal numbers.",
    "dpi": "Pixels per inch of the texture.",
    "palette": "File of printable colours, one a line: three numbers in [0, 1] or #rrggbb; or a GIMP .gpl.",
    "resume": "Continue --out from its last checkpoint.",
    "redraw": "Write tables and figures again from the numbers in --out; measure nothing.",
    "publish": "Folder of records, which takes these rows under the name of --out.",
    "ray": "Ray cluster for the work: local, or an address (auto, HOST:6379, ray://HOST:10001) that sees the same "
    "files; each run takes --threads cores.",
}
"""What an option of several commands means, by the name of its field: for fields without words of their own, or whose
own words, in brackets, say more or what the default is."""
SHARED |= dict.fromkeys(("spec", "specs"), SHARED["detector"])
GROUPS_ORDER = {"Detectors": 0, "Computing": 2}
"""Which groups of options begin and end the help; the others stand between them, as they come."""


@dataclasses.dataclass(frozen=True)
class Option:
    """One option of a command."""

    flag: str
    """As it is typed: --steps; RUN_FOLDER where it stands without a name."""
    takes: str
    """What stands behind it: N; "" for a switch."""
    default: str
    """What it is where nobody gives it; "" for a switch, or where the words say it."""
    words: str
    """What it means."""
    kind: object
    """The type of its value."""
    group: tuple[str, str] = ("Options", "")
    """Title of the options that it belongs to, and what they are about."""
    is_positional: bool = False
    is_needed: bool = False


def options_of(cls: type, default: object = None, group: tuple[str, str] = ("Options", "")) -> list[Option]:
    """List a command's own options, then those that it inherits, --json, and each group of options.

    default: an instance whose values are the defaults; None: those of the fields.
    """
    hints = typing.get_type_hints(cls, include_extras=True)
    own: list[Option] = []
    groups: list[list[Option]] = []
    inherited = lambda field: (field.name == "json", field.name not in cls.__annotations__)
    for field in sorted(dataclasses.fields(cls), key=inherited):
        hint = hints[field.name]
        kind, *extras = typing.get_args(hint) if typing.get_origin(hint) is typing.Annotated else (hint,)
        named = next((extra.name for extra in extras if getattr(extra, "name", None)), field.name)
        if any(repr(extra) == "Suppress" for extra in extras):
            continue
        if dataclasses.is_dataclass(kind) and not hasattr(kind, "metavar"):
            about = " ".join((kind.__doc__ or "").partition("\n\n")[0].split())
            groups.append(options_of(kind, _default(field, default), (named.capitalize(), about)))
        else:
            own.append(_option(cls, field, kind, extras, named, _default(field, default), group))
    groups.sort(key=lambda options: GROUPS_ORDER.get(options[0].group[0], 1))
    return own + [option for options in groups for option in options]


def _default(field: dataclasses.Field, instance: object) -> object:
    """Find the field's value in `instance`, or its default; None where it has none."""
    if instance is not None:
        return getattr(instance, field.name)
    if field.default is not dataclasses.MISSING:
        return field.default
    return None if field.default_factory is dataclasses.MISSING else field.default_factory()


def _option(
    cls: type, field: dataclasses.Field, kind: object, extras: list, named: str, value: object, group: tuple[str, str]
) -> Option:
    words = next((extra.help for extra in extras if getattr(extra, "help", None)), None)
    words = words or _documented(cls).get(field.name, "")
    default_words = re.fullmatch(r"\(default: (.*)\)", words)
    if not words or words.startswith("("):
        words = f"{SHARED.get(field.name, '')} {'' if default_words else words}".strip()
    is_positional = POSITIONAL in extras
    is_needed = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    is_said = is_needed or value is None or type(value) is bool or "(default" in words
    default = "" if is_said else " ".join(map(str, value)) if type(value) is tuple else str(value)
    default = default_words[1] if default_words else default
    if is_needed and not is_positional:
        group = ("Required", "")
    if is_positional:
        group = ("Arguments", "")
        flag, takes = field.name.upper(), "..." if typing.get_origin(kind) is tuple else ""
    else:
        flag = ("--no-" if kind is bool and value is True else "--") + named.replace("_", "-")
        takes = _takes(kind)
    if any(repr(extra) == "UseAppendAction" for extra in extras):
        words, takes = f"{words} Repeatable.", _takes(typing.get_args(kind)[0])
    return Option(flag, takes, default, words, kind, group, is_positional, is_needed)


def _takes(kind: object) -> str:
    """Name what stands behind an option."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if kind is bool:
        return ""
    if origin is typing.Annotated:
        return _takes(parts[0])
    if origin in (types.UnionType, typing.Union):
        return "|".join(_takes(part) for part in parts if part is not types.NoneType)
    if origin is typing.Literal:
        return "{" + ",".join(map(str, parts)) + "}"
    if origin is tuple:
        return f"{_takes(parts[0])} ..." if parts[-1] is ... else " ".join(map(_takes, parts))
    return getattr(kind, "metavar", None) or WORDS.get(kind, "VALUE")


@cache
def _documented(cls: type) -> dict[str, str]:
    """Read the string below each field, also of the classes above."""
    docs: dict[str, str] = {}
    for above in reversed(cls.__mro__):
        if dataclasses.is_dataclass(above):
            (tree,) = ast.parse(textwrap.dedent(inspect.getsource(above))).body
            for field, below in itertools.pairwise(tree.body):
                match field, below:
                    case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(words))):
                        docs[name] = " ".join(words.split())
    return docs


def all_commands(groups: dict[str, dict[str, type[Command]]]) -> str:
    """Write the help of `cloak` itself: every command under its group."""
    lines = ["usage: cloak COMMAND [OPTIONS]   (cloak COMMAND --help says what it takes)"]
    for title, commands in groups.items():
        lines += ["", f"{title}:"]
        for name, cls in commands.items():
            lines += _entry(f"cloak {name}", summary(cls.__doc__ or ""), COLUMN - 2)
    return "\n".join(lines) + "\n"


def one_command(cls: type[Command], name: str, default: Command | None, everything: bool) -> str:
    """Write the help of one command.

    default: where options' defaults are taken from; everything: also what few people use.
    """
    lines = [f"usage: {usage(cls, name)}", ""]
    for paragraph in inspect.cleandoc(cls.__doc__ or "").split("\n\n"):
        lines += [*_wrapped(" ".join(paragraph.split()), _width()), ""]
    # So that a shell takes the example as it stands.
    lines += ["Example:", "  " + " \\\n    ".join(_wrapped(f"cloak {name} {cls.example}".strip(), _width() - 6))]
    options = options_of(cls, default)
    shown = options
    if cls.common and not everything:
        by_flag = {option.flag: option for option in options}
        options_shown = [by_flag[f"--{word}"] for word in cls.common]
        shown = [dataclasses.replace(o, group=o.group if o.is_needed else ("Options", "")) for o in options_shown]
    shown.sort(key=lambda option: (not option.is_positional, not option.is_needed))
    for (title, about), some in itertools.groupby(shown, lambda option: option.group):
        title = "Options [default]" if title == "Options" else title
        lines += ["", *_wrapped(f"{title}: {about}".rstrip(), _width())]
        for option in some:
            default = f"[{option.default}]" if option.default else ""
            lines += _entry(" ".join(filter(None, (option.flag, option.takes, default))), option.words, COLUMN)
    if len(shown) < len(options):
        lines += ["", f"{len(options) - len(shown)} more options: cloak {name} --help-all"]
    return "\n".join(lines) + "\n"


def usage(cls: type[Command], name: str) -> str:
    """Write one line: the command, what it must be given, and that there are options."""
    options = options_of(cls)
    words = [(f"{option.flag} {option.takes}".rstrip(), option.is_needed) for option in options if option.is_positional]
    parts = [word if needed else f"[{word}]" for word, needed in words]
    parts += [f"{o.flag} {o.takes}" for o in options if o.is_needed and not o.is_positional]
    return " ".join([f"cloak {name}", *parts, "[OPTIONS]"])


@cache
def flags(cls: type[Command]) -> dict[str, str]:
    """List a command's options as they are typed, --steps, each with the first sentence of what it means."""
    return {option.flag: summary(option.words) for option in options_of(cls) if not option.is_positional}


def summary(words: str) -> str:
    """Take a docstring's first sentence: up to a full stop that a capital follows."""
    paragraph = " ".join(words.strip().partition("\n\n")[0].split())
    return re.split(r"(?<=\.) (?=[A-Z])", paragraph)[0]


def _entry(name: str, words: str, column: int) -> list[str]:
    """Write a name, and beside it what it means; below it where the name is long."""
    first, *more = _wrapped(words, max(_width() - column, 24)) or [""]
    head = f"  {name}"
    beside = [head, " " * column + first] if len(head) + 2 > column else [head.ljust(column) + first]
    return beside + [" " * column + line for line in more]


def _wrapped(words: str, width: int) -> list[str]:
    return textwrap.wrap(words, width, break_long_words=False, break_on_hyphens=False)


def _width() -> int:
    return min(shutil.get_terminal_size().columns, 100)
