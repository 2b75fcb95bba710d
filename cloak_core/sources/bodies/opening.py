"""Bodies from what a user calls them: a scene folder, an .npz, the embedded samples, drawn ones, or some of these."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.scenes import read_scene
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies import people
from cloak_core.sources.bodies.selection import select, split_selection


def load_scene(spec: str | Path) -> Bodies:
    """Load bodies: a scene folder, an .npz, the embedded ones, or bodies drawn from Anny on the spot.

    Embedded: "sample", "sample:train", "sample:unseen", likewise in cloth "sample-clothed" and "sample-tight"
    (`people.clothed`); drawn: "anny:COUNT[:SEED[:POSES]]" (`people.anny`).

    `SPEC[0:4]`, `SPEC[2,5]`, `SPEC[walking*]` take some of them (`bodies.selection`). Raises `InputError`.
    """
    whole, selection = split_selection(str(spec))
    bodies = _open_whole(whole)
    if selection is None:
        return bodies
    return bodies.select_poses(select(selection, bodies.names, str(spec)))


def _open_whole(spec: str) -> Bodies:
    name, _, rest = spec.partition(":")
    # A path is not looked for among the names: their files take a third of a second to import.
    if Path(name).name == name and not Path(name).suffix and name in opened():
        return opened()[name](*[rest] if rest else [])
    if Path(spec).suffix.lower() == ".json":
        raise InputError(f"--scene {spec}: no scene of bodies; people in photographs are --people {spec}")
    return read_scene(spec)


@cache
def opened() -> dict[str, Callable[..., Bodies]]:
    """Find what opens bodies by name: functions of what follows the colon, `OPENED` of each file in `people`."""
    found = {}
    for module in pkgutil.iter_modules(people.__path__):
        found |= getattr(importlib.import_module(f"{people.__name__}.{module.name}"), "OPENED", {})
    return found
