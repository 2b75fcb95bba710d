"""Bodies from what a user calls them: a scene folder, an .npz, the embedded samples, drawn ones, or some of these."""

from __future__ import annotations

import importlib
from pathlib import Path

from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.scenes import read_scene
from cloak_core.files.errors import InputError
from cloak_core.files.specs import select, split_selection

SCENES = {
    "sample": "samples:sample_bodies",
    "sample-clothed": "clothed:clothed_bodies",
    "sample-tight": "clothed:tight_bodies",
    "anny": "anny:drawn_bodies",
}
"""Bodies that are opened by name: MODULE:FUNCTION below `people`, imported when they are asked for, called with what
follows the colon where something does."""


def load_scene(spec: str | Path) -> Bodies:
    """Load bodies: a scene folder, an .npz, the embedded ones, or bodies drawn from Anny on the spot.

    Embedded: "sample", "sample:train", "sample:unseen", likewise in cloth "sample-clothed" and "sample-tight"
    (`people.clothed`); drawn: "anny:COUNT[:SEED[:POSES]]" (`people.anny`).

    `SPEC[0:4]`, `SPEC[2,5]`, `SPEC[walking*]` take some of them (`files.specs`). Raises `InputError`.
    """
    whole, selection = split_selection(str(spec))
    name, _, rest = whole.partition(":")
    if name in SCENES:
        module, _, function = SCENES[name].partition(":")
        make = getattr(importlib.import_module(f"cloak_core.sources.bodies.people.{module}"), function)
        bodies = make(*[rest] if rest else [])
    elif Path(whole).suffix.lower() == ".json":
        raise InputError(f"--scene {whole}: no scene of bodies; people in photographs are --people {whole}")
    else:
        bodies = read_scene(whole)
    return bodies if selection is None else bodies.select_poses(select(selection, bodies.names, str(spec)))
