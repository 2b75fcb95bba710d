"""A body's faces laid onto a person in a photograph.

The rig is posed to her landmarks, widened until each limb fills its part of her mask, rasterized, and drawn into the
mask; where the mask reaches beyond the body, the nearest of its pixels lends its faces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Float32, Int64
from scipy.ndimage import distance_transform_edt

from cloak_core.core.cameras import Camera, Number
from cloak_core.core.view import View
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.cloth import cloth_coordinates
from cloak_core.files.identity import sha256_arrays, sha256_record
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.sources.photographs.annotation import INDEX, Landmarks
from cloak_core.sources.photographs.person import Person
from cloak_core.sources.photographs.posing import LIMBS, Posed, pose_to
from cloak_core.sources.photographs.rig import NUMBER, SEGMENTS, Rig, body_rig
from cloak_core.sources.photographs.shading import around, exposure_and_cast, shading

ROUNDS = 3
"""Of widening; each takes one rasterization."""
WIDTHS = (0.75, 1.7)
"""How much narrower or wider than the rig's a segment may become."""
WIDENED = (("pelvis",), ("chest",), *((f"l_{p}", f"r_{p}") for p in ("arm", "forearm", "thigh", "shin")))
"""Segments that become as wide as the mask says; left and right alike."""
LEAST_SEEN = 20
"""Pixels of a segment, and of its twin, below which the mask says nothing of its width."""
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
    lender: Int64[np.ndarray, " P"]
    """The pixel of the posed body that each takes its triangles from: itself, or the nearest where the mask reaches
    beyond the body."""
    crow: Int64[np.ndarray, " P1"]
    """P + 1 row offsets."""
    triangle: Int64[np.ndarray, " E"]
    share: Float[np.ndarray, " E"]
    """Of the pixel; those of a pixel add up to 1."""
    main: Int64[np.ndarray, " P"]
    """The triangle that is seen most."""
    shading: Float[np.ndarray, " P"]
    tint: Float[np.ndarray, " 3"]
    """What the photograph's exposure and colour cast multiply colours by."""
    posed: Posed
    quality: dict[str, float]
    """landmark_px, landmark_heights: root mean square distance of the fitted joints from the seen landmarks; covered:
    share of the mask that the body covers by itself; spilled: share of the body outside the mask."""

    @property
    def scale(self) -> Number:
        """Pixels per metre of the body at rest."""
        return self.posed.scale

    @cached_property
    def rest(self) -> Float[np.ndarray, "P 3"]:
        """The point of the body at rest that each pixel shows, metres; beyond the body, moved on as the pixel is."""
        rig, width = body_rig(), self.person.shape[1]
        x, y = self.lender % width + 0.5, -(self.lender // width + 0.5)
        corners = self.posed.vertices(rig)[rig.triangles[self.main]]
        (ax, ay), (bx, by), (cx, cy) = (corners[:, k, :2].T for k in range(3))
        # Barycentric coordinates of the pixel in its triangle, by areas; projection is affine: they hold at rest, too.
        twice = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        safe = np.where(np.abs(twice) < 1e-9, 1e-9, twice)
        b = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) / safe
        c = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) / safe
        # The main triangle need not hold the pixel's centre: its nearest corner or edge stands in.
        weights = np.clip(np.stack([1 - b - c, b, c], axis=1), 0, 1)
        weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
        rest = np.einsum("pk,pkd->pd", weights, rig.vertices[rig.triangles[self.main]])
        right, down = self.pixels % width - self.lender % width, self.pixels // width - self.lender // width
        # Towards the viewer's right is the body's left from the front, its right from behind.
        facing = np.sign(self.posed.transforms[SEGMENTS.index("chest"), 2, 2]) or 1.0
        rest[:, 0] += right / self.posed.scale * facing
        rest[:, 1] -= down / self.posed.scale
        return rest

    @cached_property
    def on_cloth(self) -> Float32[np.ndarray, "2 P"]:
        """Where each pixel lies on a cloth that the clothes are cut of: metres right and down."""
        places = cloth_coordinates(self.rest, body_rig().normals[self.main])
        return np.ascontiguousarray(places.T, np.float32)

    @cached_property
    def identity(self) -> str:
        """SHA-256 (hex) of the person and of all that is laid onto her."""
        own = (self.pixels, self.crow, self.triangle, self.share, self.shading, self.tint)
        return sha256_record([self.person.identity, sha256_arrays(*own)])


