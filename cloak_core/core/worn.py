"""What is worn: the faces of a logo, patches of them, or the squares of a cloth that repeats.

An image is paint(view.map @ worn.map, colours, ...): whatever is worn turns places on the clothes into colours, on
bodies (`on_body`) and on people in photographs (`on_places`) alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int64

from cloak_core.core.baking import on_cloth
from cloak_core.core.cloth import Cloth
from cloak_core.core.cloth_on_logo import ClothOnLogo
from cloak_core.core.geometry import face_areas, face_centres
from cloak_core.core.linear import SparseMap
from cloak_core.core.logo import Logo
from cloak_core.core.patches import patch_of_face
from cloak_core.core.settings.components import PatternSettings
from cloak_core.core.view import BakedView
from cloak_core.exchange.bodies import Bodies


@runtime_checkable
class Places(Protocol):
    """P places on somebody's clothes, as a photograph shows them."""

    def faces(self) -> SparseMap:
        """Shares of the logo's faces: places x faces."""
        ...

    def cloth(self) -> tuple[Float[np.ndarray, "P 2"], Bool[np.ndarray, " P"]]:
        """Metres right and down on a cloth that the clothes are cut of, and whether the logo is there."""
        ...


@dataclass(frozen=True, eq=False)
class Worn:
    """N values that may differ, and the C colours that they make: equal but for patches, whose faces share a value."""

    bodies: Bodies
    logo: Logo
    cloth: ClothOnLogo | None = None
    patch: Int64[np.ndarray, " L"] | None = None
    """Of each face; None: values are the faces', or a cloth's."""

    @classmethod
    def of(cls, settings: PatternSettings, bodies: Bodies, logo: Logo) -> Worn:
        """Lay what the settings ask for onto a logo."""
        if settings.pattern == "tile":
            cloth = Cloth.of(settings.tile_cm / 100, settings.feature_cm / 100)
            return cls(bodies, logo, ClothOnLogo.of(cloth, bodies, logo))
        if settings.pattern == "camouflage":
            return cls(bodies, logo, patch=patch_of_face(bodies, logo, settings.feature_cm / 100))
        return cls(bodies, logo)

    def on_body(self, view: BakedView, random: np.random.Generator) -> BakedView:
        """Wear it on a body whose view shows the logo's faces. A cloth lies anywhere: nobody cuts it in one place."""
        if self.cloth is None:
            return view
        return on_cloth(view, self.cloth.cloth, self._away(random))

    def on_places(self, places: Places, random: np.random.Generator) -> SparseMap:
        """Wear it on a person in a photograph: places x colours."""
        if self.cloth is None:
            return places.faces()
        at, is_logo = places.cloth()
        return SparseMap.from_scipy(self.cloth.cloth.shares(at + self._away(random), is_logo))

    def _away(self, random: np.random.Generator) -> tuple[float, float]:
        return tuple(random.uniform(0, self.cloth.cloth.metres, 2).tolist())

    @cached_property
    def color_count(self) -> int:
        """C."""
        return len(self.logo) if self.cloth is None else self.cloth.count

    @cached_property
    def count(self) -> int:
        """N."""
        if self.cloth is not None:
            return self.cloth.count
        return len(self.logo) if self.patch is None else int(self.patch.max()) + 1

    @cached_property
    def edges(self) -> Int64[np.ndarray, "E 2"]:
        """Pairs of values that lie side by side."""
        if self.cloth is not None:
            return self.cloth.cloth.neighbours()
        if self.patch is None:
            return self.logo.edges
        edges = self.patch[self.logo.edges]
        return edges[edges[:, 0] != edges[:, 1]]

    @cached_property
    def points(self) -> Float[np.ndarray, "N D"]:
        """Where the values lie, metres: on the body in the first pose, or on the cloth."""
        if self.patch is None:
            return self.centres
        members = np.bincount(self.patch)
        return np.stack([np.bincount(self.patch, axis) for axis in self.centres.T], axis=1) / members[:, None]

    @cached_property
    def spacing(self) -> float:
        """Metres from a value to the next, in the median."""
        if self.cloth is not None:
            return self.cloth.cloth.metres / self.cloth.cloth.count
        areas = face_areas(self.bodies)[self.logo.face_ids]
        return float(np.sqrt(np.median(areas if self.patch is None else np.bincount(self.patch, areas))))

    @property
    def period(self) -> float | None:
        """Metres after which values repeat; None: they do not."""
        return None if self.cloth is None else self.cloth.cloth.metres

    @cached_property
    def centres(self) -> Float[np.ndarray, "C D"]:
        """Where the colours lie, metres."""
        return face_centres(self.bodies)[self.logo.face_ids] if self.cloth is None else self.cloth.cloth.centres()

    @cached_property
    def bordered(self) -> Logo:
        """The logo with the colours' neighbours in place of its faces', for total variation."""
        return self.logo if self.cloth is None else self.cloth.as_logo(self.logo)

    def colors(self, faces: Float[np.ndarray, "L 3"]) -> Float[np.ndarray, "C 3"]:
        """Turn colours of faces into those of what has colours; faces of a patch may still differ."""
        return faces if self.cloth is None else self.cloth.of_faces(faces)

    def on_faces(self, colors: Float[np.ndarray, "C 3"], is_exact: bool) -> Float[np.ndarray, "L 3"]:
        """Turn colours into those of the logo's faces: of a cloth, the mean of the squares on each face.

        is_exact: colours are restricted, and the mean might not be allowed: the square under the face's centre.
        """
        if self.cloth is None:
            return colors
        return colors[self.cloth.square] if is_exact else self.cloth.on_faces(colors)

    def picture(self, colors: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, "h w 3"] | None:
        """Lay the colours out as the picture that is printed; None where it is not one piece."""
        return None if self.cloth is None else colors.reshape(self.cloth.cloth.rows, self.cloth.cloth.count, 3)

    def shared(self, faces: Float[np.ndarray, "L 3"]) -> Float[np.ndarray, "C 3"]:
        """Turn colours of faces into those of what has colours; faces of a patch get their mean."""
        if self.patch is None:
            return self.colors(faces)
        return self.means(faces)[self.patch].astype(np.float32)

    def means(self, colors: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, "N 3"]:
        """Average colours over those that share a value."""
        if self.patch is None:
            return colors
        total = np.stack([np.bincount(self.patch, channel) for channel in colors.T], axis=1)
        return total / np.bincount(self.patch)[:, None]
