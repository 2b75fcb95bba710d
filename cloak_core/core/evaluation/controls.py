"""Make the colours that a logo is compared with, for the same faces in the same images.

A high success means little when any odd patch would have done as well. So beside the trained colours stand the body's
own clothing, plain grey, random colours, and two natural patterns (stripes and checks) as strong as the trained one.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from cloak_core.core.geometry import face_centres
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError

LOGO = "logo"
CLOTHING = "clothing"
STANDARD = (CLOTHING, "grey", "random")
"""The controls of every evaluation."""
NATURAL = ("stripes", "checks")
"""Patterns clothes really have; asked for by the experiments."""
STRIPE = 0.05
"""Width of a stripe or check, metres."""


def control_colors(
    control: str, trained: Float[np.ndarray, "L 3"], bodies: Bodies, face_ids: Int[np.ndarray, " L"]
) -> Float[np.ndarray, "K L 3"]:
    """Compute the logo's colours under a control that is the same in every image: one set per outfit (K).

    "random" differs from image to image: see `random_colors`. InputError for names that are no control.
    """
    if control == CLOTHING:
        return bodies.face_colors[:, face_ids]
    if control == LOGO:
        colors = trained
    elif control == "grey":
        colors = np.full_like(trained, 0.5)
    elif control in NATURAL:
        colors = _two_tone(trained, _pattern(control, face_centres(bodies)[face_ids]))
    else:
        raise InputError(f"control {control!r}: not one of {', '.join((*STANDARD, *NATURAL))}")
    return np.broadcast_to(np.asarray(colors, np.float32), (bodies.outfit_count, *trained.shape))


def random_colors(seed: int, image: int, count: int) -> Float[np.ndarray, "L 3"]:
    """Draw uniform random colours of one image, from the seed and the image's number alone."""
    return np.random.default_rng([seed, image]).random((count, 3), np.float32)


def _pattern(control: str, centers: Float[np.ndarray, "L 3"]) -> np.ndarray:
    """Tell which of two colours each face has, bool [L]: stripes run around the body, checks cross them in x and y."""
    cell = np.floor(centers / STRIPE).astype(np.int64)
    return (cell[:, 1] if control == "stripes" else cell[:, 0] + cell[:, 1]) % 2 == 0


def _two_tone(trained: Float[np.ndarray, "L 3"], light: np.ndarray) -> Float[np.ndarray, "L 3"]:
    """Make two greys about mid-grey with the trained colours' standard deviation of luminance."""
    contrast = min(0.5, float((trained @ np.array([0.2126, 0.7152, 0.0722], np.float32)).std()))
    return np.where(light[:, None], 0.5 + contrast, 0.5 - contrast).astype(np.float32).repeat(3, 1)
