"""Random smooth folds for bodies that wear their clothes like paint.

The surface under some faces goes in and out and slides a little along itself, by sums of waves as long as folds are;
the light follows, because normals are taken from the vertices. What it is worth: docs/reports/cloth.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Integer

from cloak_core.core.geometry import vertex_normals
from cloak_core.core.polygons import polygon_loops
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.checks import frozen

LENGTHS = (0.05, 0.25)
"""Metres from fold to fold."""
WAVES = 12


def wrinkled(bodies: Bodies, faces: Integer[np.ndarray, " logo"], depth: float, draws: int, seed: int) -> Bodies:
    """Make `draws` poses of each of the bodies' poses, every one in folds of its own under `faces`.

    A vertex there moves by at most 2 * `depth` metres outwards (cloth lies on skin) and by at most `depth` along each
    axis besides; vertices of other faces stay, so that nothing tears. Pose p becomes poses p * draws and those that
    follow it; the same seed gives the same folds.
    """
    free = _inner_vertices(bodies, faces)
    place = bodies.vertices[0].astype(np.float64)[free]
    vertices = np.repeat(bodies.vertices, draws, axis=0)
    for number, pose in enumerate(vertices):
        if number % draws == 0:
            outwards = vertex_normals(bodies, number // draws)[free]
        random = np.random.default_rng([seed, number])
        folds = np.stack([smooth_field(place, random) for _ in range(4)], axis=-1)
        pose[free] += depth * (outwards * (1 + folds[:, :1]) + folds[:, 1:] * (1 - np.abs(outwards)))
    names = tuple(f"{name} in folds {draw}" for name in bodies.names for draw in range(draws))
    return replace(bodies, vertices=frozen(vertices), names=names, recorded_topology=bodies.topology)


def smooth_field(points: Float[np.ndarray, "N 3"], random: np.random.Generator) -> Float[np.ndarray, " N"]:
    """Draw a random smooth function at some points, between -1 and 1: waves in all directions."""
    direction = random.standard_normal((WAVES, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    length = np.exp(random.uniform(*np.log(LENGTHS), WAVES))
    phase = random.uniform(0, 2 * np.pi, WAVES)
    waves = np.sin(2 * np.pi * points @ (direction / length[:, None]).T + phase)
    # Of independent waves the sum's spread grows with the root of their number; tanh keeps it within bounds.
    return np.tanh(waves.sum(1) / np.sqrt(WAVES / 2))


def _inner_vertices(bodies: Bodies, faces: np.ndarray) -> Integer[np.ndarray, " N"]:
    """Find the vertices all of whose polygons are among `faces`."""
    loop_total, loop_vertices, face = polygon_loops(bodies)
    mine = np.isin(np.repeat(face, loop_total), faces)
    inside = np.zeros(bodies.vertex_count, bool)
    inside[loop_vertices[mine]] = True
    inside[loop_vertices[~mine]] = False
    return np.flatnonzero(inside)
