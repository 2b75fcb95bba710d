"""A body's faces laid onto a person in a photograph.

The rig is posed to her landmarks, widened until each limb fills its part of her mask, rasterized, and drawn into the
mask; where the mask reaches beyond the body, the nearest of its pixels lends its faces.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int64
from scipy.ndimage import distance_transform_edt

from cloak_core.core.cameras import Camera, Number
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.identity import sha256_arrays
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.sources.photographs.landmarks import INDEX, Landmarks
from cloak_core.sources.photographs.people import Person
from cloak_core.sources.photographs.posing import Posed, pose_to
from cloak_core.sources.photographs.rig import NUMBER, SEGMENTS, Rig, body_rig
from cloak_core.sources.photographs.shading import exposure_and_cast, shading

ROUNDS = 3
"""Of widening; each takes one rasterization."""
WIDTHS = (0.75, 1.7)
FAR = 40.0
"""Distance of the camera in picture heights; perspective is taken out of the vertices, to within 0.01 px."""
REACH = {"head": 0.12, "hand": 0.02, "foot": 0.03, "garment": 0.12}
"""Heights of the person up to which the mask around the body belongs to a part of it: hair to the head, cloth that
hangs wide to the garment next to it. What lies farther off is not hers to dress (umbrellas, wheels)."""
GARMENT = tuple(name for name in SEGMENTS if not name.endswith(("head", "hand", "foot")))


@dataclass(frozen=True, eq=False)
class Fit:
    """Which of the rig's triangles each pixel of a person shows, and in what light: P pixels, E entries (CSR)."""

    person: Person
    pixels: Int64[np.ndarray, " P"]
    """Flat in the person's crop, ascending; only pixels of her mask."""
    crow: Int64[np.ndarray, " P1"]
    """P + 1 row offsets."""
    triangle: Int64[np.ndarray, " E"]
    share: Float[np.ndarray, " E"]
    """Of the pixel; those of a pixel add up to 1."""
    rest: Float[np.ndarray, "P 3"]
    """The point of the body at rest that is seen there, metres; beyond the body, moved on as the pixel is."""
    main: Int64[np.ndarray, " P"]
    """The triangle that is seen most."""
    shading: Float[np.ndarray, "h w"]
    tint: Float[np.ndarray, " 3"]
    """What the photograph's exposure and colour cast multiply colours by."""
    scale: Number
    """Pixels per metre of the body at rest."""
    quality: dict[str, float]
    """landmark_px, landmark_heights: root mean square distance of the fitted joints from the seen landmarks; covered:
    share of the mask that the body covers by itself; spilled: share of the body outside the mask."""

    @cached_property
    def identity(self) -> str:
        """SHA-256 of the photograph's part and of all that is laid onto it."""
        own = (self.pixels, self.crow, self.triangle, self.share, self.shading, self.tint)
        return sha256_arrays(self.person.image, *own)


