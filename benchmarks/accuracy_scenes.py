"""The scenes of `cloak bench accuracy`: a body from near and far, and surfaces that overlap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cloak_core.bench.views import chest_and_thighs
from cloak_core.core.cameras import Camera
from cloak_core.core.geometry import vertex_normals
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.bodies.meshes.subdivision import subdivide


@dataclass(frozen=True)
class Scene:
    """A body and the camera that makes it hard."""

    bodies: Bodies
    camera: Camera


SIDE = Camera(azimuth=-10.0)
FAR = replace(SIDE, distance=8.0)


def make_scene(name: str, bodies: Bodies) -> Scene:
    """Make one of `SCENES`, from the first pose of these bodies."""
    return SCENES[name](bodies.select_poses([0]))


def _million(body: Bodies) -> Scene:
    while body.triangle_count < 800_000:
        body, _ = subdivide(body)
    return Scene(body, SIDE)


def _with(body: Bodies, vertices: np.ndarray, triangles: np.ndarray) -> Bodies:
    """Join the body and more triangles, each a face."""
    first = body.vertices[0]
    return Bodies(
        vertices=np.concatenate([first, vertices])[None].astype(np.float32),
        triangles=np.concatenate([body.triangles, triangles + len(first)]),
    )


def _outside(body: Bodies, metres: float) -> np.ndarray:
    """Move the body's vertices outwards."""
    return body.vertices[0].astype(np.float64) + metres * vertex_normals(body)


def _shell(body: Bodies, metres: float) -> Scene:
    """Put a closed surface all around the body, seen from far away."""
    return Scene(_with(body, _outside(body, metres), body.triangles), FAR)


def _garment(body: Bodies) -> Scene:
    """Open pieces of cloth 8 mm outside chest and thighs."""
    cloth = np.isin(body.triangle_face, chest_and_thighs(body))
    return Scene(_with(body, _outside(body, 0.008), body.triangles[cloth]), SIDE)


def _cards(corner: np.ndarray, along: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rectangles, each two triangles: vertices and triangles."""
    vertices = np.stack([corner, corner + along, corner + along + across, corner + across], 1).reshape(-1, 3)
    first = 4 * np.arange(len(corner))[:, None]
    return vertices, np.concatenate([first + np.array(corners) for corners in ([0, 1, 2], [0, 2, 3])])


def _hair(body: Bodies) -> Scene:
    """3,000 narrow cards that hang about the head, through one another."""
    rng = np.random.default_rng(0)
    top = body.vertices[0][:, 1].max()
    middle = body.vertices[0][body.vertices[0][:, 1] > top - 0.25].mean(0)
    direction = rng.normal(0, 1, (3000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    along = np.array([0, -0.15, 0]) + rng.normal(0, 0.03, (3000, 3))
    across = rng.normal(0, 0.002, (3000, 3))
    return Scene(_with(body, *_cards(middle + 0.13 * direction, along, across)), SIDE)


def _stacked(body: Bodies) -> Scene:
    """24 stacks of eight parallel cards before the body, 1 mm apart, each moved by half a card."""
    stack, layer = (t.ravel() for t in np.mgrid[:24, :8])
    center = body.vertices[0].mean(0)
    corner = np.stack(
        [stack % 6 * 0.1 - 0.3 + layer * 0.02, stack // 6 * 0.2 - 0.4 + layer * 0.01, 0.4 + layer * 0.001], 1
    )
    size = len(corner), 1
    return Scene(_with(body, *_cards(center + corner, np.tile([0, 0.1, 0], size), np.tile([0.04, 0, 0], size))), SIDE)


def _soup(body: Bodies) -> Scene:
    """2,000 triangles anywhere in a ball, through one another, and no body."""
    rng = np.random.default_rng(0)
    vertices = (rng.normal(0, 0.3, (2000, 1, 3)) + rng.normal(0, 0.08, (2000, 3, 3))).reshape(-1, 3)
    return Scene(Bodies(vertices=vertices[None].astype(np.float32), triangles=np.arange(6000).reshape(-1, 3)), SIDE)


SCENES: dict[str, Callable[[Bodies], Scene]] = {
    "bench": lambda body: Scene(body, SIDE),
    "distant": lambda body: Scene(body, FAR),
    "close-up": lambda body: Scene(body, replace(SIDE, distance=1.0, near=0.85)),
    "million": _million,
    "shell-5mm": lambda body: _shell(body, 0.005),
    "shell-1mm": lambda body: _shell(body, 0.001),
    "shell-0.1mm": lambda body: _shell(body, 0.0001),
    "garment": _garment,
    "hair": _hair,
    "cards": _stacked,
    "soup": _soup,
}
