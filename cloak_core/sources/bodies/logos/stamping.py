"""Stamping a text or a picture on the front of a body: which faces the ink covers.

The stamp is laid on in parallel along -z, as seen from the front (+z, y up), in the first pose. A face takes ink when
its centre is seen from there, nothing of the body before it, and lies on ink; so nothing goes through to the back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int64

from cloak_core.core.geometry import face_centres, face_normals
from cloak_core.core.logo import area_share
from cloak_core.core.pictures import read_picture
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError

# Of the body's height: where a stamp's centre sits and how large it is at most, between collar and waistband.
CENTRE_HEIGHT, STAMP_HEIGHT, STAMP_WIDTH = 0.705, 0.23, 0.19
MAX_TEXT = 32
INK_HEIGHT = 512


@dataclass(frozen=True, eq=False)
class Stamp:
    """A picture of ink (True) [H, W], row 0 at the top, laid on the body: its centre (x, y) and size in metres."""

    ink: np.ndarray
    center: tuple[float, float]
    height: float

    @property
    def width(self) -> float:
        return self.height * self.ink.shape[1] / self.ink.shape[0]


def project_text(
    bodies: Bodies, text: str, height: float | None = None, center: tuple[float, float] | None = None
) -> Int64[np.ndarray, " logo"]:
    """Select the faces under a line of text in bold sans serif, readable from the front.

    height: of the inked letters, metres; center: (x, y), metres. By default the text fits between collar and waistband,
    centred on the trunk. Raises `InputError` for text without ink or of more than 32 characters, and where no face's
    centre falls on ink.
    """
    if len(text) > MAX_TEXT:
        raise InputError(f"text '{text[:MAX_TEXT]}...': at most {MAX_TEXT} characters can be stamped")
    ink = draw_text(text)
    if not ink.any():
        raise InputError(f"text '{text}': nothing to draw")
    return covered_faces(bodies, front_stamp(bodies, cropped(ink), height, center), f"text '{text}'")


def project_mask(
    bodies: Bodies, mask: str | Path, height: float | None = None, center: tuple[float, float] | None = None
) -> Int64[np.ndarray, " logo"]:
    """Select the faces under a picture's ink; height and center as for `project_text`, of the inked part.

    Of a picture with transparency the opaque pixels are ink, whatever their colour; of any other, the dark ones (luma
    below one half). Raises `InputError` for a file that is no picture, that has no ink, or whose ink falls on no face.
    """
    ink = read_ink(Path(mask))
    if not ink.any():
        raise InputError(f"{mask}: no ink in it (opaque pixels of a transparent picture, dark pixels of any other)")
    return covered_faces(bodies, front_stamp(bodies, cropped(ink), height, center), str(mask))


def draw_text(text: str) -> Bool[np.ndarray, "height width"]:
    """Draw a line of text as ink, in the bold font that comes with matplotlib."""
    import matplotlib
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans-Bold.ttf", INK_HEIGHT)
    line = " ".join(text.split())
    left, top, right, bottom = font.getbbox(line)
    picture = Image.new("L", (max(int(right - left), 1) + 2, max(int(bottom - top), 1) + 2))
    ImageDraw.Draw(picture).text((1 - left, 1 - top), line, fill=255, font=font)
    return np.asarray(picture) >= 128


def read_ink(path: Path) -> Bool[np.ndarray, "height width"]:
    rgba = read_picture(path, "RGBA")
    opaque = rgba[..., 3] >= 128
    if not opaque.all():
        return opaque
    return rgba[..., :3] @ np.array([0.299, 0.587, 0.114]) < 127.5


def cropped(ink: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "h w"]:
    rows, columns = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0))
    return ink[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def front_stamp(
    bodies: Bodies, ink: Bool[np.ndarray, "h w"], height: float | None, center: tuple[float, float] | None
) -> Stamp:
    """Place a stamp: as told, else on the trunk, as large as fits it."""
    low, high = bodies.vertices[0].min(axis=0), bodies.vertices[0].max(axis=0)
    tall = float(high[1] - low[1])
    if height is None:
        height = tall * min(STAMP_HEIGHT, STAMP_WIDTH * ink.shape[0] / ink.shape[1])
    if not 0 < height < np.inf:
        raise InputError(f"stamp height {height}: a positive number of metres is needed")
    if center is None:
        chest = bodies.regions.get("chest")
        middle = (low[0] + high[0]) / 2 if chest is None else np.median(face_centres(bodies)[chest, 0])
        center = (float(middle), float(low[1] + CENTRE_HEIGHT * tall))
    if not np.isfinite(center).all():
        raise InputError(f"stamp centre {center}: two numbers are needed")
    return Stamp(ink, (float(center[0]), float(center[1])), float(height))


def covered_faces(bodies: Bodies, stamp: Stamp, what: str) -> Int64[np.ndarray, " logo"]:
    """Select the faces whose centre is seen from the front and lies on ink."""
    centres = face_centres(bodies)
    rows, columns = stamp.ink.shape
    u = np.floor(((centres[:, 0] - stamp.center[0]) / stamp.width + 0.5) * columns).astype(np.int64)
    v = np.floor((0.5 - (centres[:, 1] - stamp.center[1]) / stamp.height) * rows).astype(np.int64)
    inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
    on_ink = inside & stamp.ink[np.where(inside, v, 0), np.where(inside, u, 0)]
    ids = np.flatnonzero(on_ink & (face_normals(bodies)[:, 2] > 0)).astype(np.int64)
    ids = ids[seen_from_front(bodies, ids, centres[ids])]
    if not len(ids):
        raise InputError(
            f"{what}: no face's centre lies under its ink,"
            f" {stamp.width:.3g} x {stamp.height:.3g} m at x {stamp.center[0]:.3g}, y {stamp.center[1]:.3g}"
        )
    return ids


def seen_from_front(
    bodies: Bodies, ids: Int64[np.ndarray, " logo"], centres: Float[np.ndarray, "logo 3"]
) -> Bool[np.ndarray, " logo"]:
    """Tell which faces' centres have no triangle of another face in front of them (towards +z), first pose."""
    corners = bodies.vertices[0][bodies.triangles].astype(np.float64)
    low, high = corners.min(axis=1), corners.max(axis=1)
    if not len(ids):
        return np.zeros(0, bool)
    # Only triangles under the stamp can hide anything.
    near = ((high[:, :2] >= centres[:, :2].min(axis=0)) & (low[:, :2] <= centres[:, :2].max(axis=0))).all(axis=1)
    near &= high[:, 2] > centres[:, 2].min()
    corners, face = corners[near], bodies.triangle_face[near].astype(np.int64)
    seen = np.ones(len(ids), bool)
    for start in range(0, len(ids), 256):
        part = slice(start, start + 256)
        hidden = in_front(centres[part], corners) & (ids[part, None] != face)
        seen[part] = ~hidden.any(axis=1)
    return seen


