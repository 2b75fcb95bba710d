"""What jobs of these tests do, in a module that Ray's workers find."""

import os
from pathlib import Path

from cloak_core.files.errors import InputError


def refuse(number: int) -> int:
    """The number; 1 is bad input."""
    if number == 1:
        raise InputError("one: refused")
    return number


def die_once(folder: Path, number: int) -> int:
    """The number, counted in a file each time; the process of 1 ends the first time, as one without memory does."""
    with open(folder / str(number), "a") as file:
        file.write("x")
    if number == 1 and (folder / "1").stat().st_size == 1:
        os._exit(9)
    return number


def fit_and_note(people: list, folder: str) -> list[bytes]:
    """Fit people, and count in a file of each how often."""
    from cloak_core.sources.photographs.fits import fit_some  # torch, which the other jobs do without

    packed = fit_some(people)
    for person in people:
        with open(Path(folder, person.photograph), "a") as file:
            file.write("x")
    return packed


def break_down() -> float:
    """Break down, as no job should."""
    return 1 / 0
