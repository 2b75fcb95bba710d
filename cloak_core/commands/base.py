"""What every command shares: `--json`, where words go, and how bad input and stops end."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

from rich.console import Console
from rich.table import Table

from cloak_core.files.errors import one_line

RANK = int(os.environ.get("RANK", 0))
"""Which of torchrun's processes this is; one alone is 0. Only 0 writes on standard output."""


class Words(Console):
    """Where words for people go, as they are: no markup in them."""

    def __init__(self, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, highlight=False, soft_wrap=True, markup=False, emoji=False)

    def on_broken_pipe(self) -> None:
        """Raise what rich would end the process for, with exit code 1."""
        raise


err = Words(stderr=True)
"""Progress, warnings and errors: standard error, always."""
out = Words()
"""Results for people: standard output, silent under --json."""


@dataclass(kw_only=True)
class Command:
    """One command: fields are its options, `run` does the work and returns what `--json` prints."""

    example: ClassVar[str] = ""
    """Options with which help shows the command at work."""
    common: ClassVar[tuple[str, ...]] = ()
    """Options that --help shows where it does not show all, which --help-all does."""
    then: ClassVar[str] = ""
    """What people usually type after it, behind `cloak`; {name} is the value of an option."""
    next_why: ClassVar[str] = ""
    """What that is good for."""
    json: bool = False
    """Print one JSON object; everything else goes to standard error."""

    def run(self) -> dict:
        raise NotImplementedError

    def given(self, *others: str) -> dict:
        """List the options by name, but for --json and these others."""
        return {name: value for name, value in vars(self).items() if name not in ("json", *others)}

    def failures(self, result: dict) -> list[str]:
        """Say what turned out wrong; the command then ends with exit code 1."""
        return [result["failed"]] if result.get("failed") else []

    def show(self, result: dict) -> None:
        """Say the result to a person, on standard output."""

    def following(self, result: dict) -> tuple[str, ...]:
        """Give the words behind `cloak` that people usually type after this one; nothing after a quick one."""
        return tuple(word.format(**vars(self)) for word in self.then.split())


def command_line() -> str:
    """Give the command that this process runs, for records and pages."""
    return shlex.join(["cloak", *sys.argv[1:]])


def warn(message: str) -> None:
    """Write one line on standard error."""
    err.print(f"cloak: {one_line(message)}", style="yellow")


def next_words(command: Command, result: dict) -> None:
    """End a long command with the one that people usually type then."""
    if words := command.following(result):
        out.print(f"Next: {shlex.join(['cloak', *words])}" + (f"  ({command.next_why})" if command.next_why else ""))


def format_rate(value: float | None) -> str:
    """Write a share in a table: two digits, a dash for none."""
    return "–" if value is None else f"{value:.2f}"


def left_out(result: dict) -> str:
    """Say how many people of a result were left out, and why."""
    return ", ".join(f"{count} {reason}" for reason, count in result["left_out"].items()) or "nobody"


def table(
    title: str, heads: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1, whole: bool = False, **look: object
) -> Table:
    """Make a table whose first `words` columns are of words, the others of figures, which stay on one line.

    whole: the first column does, too, for names that people copy.
    """
    made = Table(title=title, **look)
    for number, head in enumerate(heads):
        is_figure = number >= words
        made.add_column(
            head, justify="right" if is_figure else "left", no_wrap=is_figure or (whole and not number), overflow="fold"
        )
    for row in rows:
        made.add_row(*row)
    return made
