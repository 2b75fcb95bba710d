"""Bodies from what a user calls them: a scene folder, an .npz, the embedded samples, or some bodies of these."""

from __future__ import annotations

from pathlib import Path

from cloak_core.errors import InputError
from cloak_core.scene.exchange import Bodies, read_scene
from cloak_core.scene.selection import select, split_selection


def open_scene(spec: str | Path) -> Bodies:
    """Bodies of a scene folder, of an .npz, or the embedded ones: "sample", "sample:train", "sample:unseen".

    `SPEC[0:4]`, `SPEC[2,5]`, `SPEC[walking*]` take some of them (`scene.selection`). Raises `InputError`.
    """
    whole, selection = split_selection(str(spec))
    bodies = _open_whole(whole)
    if selection is None:
        return bodies
    return bodies.select_poses(select(selection, bodies.names, str(spec)))


def _open_whole(spec: str) -> Bodies:
    head, _, split = spec.partition(":")
    if head != "sample":
        return read_scene(spec)
    from cloak_core.scene.samples import sample_bodies

    if split not in ("", "all", "train", "unseen"):
        raise InputError(f"scene '{spec}': the sample bodies come as sample, sample:train and sample:unseen")
    return sample_bodies(split or "all")
