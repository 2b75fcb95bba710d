"""Stamping a text or a picture on the front of a body: which faces the ink covers.

The stamp is laid on in parallel along -z, as seen from the front (+z, y up), in the first pose. A face takes ink when
its centre is seen from there, nothing of the body before it, and lies on ink; so nothing goes through to the back.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
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


def project_text(
    bodies: Bodies, text: str, height: float | None = None, center: tuple[float, float] | None = None
) -> Int64[np.ndarray, " logo"]:
    """Select the faces under a line of text in bold sans serif, readable from the front.

    height: of the inked letters, metres; center: (x, y), metres. By default the text fits between collar and waistband,
    centred on the trunk. Raises `InputError` for text without ink or of more than 32 characters, and where no face's
    centre falls on ink.
    """
    import matplotlib
    from PIL import Image, ImageDraw, ImageFont

    if len(text) > MAX_TEXT:
        raise InputError(f"text '{text[:MAX_TEXT]}...': at most {MAX_TEXT} characters can be stamped")
    # The bold font that comes with matplotlib.
    font = ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans-Bold.ttf", INK_HEIGHT)
    line = " ".join(text.split())
    left, top, right, bottom = font.getbbox(line)
    picture = Image.new("L", (max(int(right - left), 1) + 2, max(int(bottom - top), 1) + 2))
    ImageDraw.Draw(picture).text((1 - left, 1 - top), line, fill=255, font=font)
    ink = np.asarray(picture) >= 128
    if not ink.any():
        raise InputError(f"text '{text}': nothing to draw")
    return covered_faces(bodies, ink, height, center, f"text '{text}'")


def project_mask(
    bodies: Bodies, mask: str | Path, height: float | None = None, center: tuple[float, float] | None = None
) -> Int64[np.ndarray, " logo"]:
    """Select the faces under a picture's ink; height and center as for `project_text`, of the inked part.

    Of a picture with transparency the opaque pixels are ink, whatever their colour; of any other, the dark ones (luma
    below one half). Raises `InputError` for a file that is no picture, that has no ink, or whose ink falls on no face.
    """
    rgba = read_picture(Path(mask), "RGBA")
    ink = rgba[..., 3] >= 128
    if ink.all():
        ink = rgba[..., :3] @ np.array([0.299, 0.587, 0.114]) < 127.5
    if not ink.any():
        raise InputError(f"{mask}: no ink in it (opaque pixels of a transparent picture, dark pixels of any other)")
    return covered_faces(bodies, ink, height, center, str(mask))


def covered_faces(
    bodies: Bodies,
    ink: Bool[np.ndarray, "h w"],
    height: float | None,
    center: tuple[float, float] | None,
    what: str,
) -> Int64[np.ndarray, " logo"]:
    """Select the faces whose centre is seen from the front and lies on ink.

    ink: row 0 at the top; what lies around it is cut off. height, center: as told, else on the trunk, as large as fits.
    """
    rows, columns = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0))
    ink = ink[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    rows, columns = ink.shape
    centres = face_centres(bodies)
    low, high = bodies.vertices[0].min(axis=0), bodies.vertices[0].max(axis=0)
    tall = float(high[1] - low[1])
    height = tall * min(STAMP_HEIGHT, STAMP_WIDTH * rows / columns) if height is None else height
    if not 0 < height < np.inf:
        raise InputError(f"stamp height {height}: a positive number of metres is needed")
    if center is None:
        chest = bodies.regions.get("chest")
        middle = (low[0] + high[0]) / 2 if chest is None else np.median(centres[chest, 0])
        center = (float(middle), float(low[1] + CENTRE_HEIGHT * tall))
    if not np.isfinite(center).all():
        raise InputError(f"stamp centre {center}: two numbers are needed")
    height, (x, y) = float(height), map(float, center)
    width = height * columns / rows
    u = np.floor(((centres[:, 0] - x) / width + 0.5) * columns).astype(np.int64)
    v = np.floor((0.5 - (centres[:, 1] - y) / height) * rows).astype(np.int64)
    inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
    on_ink = inside & ink[np.where(inside, v, 0), np.where(inside, u, 0)]
    ids = np.flatnonzero(on_ink & (face_normals(bodies)[:, 2] > 0)).astype(np.int64)
    ids = ids[seen_from_front(bodies, ids, centres[ids])]
    if not len(ids):
        where = f"{width:.3g} x {height:.3g} m at x {x:.3g}, y {y:.3g}"
        raise InputError(f"{what}: no face's centre lies under its ink, {where}")
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
    corners = corners[near]
    face = bodies.triangle_face[near].astype(np.int64)
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

    def side(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Compute the edge function of p to q: twice the area of the triangle with each point."""
        return (q[:, 0] - p[:, 0]) * (y - p[:, 1]) - (q[:, 1] - p[:, 1]) * (x - p[:, 0])

    wa, wb, wc = side(b, c), side(c, a), side(a, b)
    area = wa + wb + wc
    covers = ((wa >= 0) & (wb >= 0) & (wc >= 0)) | ((wa <= 0) & (wb <= 0) & (wc <= 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (wa * a[:, 2] + wb * b[:, 2] + wc * c[:, 2]) / area
    return covers & (area != 0) & (depth > points[:, None, 2])


def sized_stamp(
    make: Callable[..., Int64[np.ndarray, " logo"]], bodies: Bodies, target: float
) -> Int64[np.ndarray, " logo"]:
    """Stamp at the height that covers about `target` (0 to 1) of the body's area, found by bisection up to 1 m.

    make: `project_text` or `project_mask` but for the height, metres. InputError: no such stamp fits.
    """
    low, high = 0.0, 1.0
    sizes = []
    for _ in range(14):
        height = (low + high) / 2
        reached = 0.0
        with contextlib.suppress(InputError):  # too small to cover the centre of any face
            ids = make(height=height)
            reached = area_share(bodies, ids)
            sizes.append((abs(reached - target), ids))
        low, high = (height, high) if reached < target else (low, height)
    if not sizes:
        raise InputError(f"scene '{bodies.name}': no stamp of {target:.1%} of its area fits on the chest")
    return min(sizes, key=lambda pair: pair[0])[1]
