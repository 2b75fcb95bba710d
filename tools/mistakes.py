"""Typical mistakes: every command bare and with five or more errors that people make, and the line that each gets.

`python tools/mistakes.py` prints the page that tools/build_docs.py puts on the site. Commands run in this process, in
a new folder.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import get_args, get_origin

from cloak_core import cli
from cloak_core.commands.help import options_of

RUNS_BARE = (
    *("demo", "setup", "zoo list", "version", "detectors list", "zoo reproduce"),
    *("bench growth", "bench stability", "bench step", "bench gpu", "bench detectors"),
)
"""Commands that need nothing: bare, they do their work."""
READS = {
    "demo": "",
    "train": "--logo {} --out new",
    "evaluate": "{}",
    "report": "{}",
    "setup": "--into new --source ./{}",
    "remote": "",
    "zoo list": "",
    "zoo show": "{}",
    "zoo export": "{} --out new.glb",
    "version": "",
    "completion": "{}",
    "scene sample": "",
    "scene import": "{} --out new",
    "scene import-smpl": "--model {} --poses walk.npz --out new",
    "scene import-anny": "",
    "scene info": "{}",
    "people fit": "{}",
    "logo select": "--scene {} --region chest --out new.npy",
    "logo project": "--scene {} --text G --out new.npy",
    "logo heatmap": "--scene {} --detector builtin --out new.npy",
    "logo transfer": "--from sample --to {} --logo chest.npy --out new.npy",
    "detectors list": "",
    "detectors check": "builtin --image {}",
    "detectors verify": "{}",
    "wear": "zoo:builtin-sample --people {} --detector builtin --out new",
    "judge": "{} --detector builtin",
    "film": "{} --out new.gif",
    "transfer": "--detector builtin --detector {} --out new",
    "sweep": "{} --out new",
    "export coco": "{} --out new",
    "assess": "{} --out new",
    "leaderboard add": "{}",
    "leaderboard build": "{}",
    "harden": "{} --out new",
    "print": "{} --out new",
    "calibrate": "--measured {} --out new.npz",
    "reproduce": "{}",
    "zoo reproduce": "{}",
    "zoo add": "{} --name first --about Chest",
    "look": "{} --detector builtin",
    "bench views": "--scene {}",
    "bench accuracy": "--scene {}",
    "bench growth": "",
    "bench stability": "",
    "bench step": "--detector {}",
    "bench gpu": "",
    "bench detectors": "--detector {}",
}
"""Options with which each command reads a file; "" for those that read none."""


@dataclass(frozen=True)
class Mistake:
    """A mistake, the line that was typed, and what came of it."""

    kind: str
    line: str
    code: int
    said: str


def mistakes(name: str) -> list[Mistake]:
    """Make a command's mistakes in the working folder, which holds notes.txt and nothing else."""
    return [Mistake(kind, line, *run(line)) for kind, line in lines(name)]


def lines(name: str) -> Iterator[tuple[str, str]]:
    """Yield kind and line of each mistake."""
    cls = cli.load(name)
    example = f"{name} {cls.example}".split(" -- ")[0].strip()
    options = {option.flag: option.kind for option in options_of(cls) if not option.is_positional}
    valued = [flag for flag, kind in options.items() if kind is not bool]
    numbers = [flag for flag in valued if {int, float} & {options[flag], *get_args(options[flag])}]
    if name not in RUNS_BARE:
        yield "bare", name
    yield "command misspelt", " ".join([*name.split()[:-1], swapped(name.split()[-1])])
    yield "option misspelt", f"{example} --{swapped(next(iter(options))[2:])}"
    if valued:
        yield "option without its value", f"{example} {valued[0]}"
    if numbers:
        yield "text for a number", f"{example} {numbers[0]} many"
    yield "option that does not exist", f"{example} --colour red"
    yield "a value for a switch", f"{example} --json=yes"
    if not any(option.is_positional and get_origin(option.kind) is tuple for option in options_of(cls)):
        yield "a word too many", f"{example} surplus"
    if reads := READS[name]:
        yield "missing file", f"{name} {reads.format('absent.npz')}"
        yield "file of another kind", f"{name} {reads.format('notes.txt')}"


def swapped(word: str) -> str:
    """Swap two letters in the middle of a word."""
    at = max(len(word) // 2, 1)
    return word[: at - 1] + word[at] + word[at - 1] + word[at + 1 :]


def run(line: str) -> tuple[int, str]:
    """Run a command line; give its exit code, and what it said on standard error."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            cli.main(line.split())
        except SystemExit as end:
            return int(end.code or 0), said.getvalue().strip()
    raise AssertionError("a command ends with an exit code")


def every_mistake() -> dict[str, list[Mistake]]:
    """Make every command's mistakes in a folder of their own."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("notes.txt").write_text("Not what was asked for.\n")
        return {name: mistakes(name) for name in cli.COMMANDS}


def mistakes_page() -> str:
    """Write the page: a table for each command."""
    text = ["# Typical mistakes", "", *INTRODUCTION]
    for name, made in every_mistake().items():
        text += ["", f"## cloak {name}", "", "| mistake | typed | code | answer |", "|---|---|---|---|"]
        if name in RUNS_BARE:
            text.append(f"| bare | `cloak {name}` | | needs nothing: does its work |")
        for mistake in made:
            said = mistake.said.removeprefix("cloak: ").replace("|", "\\|").replace("`", "'")
            text.append(f"| {mistake.kind} | `cloak {mistake.line}` | {mistake.code} | `{said}` |")
    return "\n".join(text) + "\n"


INTRODUCTION = (
    "What each command answers bare, and to the mistakes that people make: one line on standard error, exit code 2,",
    "and nothing is written. This page is made by running them (`tools/mistakes.py`).",
)


if __name__ == "__main__":
    print(mistakes_page(), end="")
