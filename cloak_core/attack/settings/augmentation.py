"""Settings of `attack.batches` and `attack.distorting`: what happens to the logo and to the images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cloak_core.attack.settings.values import Bounds, Range


@dataclass(frozen=True, kw_only=True)
class AugmentationSettings:
    """What makes every image another one."""

    translation: Annotated[int, Bounds(0, 4096)] = 50
    """The body is moved by up to this many pixels along both axes."""
    translation_per: Literal["image", "batch"] = "image"
    """What has a translation of its own."""
    contrast: Annotated[Range, Bounds(ends="[)")] = Range(0.0, 1.0)
    """LOW:HIGH of the factor on the colours; "1" switches it off."""
    brightness: Range = Range(0.0, 1.0)
    """LOW:HIGH of what is added to the colours; "0" switches it off."""
    noise: Annotated[float, Bounds(0, 1)] = 0.1
    """Amplitude of the uniform noise on the colours."""
    photometric_on: Literal["logo", "render"] = "logo"
    """Contrast, brightness and noise act on the logo (per face) or on the render (per pixel of the body)."""
    occluders: Annotated[int, Bounds(0, 16)] = 0
    """Up to so many rectangles, cut from other backgrounds, stand before each body."""
    zoom: Annotated[Range, Bounds(0.25, 4)] = Range(1.0, 1.0)
    """LOW:HIGH of the factor by which the finished image is enlarged about its centre; "1" switches it off."""
    blur: Annotated[float, Bounds(0, 2)] = 0.0
    """The finished image is blurred by a Gaussian of up to this standard deviation, pixels; 0 switches it off."""
    jpeg: Annotated[Range | None, Bounds(1, 100)] = None
    """LOW:HIGH of the JPEG quality (1..100) that the finished image goes through; None switches it off."""
    cutout: Annotated[float, Bounds(0, 1)] = 0.0
    """In each image up to this share of the logo's faces, all about one of them, is grey, so that no colour hangs on
    another one's; 0 switches it off."""
    crop: Annotated[float, Bounds(0, 0.9)] = 0.0
    """Up to this share of the finished image's width and height is cut away, anywhere, and the rest enlarged."""
    pad: Annotated[float, Bounds(0, 0.9)] = 0.0
    """Up to this share of the width and height becomes grey margin, anywhere, around the image made smaller. With
    --crop, too, each image gets one or the other."""
    tint: Annotated[float, Bounds(0, 0.9)] = 0.0
    """The finished image's red, green, blue and saturation are each multiplied by up to 1 ± this."""
    background_mix: Annotated[float, Bounds(0, 1)] = 0.0
    """Up to this share of another background is mixed into the one behind the body."""
    wrinkles: Annotated[float, Bounds(0, 0.1)] = 0.0
    """The cloth under the logo lies in random smooth folds of this many metres, each pose of the scene in several of
    them; 0 leaves it as the scene has it."""
    wrinkle_draws: Annotated[int, Bounds(1, 64)] = 4
    """With --wrinkles: how many folds each pose is seen in."""
