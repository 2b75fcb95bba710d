"""Bodies from what a user calls them: a scene folder, an .npz, the embedded samples, drawn ones, or some of these."""

from __future__ import annotations

from pathlib import Path

from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.scenes import read_scene
from cloak_core.files.errors import InputError
from cloak_core.files.specs import split_spec
from cloak_core.sources.bodies.selection import select, split_selection


def load_scene(spec: str | Path) -> Bodies:
    """Load bodies: a scene folder, an .npz, the embedded ones, or bodies drawn from Anny on the spot.

    Embedded: "sample", "sample:train", "sample:unseen", likewise in cloth "sample-clothed" and "sample-tight"
    (`scene.people.clothed`); drawn: "anny:COUNT[:SEED[:POSES]]" (`scene.people.anny`).

    `SPEC[0:4]`, `SPEC[2,5]`, `SPEC[walking*]` take some of them (`scene.selection`). Raises `InputError`.
    """
    whole, selection = split_selection(str(spec))
    bodies = _open_whole(whole)
    if selection is None:
        return bodies
    return bodies.select_poses(select(selection, bodies.names, str(spec)))


def _open_whole(spec: str) -> Bodies:
    head, _, split = spec.partition(":")
    if head == "anny" and not Path(spec).exists():
        return _drawn(spec)
    if head in ("sample-clothed", "sample-tight"):
        from cloak_core.sources.bodies.people.clothed import clothed_bodies

        return clothed_bodies(split or "all", tight=head == "sample-tight")
    if head != "sample":
        return read_scene(spec)
    from cloak_core.sources.bodies.people.samples import sample_bodies

    return sample_bodies(split or "all")


def _drawn(spec: str) -> Bodies:
    from cloak_core.sources.bodies.people.anny import anny_bodies

    count, seed, poses = [*split_spec(spec)[1:], "", "", ""][:3]
    if not count.isdigit() or not (seed or "0").isdigit():
        raise InputError(f"scene '{spec}': bodies are drawn by anny:COUNT[:SEED[:POSES]], such as anny:64:0:walk")
    return anny_bodies(int(count), int(seed or 0), poses or "natural")