class Fitter:
    """Poses the rig's body to people and draws its triangles into their masks."""

    def __init__(self) -> None:
        self.rig = body_rig()
        self._segment = self.rig.segment_of_triangle()

    def fit(self, person: Person, landmarks: Landmarks | None = None, widen: Number = 1.0) -> Fit:
        """Fit one person. landmarks: hers, where they are to be others than the file's; widen: of all widths."""
        landmarks = landmarks or person.landmarks
        widths: dict[str, float] = {}
        for _ in range(ROUNDS):
            posed = pose_to(landmarks, self.rig, widths)
            widths = self._widened(widths, self._faces(posed, person), person)
        posed = pose_to(landmarks, self.rig, {name: width * widen for name, width in widths.items()})
        height = person.box[3] - person.box[1]
        light = shading(person.image, person.mask, height)
        return self._drawn(posed, person, light, _landmark_error(posed, self.rig, landmarks, height))

    def _view_cache(self, posed: Posed, size: tuple[int, int], samples: int | None) -> tuple[ViewCache, Camera]:
        height, width = size
        vertices, distance = posed.vertices(self.rig), FAR * height
        centre = np.array([width / 2, -height / 2])
        vertices[:, :2] = centre + (vertices[:, :2] - centre) * (1 - vertices[:, 2:] / distance)
        field = float(2 * np.degrees(np.arctan(height / 2 / distance)))
        camera = Camera(distance, 0.0, 0.0, field, width, height, pivot=(float(centre[0]), float(centre[1]), 0.0))
        shape = Bodies(vertices[None].astype(np.float32), self.rig.triangles.astype(np.int32))
        return ViewCache(shape, RenderSettings(samples=samples, light=Light(1.0, 0.0, 0.0))), camera

    def _faces(self, posed: Posed, person: Person) -> Int64[np.ndarray, "h w"]:
        """The face at each pixel's centre; -1 where there is none."""
        view_cache, camera = self._view_cache(posed, person.mask.shape, 1)
        view = view_cache.view(0, camera)
        faces = np.full(person.mask.size, -1)
        faces[view.pixels.numpy()] = view.face.numpy()[view.crow.numpy()[:-1]]
        return faces.reshape(person.mask.shape)

    def _widened(self, widths: dict[str, float], faces: np.ndarray, person: Person) -> dict[str, float]:
        """Each segment as much wider or narrower as its part of the mask is than it."""
        if not (faces >= 0).any():
            return widths
        height = person.box[3] - person.box[1]
        away, nearest = distance_transform_edt(faces < 0, return_indices=True)
        label = np.where(away <= REACH["garment"] * height, self._segment[faces[tuple(nearest)]], -1)
        found = dict(widths)
        for pair in (("pelvis",), ("chest",), *((f"l_{p}", f"r_{p}") for p in ("arm", "forearm", "thigh", "shin"))):
            numbers = [NUMBER[name] for name in pair]
            body = np.isin(np.where(faces >= 0, self._segment[faces], -1), numbers).sum()
            mask = (np.isin(label, numbers) & person.mask).sum()
            if body < 20:
                continue
            for name in pair:
                found[name] = float(np.clip(found.get(name, 1.0) * mask / body, *WIDTHS))
        return found

    def _drawn(self, posed: Posed, person: Person, light: np.ndarray, quality: dict[str, float]) -> Fit:
        """Rasterized by area, cut to the mask, and drawn out to where the mask reaches."""
        view_cache, camera = self._view_cache(posed, person.mask.shape, None)
        view = view_cache.view(0, camera)
        pixels, coverage = view.pixels.numpy(), view.coverage.numpy()
        crow, triangle, share = view.crow.numpy(), view.face.numpy(), view.weight.numpy().astype(np.float64)
        row = np.full(person.mask.size, -1)
        row[pixels[coverage > 0.5]] = np.flatnonzero(coverage > 0.5)
        row = row.reshape(person.mask.shape)
        most = _largest(crow, share)
        main = np.where(row >= 0, triangle[most[row]], -1)
        chosen, source = self._drawn_out(row, main, person)
        counts = np.diff(crow)[source]
        entry = np.repeat(crow[source] - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
        # A pixel of the mask is hers as a whole: where the body's own edge runs through it, shares are scaled up.
        shares = share[entry] / np.repeat(np.maximum(coverage[source], 1e-6), counts)
        seen = triangle[most[source]]
        body = row >= 0
        quality["covered"] = float((body & person.mask).sum() / person.mask.sum())
        quality["spilled"] = float((body & ~person.mask).sum() / max(body.sum(), 1))
        return Fit(
            person,
            chosen,
            np.concatenate([[0], np.cumsum(counts)]),
            triangle[entry],
            shares,
            self._at_rest(posed, person.mask.shape[1], chosen, pixels[source], seen),
            seen,
            light,
            exposure_and_cast(person.image),
            posed.scale,
            quality,
        )

    def _at_rest(
        self, posed: Posed, width: int, pixels: np.ndarray, source: np.ndarray, triangle: np.ndarray
    ) -> Float[np.ndarray, "P 3"]:
        """Points of the rest body under the centres of the lending pixels, moved on to the pixels that borrow."""
        x, y = source % width + 0.5, -(source // width + 0.5)
        corners = posed.vertices(self.rig)[self.rig.triangles[triangle]]
        (ax, ay), (bx, by), (cx, cy) = (corners[:, k, :2].T for k in range(3))
        twice = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        safe = np.where(np.abs(twice) < 1e-9, 1e-9, twice)
        b = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) / safe
        c = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) / safe
        weights = np.clip(np.stack([1 - b - c, b, c], axis=1), 0, 1)
        weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
        rest = np.einsum("pk,pkd->pd", weights, self.rig.vertices[self.rig.triangles[triangle]])
        moved = np.stack([pixels % width - source % width, source // width - pixels // width], axis=1) / posed.scale
        # Towards the viewer's right is the body's left from the front, its right from behind.
        facing = np.sign(posed.transforms[1, 2, 2])
        rest[:, 0] += moved[:, 0] * (facing or 1.0)
        rest[:, 1] += moved[:, 1]
        return rest

    def _drawn_out(self, row: np.ndarray, faces: np.ndarray, person: Person) -> tuple[np.ndarray, np.ndarray]:
        """Pixels of the mask to dress, and for each the row of the view whose faces it shows."""
        segment = np.where(faces >= 0, self._segment[faces], -1)
        height, source = person.box[3] - person.box[1], np.full(row.shape, -1)
        best = np.full(row.shape, np.inf)
        for part, reach in REACH.items():
            names = [name for name in SEGMENTS if name.endswith(part)] if part != "garment" else GARMENT
            mine = np.isin(segment, [NUMBER[name] for name in names])
            if not mine.any():
                continue
            away, nearest = distance_transform_edt(~mine, return_indices=True)
            nearer = (away < best) & (away <= reach * height)
            best[nearer], source[nearer] = away[nearer], row[tuple(nearest)][nearer]
        chosen = np.flatnonzero(person.mask & (source >= 0))
        return chosen, source.reshape(-1)[chosen]


def _largest(crow: np.ndarray, share: np.ndarray) -> np.ndarray:
    """The entry with the largest share of each row; rows are not empty."""
    row = np.repeat(np.arange(len(crow) - 1), np.diff(crow))
    return np.lexsort((share, row))[crow[1:] - 1]


def _landmark_error(posed: Posed, rig: Rig, landmarks: Landmarks, height: Number) -> dict[str, float]:
    errors = []
    for side in "lr":
        for joint, segment in (
            ("elbow", "arm"),
            ("wrist", "forearm"),
            ("knee", "thigh"),
            ("ankle", "shin"),
            ("hip", "thigh"),
            ("shoulder", "arm"),
        ):
            number = INDEX[f"{side}_{joint}"]
            if landmarks.visibility[number] >= 0.5:
                x, y, _ = posed.joint(rig, f"{side}_{joint}", f"{side}_{segment}")
                errors.append(((x, -y) - landmarks.xy[number]) ** 2)
    error = float(np.sqrt(np.sum(errors, axis=1).mean())) if errors else 0.0
    return {"landmark_px": error, "landmark_heights": error / height}