def fit_all(people: Sequence[Person]) -> list[Fit]:
    """Fit people together, as poses of one scene: what depends on the mesh alone is done once for all of them."""
    rig = body_rig()
    masks = [person.mask for person in people]
    widths: list[dict[str, float]] = [{} for _ in people]
    for round_ in range(ROUNDS + 1):
        posed = [pose_to(person.landmarks, rig, own) for person, own in zip(people, widths, strict=True)]
        if round_ == ROUNDS:
            break
        # How wide a limb is drawn changes which part of the mask is nearest to it, so widths are found in rounds.
        seen = _views(posed, masks, rig, samples=1)
        widths = [
            _widened(own, _faces(view, mask.shape), mask, person.box[3] - person.box[1], rig)
            for own, view, mask, person in zip(widths, seen, masks, people, strict=True)
        ]
    seen = _views(posed, masks, rig, samples=None)
    return [_drawn(*parts, rig) for parts in zip(people, masks, posed, seen, strict=True)]


def _views(posed: Sequence[Posed], masks: Sequence[np.ndarray], rig: Rig, samples: int | None) -> list[View]:
    """See each posed body through a far camera that shows its person's crop."""
    cameras, bodies = [], []
    for pose, mask in zip(posed, masks, strict=True):
        height, width = mask.shape
        vertices, distance = pose.vertices(rig), FAR * height
        centre = np.array([width / 2, -height / 2])
        # The pose is orthographic (weak perspective: one scale for the whole person), the rasterizer's camera is not.
        # It divides by distance - z; multiplied by that beforehand, every vertex projects to its own x and y.
        vertices[:, :2] = centre + (vertices[:, :2] - centre) * (1 - vertices[:, 2:] / distance)
        field = float(2 * np.degrees(np.arctan(height / 2 / distance)))
        pivot = (float(centre[0]), float(centre[1]), 0.0)
        cameras.append(Camera(distance, 0.0, 0.0, field, width, height, pivot=pivot))
        bodies.append(vertices.astype(np.float32))
    scene = Bodies(np.stack(bodies), rig.triangles.astype(np.int32))
    view_cache = ViewCache(scene, RenderSettings(samples=samples, light=Light(1.0, 0.0, 0.0)))
    return [view_cache.view(number, camera) for number, camera in enumerate(cameras)]


def _faces(view: View, shape: tuple[int, int]) -> Int64[np.ndarray, "h w"]:
    """The face at each pixel's centre; -1 where there is none."""
    faces = np.full(shape[0] * shape[1], -1)
    faces[view.pixels.numpy()] = view.map.column.numpy()[view.map.crow.numpy()[:-1]]
    return faces.reshape(shape)


def _widened(
    widths: dict[str, float], faces: np.ndarray, mask: Bool[np.ndarray, "h w"], height: Number, rig: Rig
) -> dict[str, float]:
    """Each segment as much wider or narrower as its part of the mask is than it.

    A segment's part of the mask is all that lies nearer to it than to any other (a Voronoi cell of the drawn body): the
    mask alone does not say where an arm ends and the trunk begins.
    """
    window = around(mask, REACH["garment"] * height)
    inside, mask = faces[window], mask[window]
    if not (inside >= 0).any():
        return widths
    segment = rig.segment_of_triangle
    body = np.bincount(segment[faces[faces >= 0]], minlength=len(SEGMENTS))
    away, nearest = distance_transform_edt(inside < 0, return_indices=True)
    near = mask & (away <= REACH["garment"] * height)
    part = np.bincount(segment[inside[tuple(nearest[:, near])]], minlength=len(SEGMENTS))
    wider = dict(widths)
    for pair in WIDENED:
        numbers = [NUMBER[name] for name in pair]
        if body[numbers].sum() < LEAST_SEEN:
            continue
        for name in pair:
            wider[name] = float(np.clip(wider.get(name, 1.0) * part[numbers].sum() / body[numbers].sum(), *WIDTHS))
    return wider


