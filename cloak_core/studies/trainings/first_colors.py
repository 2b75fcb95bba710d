"""The colours that a training begins with: of faces, or of the squares of a cloth."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32

from cloak_core.core.geometry import face_centres, face_normals
from cloak_core.core.logo import Logo
from cloak_core.core.pattern import Pattern
from cloak_core.core.places import face_places
from cloak_core.core.prints import PRINT_METRES, PRINTS
from cloak_core.core.settings.components import OptimizerSettings
from cloak_core.exchange.bodies import Bodies

FUR, COAT, DARK, MOUTH = (0.9, 0.85, 0.75), (0.75, 0.45, 0.15), (0.02, 0.02, 0.02), (0.25, 0.12, 0.08)
# Places in the face, in its heights: across from its middle, down from its top.
HALF_WIDTH, FOREHEAD, CHEEKS, CHEEKS_END = 0.3, 0.24, 0.21, 0.65
BLOBS = (
    (-0.16, 0.27, 0.053, 0.045, DARK),
    (0.16, 0.27, 0.053, 0.045, DARK),
    (0.0, 0.52, 0.1, 0.075, DARK),
    (0.0, 0.92, 0.12, 0.075, MOUTH),
)
"""Eyes, nose and mouth: place, half width and half height, colour."""
TALL = 0.38
"""Height of the face, of the body's; less where the logo has no room."""
COLUMN, GAP = 0.06, 0.05
"""Of the body's height: half the width of the strip about the middle that is looked at for room, and what parts it."""


def first_colors(
    settings: OptimizerSettings, pattern: Pattern, bodies: Bodies, seed: int = 0
) -> Float[np.ndarray, "C 3"]:
    """Make a pattern's first colours: grey, seeded random ones, the first outfit's, an animal's face, or a print."""
    logo = pattern.cover
    if settings.initial in PRINTS:
        plain = PRINTS[settings.initial]
        if not pattern.period:
            return pattern.from_faces(plain.at(face_places(bodies, logo).at.T.double().numpy()))
        # What repeats shows as many whole pieces as come closest to their own size.
        pieces = max(1, round(pattern.period / PRINT_METRES))
        return plain.at(pattern.centres / pattern.period * pieces * PRINT_METRES)
    if settings.initial == "clothing":
        colors = bodies.face_colors[0, logo.face_ids]
    elif settings.initial == "animal":
        colors = animal_face(bodies, logo)
    elif settings.initial == "random":
        colors = torch.rand((len(logo), 3), generator=torch.Generator().manual_seed(seed)).numpy()
    else:
        colors = np.full((len(logo), 3), 0.5, np.float32)
    return pattern.from_faces(colors)


def animal_face(bodies: Bodies, logo: Logo) -> Float32[np.ndarray, "L 3"]:
    """Draw a dog's face on front and back, on grey: light fur, a brown coat, two eyes, nose and mouth.

    Each is as high as 0.38 of the body in its first pose, or as the logo has room along the middle, and begins where
    that does. Trainings for detectors of many classes that end well have drawn such a face by themselves.
    """
    centres, facing = face_centres(bodies)[logo.face_ids], face_normals(bodies)[logo.face_ids, 2]
    points = bodies.vertices[0]
    tall = float(np.ptp(points[:, 1]))
    colors = np.full((len(logo), 3), 0.5, np.float32)
    for side in (facing > 0, facing < 0):
        room = _room(centres[side], tall)
        if room is None:
            continue
        middle, top, height = room
        size = min(TALL * tall, height)
        _draw(colors, (centres[:, 0] - middle) / size, (top - centres[:, 1]) / size, side)
    return colors


def _room(centres: Float[np.ndarray, "faces 3"], tall: float) -> tuple[float, float, float] | None:
    """Find the longest strip without a gap along the middle of one side's faces: middle, top, height; metres."""
    middle = float(np.median(centres[:, 0])) if len(centres) else 0.0
    column = np.sort(centres[abs(centres[:, 0] - middle) <= COLUMN * tall, 1])
    if not len(column):
        return None
    strips = np.split(column, np.flatnonzero(np.diff(column) > GAP * tall) + 1)
    longest = max(strips, key=np.ptp)
    height = float(np.ptp(longest))
    return (middle, float(longest[-1]), height) if height > 0 else None


def _draw(
    colors: Float32[np.ndarray, "L 3"],
    across: Float[np.ndarray, " L"],
    down: Float[np.ndarray, " L"],
    side: Bool[np.ndarray, " L"],
) -> None:
    """Draw the face onto the faces of one side, in place."""
    inside = side & (abs(across) < HALF_WIDTH) & (down >= 0) & (down < 1)
    colors[inside] = FUR
    colors[inside & ((down < FOREHEAD) | ((abs(across) > CHEEKS) & (down < CHEEKS_END)))] = COAT
    for x, y, half_width, half_height, color in BLOBS:
        colors[inside & (((across - x) / half_width) ** 2 + ((down - y) / half_height) ** 2 < 1)] = color
