"""What an optional technique of training is: five hooks by which it acts; and what other packages bring.

No technique is named here. Each file of `cloak_core/techniques` is one, and a package may bring others: a subclass of
`Technique` that overrides the hooks where it acts. Its settings stand among those of the component that it belongs to
(`core.settings.components`). Whatever it draws at random is a function of (seed, step), so that it needs no state in
checkpoints. Off, it is not built.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import ClassVar, Literal, TypeVar

import numpy as np
import torch
from jaxtyping import Float

from cloak_core.files.errors import InputError, first_line
from cloak_core.files.identity import source_hash

T = TypeVar("T")


class Technique:
    """Does nothing; each technique overrides the hooks where it acts."""

    def detector_context(self, number: int, step: int) -> contextlib.AbstractContextManager:
        """Make the context in which detector `number` runs in `step` of a training."""

    name: ClassVar[str]
    """Under what name events have its penalty."""

    def penalty(self, colors: Float[torch.Tensor, "C 3"]) -> tuple[float, Float[torch.Tensor, ""]]:
        """Compute what is added to the loss: its weight, and the figure that events have under `name`."""

    def project(self, colors: Float[torch.Tensor, "C 3"]) -> Float[torch.Tensor, "C 3"]:
        """Move colours to allowed ones. The mean of two allowed colours need not be allowed."""

    def content(self) -> dict[str, object]:
        """Record the content of the files that it reads, by the name in config.json (`run_config.FILES`)."""
        return {}

    def report(self, colors: Float[np.ndarray, "C 3"]) -> dict[str, float]:
        """Measure the colours that a run ends with, for its result."""
        return {}


class Techniques(tuple[Technique, ...]):
    """Those of a run that are on, in the order of their hooks."""

    def at(self, hook: str) -> list[Technique]:
        """List those that act at a hook."""
        return [technique for technique in self if getattr(type(technique), hook) is not getattr(Technique, hook)]

    @contextlib.contextmanager
    def detector_context(self, number: int, step: int | None) -> Iterator[None]:
        """Surround a detector's run in `step`; None, outside training, changes nothing."""
        with contextlib.ExitStack() as stack:
            for technique in [] if step is None else self.at("detector_context"):
                stack.enter_context(technique.detector_context(number, step))
            yield


NO_TECHNIQUES = Techniques()


def call_package(
    group: Literal["cloak.techniques", "cloak.patterns"], spec: str, kind: type[T], *arguments: object
) -> tuple[T, dict[str, str]]:
    """Call the entry point that a spec NAME or NAME:TEXT names with TEXT and `arguments`.

    It runs only because a caller named it. Returns what it made, of type `kind`, and a record: spec, package with its
    version, SHA-256 of the source that made it. InputError: no package has it, or several do; it fails, or makes
    something else.
    """
    name, _, text = spec.partition(":")
    there = entry_points(group=group)
    points = list(there.select(name=name))
    if len({point.value for point in points}) != 1:
        known = ", ".join(sorted(there.names)) or "none is installed"
        many = "several packages have" if points else "no installed package has"
        raise InputError(f"{spec}: {many} an entry point '{name}' of group {group} (known: {known})")
    point = points[0]
    try:
        make: Callable[..., object] = point.load()
        made = make(text, *arguments)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{spec}: {point.value}: {type(error).__name__}: {first_line(error)}") from error
    if not isinstance(made, kind):
        raise InputError(f"{spec}: {point.value} must return a {kind.__name__}, it returned {type(made).__name__}")
    package = "" if point.dist is None else f"{point.dist.name} {point.dist.version}"
    source = source_hash(Path(str(sys.modules[point.module].__file__)))
    return made, {"spec": spec, "package": package, "sha256": source}
