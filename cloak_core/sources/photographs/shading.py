"""What a photograph says of the light on a person's clothes: folds, exposure, colour cast."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.ndimage import gaussian_filter, median_filter

from cloak_core.core.cameras import Number

LIMITS = (0.6, 1.4)
"""Of the shading: darker or brighter is a print on the cloth rather than light."""
SOFTNESS = 0.35
"""Logarithm of luminance from which contrast is compressed: folds keep theirs, prints lose most of it."""
FOLDS = 0.05
"""Sigma of the low frequencies that shading is measured against, in heights of the person."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def shading(
    image: UInt8[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"], height: Number
) -> Float[np.ndarray, "h w"]:
    """The light on each pixel of a person against its surroundings on her: luminance over its low frequencies.

    A median takes out thin lines, and a soft limit the strong edges of prints and stripes; `height` is the person's,
    in pixels. 1 outside the mask; within `LIMITS` inside it.
    """
    luminance = np.log((image @ LUMINANCE + 8) / 263)
    luminance = median_filter(luminance, size=3)
    inside = mask.astype(float)
    sigma = max(FOLDS * height, 2.0)
    low = gaussian_filter(luminance * inside, sigma) / np.maximum(gaussian_filter(inside, sigma), 1e-3)
    contrast = SOFTNESS * np.tanh((luminance - low) / SOFTNESS)
    return np.where(mask, np.clip(np.exp(contrast), *LIMITS), 1.0)


def exposure_and_cast(image: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, " 3"]:
    """Factors for red, green and blue of a colour that is laid into the photograph, at most 1.

    Exposure: white comes out as bright as the photograph's brightest twentieth. Cast: half of what shades of grey
    (Minkowski norm 6, Finlayson and Trezzi 2004) finds, because scenes have colours of their own, too.
    """
    values = image.reshape(-1, 3) / 255.0
    norm = np.maximum((values**6).mean(axis=0) ** (1 / 6), 1e-3)
    cast = np.sqrt(norm / norm.max())
    white = np.percentile(values @ LUMINANCE, 95)
    return np.clip(white / 0.9, 0.55, 1.0) * cast
