"""What jobs of these tests do, in a module that Ray's workers find."""

from cloak_core.files.errors import InputError


def refuse(number: int) -> int:
    """The number; 1 is bad input."""
    if number == 1:
        raise InputError("one: refused")
    return number