def _drawn(person: Person, mask: Bool[np.ndarray, "h w"], posed: Posed, view: View, rig: Rig) -> Fit:
    """Rasterized by area, cut to the mask, and drawn out to where the mask reaches."""
    height = person.box[3] - person.box[1]
    pixels, coverage = view.pixels.numpy(), view.coverage.numpy()
    crow, triangle, share = view.map.arrays
    share = share.astype(np.float64)
    row = np.full(mask.size, -1)
    row[pixels[coverage > 0.5]] = np.flatnonzero(coverage > 0.5)
    row = row.reshape(mask.shape)
    body = row >= 0
    main = triangle[_largest(crow, share)]
    segment = np.full(row.shape, -1)
    segment[body] = rig.segment_of_triangle[main[row[body]]]
    chosen, source = _drawn_out(row, segment, mask, height)
    counts = np.diff(crow)[source]
    entry = entries_of_rows(crow[source], counts)
    return Fit(
        person,
        chosen,
        pixels[source],
        np.concatenate([[0], np.cumsum(counts)]),
        triangle[entry],
        # A pixel of the mask is hers as a whole: where the body's own edge runs through it, shares are scaled up.
        share[entry] / np.repeat(np.maximum(coverage[source], 1e-6), counts),
        main[source],
        shading(person.image, mask, height).reshape(-1)[chosen],
        exposure_and_cast(person.image),
        posed,
        _landmark_error(posed, rig, person.landmarks, height)
        | {
            "covered": float((body & mask).sum() / mask.sum()),
            "spilled": float((body & ~mask).sum() / max(body.sum(), 1)),
        },
    )


def _drawn_out(
    row: np.ndarray, segment: np.ndarray, mask: Bool[np.ndarray, "h w"], height: Number
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the mask to dress, and for each the row of the view whose faces it shows.

    row, segment: of the body at each pixel, -1 where it is not. Beyond the body, the nearest part within its own reach
    lends: a hand reaches less far than a skirt, so the nearest pixel of all would give cloth to what is held in it.
    """
    window = around(mask, max(REACH.values()) * height)
    whole, row, segment = np.full(row.shape, -1), row[window], segment[window]
    source, best = np.full(row.shape, -1), np.full(row.shape, np.inf)
    for part, reach in REACH.items():
        names = [name for name in SEGMENTS if name.endswith(part)] if part != "garment" else GARMENT
        of_part = np.isin(segment, [NUMBER[name] for name in names])
        if not of_part.any():
            continue
        away, nearest = distance_transform_edt(~of_part, return_indices=True)
        nearer = (away < best) & (away <= reach * height)
        best[nearer], source[nearer] = away[nearer], row[tuple(nearest)][nearer]
    whole[window] = source
    chosen = np.flatnonzero(mask & (whole >= 0))
    return chosen, whole.reshape(-1)[chosen]


def entries_of_rows(start: Int64[np.ndarray, " R"], counts: Int64[np.ndarray, " R"]) -> Int64[np.ndarray, " E"]:
    """List the entries of rows of a sparse matrix, each from `start` on, `counts` of them."""
    return np.repeat(start - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())


def _largest(crow: np.ndarray, share: np.ndarray) -> np.ndarray:
    """The entry with the largest share of each row; rows are not empty."""
    row = np.repeat(np.arange(len(crow) - 1), np.diff(crow))
    largest = np.flatnonzero(share == np.maximum.reduceat(share, crow[:-1])[row])
    position = np.empty(len(crow) - 1, np.int64)
    position[row[largest]] = largest  # the last of equal ones
    return position


def _landmark_error(posed: Posed, rig: Rig, landmarks: Landmarks, height: Number) -> dict[str, float]:
    errors = []
    for side in "lr":
        ends = [(end, limb) for limb, (_, end) in LIMBS.items()] + [("hip", "thigh"), ("shoulder", "arm")]
        for joint, segment in ends:
            number = INDEX[f"{side}_{joint}"]
            if landmarks.visibility[number] >= 0.5:
                x, y, _ = posed.joint(rig, f"{side}_{joint}", f"{side}_{segment}")
                errors.append(((x, -y) - landmarks.xy[number]) ** 2)
    error = float(np.sqrt(np.sum(errors, axis=1).mean())) if errors else 0.0
    return {"landmark_px": error, "landmark_heights": error / height}
