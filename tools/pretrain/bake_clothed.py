"""Makes the embedded clothed people (cloak_core/sources/bodies/data/clothed.npz) from Anny and Blender's cloth solver.

Not needed to use Cloak. It needs `pip install cloak-core[anny]` here and a Blender, or a Python with bpy
(`make .venv-blender/.installed`, or CLOAK_BLENDER). Run:

    python -m tools.pretrain.bake_clothed --clips CLIPS --out cloak_core/sources/bodies/data/clothed.npz

CLIPS keeps each solved clip, so that a run that was stopped goes on. Shapes, motions and seeds are tables in
`clothing/tables.py`; the solver's result may differ a little between Blender's versions.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from cloak_core.files.reading import read_npz
from cloak_core.files.writing import write_npz
from cloak_core.sources.bodies.people.anny import AnnySource
from cloak_core.sources.bodies.people.clothed import skin_of
from cloak_core.sources.bodies.people.samples import load
from tools.pretrain.bake_bodies import quantise
from tools.pretrain.clothing.checking import hidden_seen
from tools.pretrain.clothing.draping import Person, draped
from tools.pretrain.clothing.garments import Garment, bare_faces, cut
from tools.pretrain.clothing.tables import CLIPS, PEOPLE, Clip

STEP = 0.0002
"""Metres that the cloth's distance from the skin is rounded to."""


def solved(clip: Clip, person: Person, garments: list[Garment], folder: Path) -> dict[str, np.ndarray]:
    """The clip, from `folder` where it was solved before."""
    path = folder / f"{clip.name}.npz"
    if not path.exists():
        print(f"{clip.name}: {clip.frames} frames", flush=True)
        write_npz(path, **draped(clip, person, garments))
    return read_npz(path)


def weights_by_bone(weights: np.ndarray) -> dict[str, np.ndarray]:
    """Weights [R, J] as lists, bone after bone, in steps of 1/65535."""
    steps = np.rint(weights * 65535).astype(np.uint16)
    bone, vertex = np.nonzero(steps.T)
    count = np.bincount(bone, minlength=weights.shape[1])
    return {"weight": steps.T[bone, vertex], "weight_vertex": vertex.astype(np.uint16), "weight_count": count}


def bake(path: Path, folder: Path) -> None:
    """Write the clothed people; see cloak_core/sources/bodies/people/clothed.py for the reader."""
    source, samples = AnnySource(), load()[0]
    average, skeleton = source.figure({"age": 0.67})
    garments = cut(average, source.quads, samples.regions, skeleton)
    touched = samples.regions["shirt"] | samples.regions["trousers"]
    figures = {name: source.figure(shape) for name, shape in PEOPLE.items()}
    people = {
        name: Person(rest, source.quads, source.weights, bones, touched) for name, (rest, bones) in figures.items()
    }
    clips = [solved(clip, people[clip.person], garments, folder) for clip in CLIPS]
    mask = bare_faces(average, source.quads, garments)
    bare = np.flatnonzero(mask)
    pack(path, source, bare, garments, [people[name].rest for name in PEOPLE], clips)
    found = [hidden_seen(people[clip.person], done, garments, mask) for clip, done in zip(CLIPS, clips, strict=True)]
    shares, whole, part = (np.concatenate(kind) for kind in zip(*found, strict=True))
    print(
        f"skin left out: {(~mask).sum()} of {len(mask)} polygons, in {len(shares)} views {shares.mean():.3%} of what "
        f"is seen, at most {shares.max():.2%}; a view takes {np.median(part):.4f} s instead of {np.median(whole):.4f}"
    )


def pack(
    path: Path,
    source: AnnySource,
    bare: np.ndarray,
    garments: list[Garment],
    rests: list[np.ndarray],
    clips: list[dict[str, np.ndarray]],
) -> None:
    seen = np.unique(source.quads[bare])
    hidden = np.setdiff1d(np.unique(np.concatenate([g.vertices for g in garments])), seen)
    rows = np.concatenate([seen, hidden])
    row_of = np.full(len(source.weights), -1)
    row_of[rows] = np.arange(len(rows))
    starts = len(seen) + np.cumsum([0] + [len(g.vertices) for g in garments])
    quads = [row_of[source.quads[bare]], *(g.quads + start for g, start in zip(garments, starts, strict=False))]
    steps, origin, step = quantise(np.stack([rest[rows] for rest in rests]))
    bones = [np.concatenate([c["turned"], c["offsets"][..., None]], -1).astype(np.float32) for c in clips]
    order = list(PEOPLE)
    data = {
        "quads": np.concatenate(quads).astype(np.uint16),
        "owner": np.repeat(np.arange(3), [len(q) for q in quads]).astype(np.uint8),
        "source_face": np.concatenate([bare, *(g.faces for g in garments)]).astype(np.uint16),
        "skin_vertices": np.int64(len(seen)),
        "cut_from": row_of[np.concatenate([g.vertices for g in garments])].astype(np.uint16),
        "rest_steps": np.diff(steps, axis=1, prepend=np.zeros_like(steps[:, :1])),
        "rest_origin": origin.astype(np.float64),
        "rest_step": step,
        **weights_by_bone(source.weights[rows]),
        "bones": np.concatenate(bones),
        "cloth_step": np.float64(STEP),
        "clip_names": np.array([clip.name for clip in CLIPS]),
        "clip_person": np.array([order.index(clip.person) for clip in CLIPS]),
        "clip_frames": np.array([clip.frames for clip in CLIPS]),
        "clip_unseen": np.array([clip.unseen for clip in CLIPS]),
    }
    data["cloth"] = np.concatenate([_steps(data, n, clip, garments) for n, clip in enumerate(clips)])
    np.savez_compressed(path, **data)


def _steps(data: dict, number: int, clip: dict[str, np.ndarray], garments: list[Garment]) -> np.ndarray:
    """The cloth's distance from the skin as the reader poses it, as differences that compress."""
    cloth = np.concatenate([clip[garment.name] for garment in garments], axis=1)
    away = cloth - skin_of(data, number)[:, data["cut_from"]]
    steps = np.rint(away / STEP).astype(np.int16)
    along = np.diff(steps, axis=1, prepend=np.zeros_like(steps[:, :1]))
    return np.diff(along, axis=0, prepend=np.zeros_like(along[:1]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clips", type=Path, required=True, help="folder that keeps solved clips")
    parser.add_argument(
        "--out", type=Path, default=Path(__file__).parents[2] / "cloak_core" / "scene" / "data" / "clothed.npz"
    )
    given = parser.parse_args()
    given.clips.mkdir(parents=True, exist_ok=True)
    bake(given.out, given.clips)
    print(f"{given.out}: {given.out.stat().st_size / 1e6:.2f} MB, {sum(clip.frames for clip in CLIPS)} poses")


if __name__ == "__main__":
    main()
