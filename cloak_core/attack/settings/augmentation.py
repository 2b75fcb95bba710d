"""Settings of `attack.batches` and `attack.distorting`: what happens to the logo and to the images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cloak_core.attack.settings.values import Bounds, Range


@dataclass(frozen=True, kw_only=True)
class AugmentationSettings:
    """What makes every image another one."""

    translation: Annotated[int, Bounds(0, 4096)] = 50
    """Move the body by up to this many pixels along both axes."""
    translation_per: Literal["image", "batch"] = "image"
    """Draw the translation for each image, or once for the batch."""
    contrast: Annotated[Range, Bounds(ends="[)")] = Range(0.0, 1.0)
    """Range of the factor on the colours; 1 switches it off."""
    brightness: Range = Range(0.0, 1.0)
    """Range of what is added to the colours; 0 switches it off."""
    noise: Annotated[float, Bounds(0, 1)] = 0.1
    """Amplitude of uniform noise on the colours."""
    photometric_on: Literal["logo", "render"] = "logo"
    """Apply contrast, brightness and noise to the logo (per face), or to the render (per pixel of the body)."""
    occluders: Annotated[int, Bounds(0, 16)] = 0
    """Put at most this many rectangles, cut from other backgrounds, before each body."""
    zoom: Annotated[Range, Bounds(0.25, 4)] = Range(1.0, 1.0)
    """Range of the factor by which the finished image is enlarged about its centre; 1 switches it off."""
    blur: Annotated[float, Bounds(0, 2)] = 0.0
    """Blur the finished image by a Gaussian of at most this standard deviation, pixels; 0 switches it off."""
    jpeg: Annotated[Range | None, Bounds(1, 100)] = None
    """Range of the JPEG quality, 1 to 100, of the finished image; None switches it off."""
    cutout: Annotated[float, Bounds(0, 1)] = 0.0
    """Paint up to this share of the logo's faces grey in each image, around one face, so that no colour depends on the
    others; 0 switches it off."""
    crop: Annotated[float, Bounds(0, 0.9)] = 0.0
    """Cut away up to this share of the finished image's width and height, and enlarge the rest."""
    pad: Annotated[float, Bounds(0, 0.9)] = 0.0
    """Shrink the finished image into a grey margin of up to this share of the width and height. With --crop, too, each
    image gets one of the two."""
    tint: Annotated[float, Bounds(0, 0.9)] = 0.0
    """Multiply the finished image's red, green, blue and saturation each by up to 1 ± this."""
    background_mix: Annotated[float, Bounds(0, 1)] = 0.0
    """Mix up to this share of another background into the one behind the body."""
    wrinkles: Annotated[float, Bounds(0, 0.1)] = 0.0
    """Lay the cloth under the logo in random smooth folds of this depth, metres; 0 leaves the scene's shape."""
    wrinkle_draws: Annotated[int, Bounds(1, 64)] = 4
    """With --wrinkles: number of random folds in which each pose is seen."""
