"""One person in a photograph who can be dressed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, UInt8

from cloak_core.files.identity import sha256_arrays
from cloak_core.sources.photographs.choosing import Box
from cloak_core.sources.photographs.crops import Crop
from cloak_core.sources.photographs.landmarks import Landmarks


@dataclass(frozen=True, eq=False)
class Person:
    """One person who can be dressed: a crop of a photograph with her mask, box and landmarks in its pixels."""

    photograph: str
    """File name."""
    number: int
    """The annotation's id."""
    crop: Crop
    box: Box
    """x0, y0, x1, y1 in pixels of the crop."""
    landmarks: Landmarks
    others: tuple[Box, ...] = ()
    """Boxes of the other annotated people."""
    licence: str = ""
    pixels: str = ""
    """SHA-256 (hex) of the whole photograph: decoded, upright, at full size."""
    look: str = ""
    """Of the whole photograph, see `files.likeness.picture_look`."""

    @property
    def image(self) -> UInt8[np.ndarray, "h w 3"]:
        """The crop's pixels, decoded when they are asked for."""
        return self.crop.image

    @property
    def mask(self) -> Bool[np.ndarray, "h w"]:
        """True where the crop shows her."""
        return self.crop.mask

    @property
    def shape(self) -> tuple[int, int]:
        """The crop's height and width."""
        return self.crop.shape

    @property
    def name(self) -> str:
        """PHOTOGRAPH#ID."""
        return f"{self.photograph}#{self.number}"

    @cached_property
    def identity(self) -> str:
        """SHA-256 (hex) of all that decides how she is dressed and judged, whatever her photograph is called.

        The crop's pixels, mask, her box and the others', and the landmarks with visibility and depth (world coordinates
        reach a fit as depth alone).
        """
        landmarks = self.landmarks
        depth = np.zeros(0) if landmarks.depth is None else landmarks.depth
        boxes = np.array([self.box, *self.others], np.float64)
        return sha256_arrays(self.image, self.mask, boxes, landmarks.xy, landmarks.visibility, depth)

    def in_crop(self, crop: Crop) -> Person:
        """The person with other pixels or another mask."""
        return replace(self, crop=crop)

    def called(self, photograph: str) -> Person:
        """The person in a photograph of another name."""
        return self.known_as(self.identity, photograph=photograph)

    def known_as(self, identity: str, **changes: str) -> Person:
        """The person with other words about her photograph; her identity is known and needs no pixel."""
        changed = replace(self, **changes)
        changed.__dict__["identity"] = identity
        return changed