def in_front(points: Float[np.ndarray, "n 3"], triangles: Float[np.ndarray, "m 3 3"]) -> Bool[np.ndarray, "n m"]:
    """Tell whether a triangle covers a point in the xy plane and lies nearer to +z there."""
    a, b, c = (triangles[:, corner] for corner in range(3))
    x, y = points[:, None, 0], points[:, None, 1]
    side = lambda p, q: (q[:, 0] - p[:, 0]) * (y - p[:, 1]) - (q[:, 1] - p[:, 1]) * (x - p[:, 0])
    wa, wb, wc = side(b, c), side(c, a), side(a, b)
    area = wa + wb + wc
    covers = ((wa >= 0) & (wb >= 0) & (wc >= 0)) | ((wa <= 0) & (wb <= 0) & (wc <= 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (wa * a[:, 2] + wb * b[:, 2] + wc * c[:, 2]) / area
    return covers & (area != 0) & (depth > points[:, None, 2])


def sized_stamp(
    make: Callable[..., Int64[np.ndarray, " logo"]], bodies: Bodies, share: float
) -> Int64[np.ndarray, " logo"]:
    """Stamp at the height that covers about this share (0 to 1) of the body's area, found by bisection up to 1 m.

    make: `project_text` or `project_mask` but for the height, metres. InputError: no such stamp fits.
    """
    low, high = 0.0, 1.0
    best, distance = None, np.inf
    for _ in range(14):
        height = (low + high) / 2
        try:
            ids = make(height=height)
            found = area_share(bodies, ids)
        except InputError:  # too small to cover the centre of any face
            ids, found = None, 0.0
        if ids is not None and abs(found - share) < distance:
            best, distance = ids, abs(found - share)
        low, high = (height, high) if found < share else (low, height)
    if best is None:
        raise InputError(f"scene '{bodies.name}': no stamp of {share:.1%} of its area fits on the chest")
    return best
