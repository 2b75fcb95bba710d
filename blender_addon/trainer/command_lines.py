# SPDX-License-Identifier: GPL-3.0-or-later
"""The `cloak` command lines that the add-on gives the trainer; the two share files and exit codes, no import."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

from ..files.errors import InputError
from ..files.reading import MAX_TEXT_BYTES, read_bytes
from ..files.specs import reach, split_spec, without_options
from ..session import session

SAMPLES = {"BARE": "sample:train", "CLOTHED": "sample-clothed:train"}
"""Training splits of the sample people; the other splits are held out for evaluation."""


OPTIONS = ("detector", "backgrounds", "angles", "preset", "steps", "device", "config", "init", "made-from")
"""Of `cloak train`: what the add-on sets."""


def known_options(words: list[str], source: Path) -> list[str]:
    """Return the options that a file keeps. Raises `InputError` for any that the add-on would not have written."""
    if words[-2:] == ["--made-from", "sample:train"]:  # of an earlier version
        words = [*words[:-2], "--made-from=sample:train"]
    known = tuple(f"--{name}=" for name in OPTIONS)
    for word in words:
        if not word.startswith(known):
            raise InputError(f"{source}: {word.partition('=')[0]} is no option of a run that Blender started")
    return words


def options(detectors: Iterable[str], **values: object) -> list[str]:
    """Options of a command: each detector, and the values by their names; "" and None leave the trainer's default."""
    # In one word: a value that starts with a minus looks like an option otherwise.
    named = [f"--{name}={value}" for name, value in values.items() if value not in ("", None)]
    return [*(f"--detector={spec}" for spec in detectors), *named]


def differing_options(begun: list[str], now: list[str]) -> str:
    """What a run was started with where the options are others now: "steps 60 (not 120), ..."; "" where nothing is."""
    was, wanted = _values(begun), _values(now)
    names = [name for name in was | wanted if was.get(name) != wanted.get(name)]
    return ", ".join(
        f"{name.strip('-')} {was.get(name, 'as by default')} (not {wanted.get(name, 'the default')})"
        for name in names
        if name not in ("--init", "--made-from")
    )


def _values(words: list[str]) -> dict[str, str]:
    """Return the values by option; repeated options are joined."""
    values: dict[str, str] = {}
    for name, _, value in (word.partition("=") for word in words):
        values[name] = f"{values[name]}, {value}" if name in values else value
    return values


def absolute_detector(spec: str) -> str:
    """A detector's name with the files in it as absolute paths: the trainer works in a folder of its own."""
    parts = split_spec(spec)
    for number, part in enumerate(parts):
        for path in (part, part.rpartition("@")[0]):  # what follows the @ are options
            if path and Path(path).is_file():
                parts[number] = str(Path(path).absolute()) + part[len(path) :]
                break
    return ":".join(parts)


def cloak_command(program: str, *words: object) -> list[str]:
    """A command of the trainer, `cloak WORDS...`, that prints its answer as JSON.

    Every command passes here: raises `Unasked` where a word needs the user's yes first.
    """
    words = [str(word) for word in words]
    require(words)
    module = ["-m", "cloak_core"] if "python" in Path(program).name.lower() else []
    return [program, *module, *words, "--json"]


def train_command(program: str, options: list[str], scene: Path, logo: Path, run: Path) -> list[str]:
    """Return the command line of `cloak train` on an export; `--resume` may be appended."""
    return cloak_command(program, "train", "--scene", scene, "--logo", logo, *options, "--out", run)


def sample_words(out: Path, people: str = "BARE") -> list[object]:
    """`cloak scene sample`; `people` are a key of `SAMPLES`."""
    clothed = ["--clothed"] if people == "CLOTHED" else []
    return ["scene", "sample", "--out", out, "--split", SAMPLES[people].partition(":")[2], *clothed]


class Unasked(InputError):
    """The user has not been asked about `specs` yet."""

    def __init__(self, specs: list[str]) -> None:
        super().__init__(
            f"{specs[0]} {reach(specs[0])}, and waits for your yes (without a window: --detector names it)"
        )
        self.specs = specs


def allow(words: Iterable[str]) -> None:
    """Take these words of a command line for named by the user."""
    session.allowed |= set(map(_content, _acting(words)))


def require(words: Iterable[str]) -> None:
    """Raise `Unasked` for words of a command line that run code or ask the network and have no yes."""
    if unasked := [spec for spec in _acting(words) if _content(spec) not in session.allowed]:
        raise Unasked(unasked)


def _acting(words: Iterable[str]) -> list[str]:
    values = (word.partition("=")[2] if word.startswith("--") else word for word in words)
    return [value for value in values if reach(value)]


def _content(spec: str) -> str:
    bare = without_options(spec)
    files = (Path(part) for part in split_spec(bare))
    code = [read_bytes(file, MAX_TEXT_BYTES) for file in files if file.is_file()] if reach(bare) == "runs code" else []
    return hashlib.sha256(b"\0".join([bare.encode(), *code])).hexdigest()
