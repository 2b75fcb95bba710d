"""From trained colours to something to print: layout, picture, textured body, sheets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Float32, Integer
from PIL import Image

from cloak_core.core.logo import Cover
from cloak_core.core.pattern import Pattern
from cloak_core.core.pictures import save_picture
from cloak_core.core.polygons import per_corner, polygon_loops
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.profiles import Profile
from cloak_core.files.errors import InputError
from cloak_core.files.writing import new_folder, require_new, write_bytes, write_json, write_text
from cloak_core.patterns.faces import FacePattern
from cloak_core.products.baking import Texture, bake
from cloak_core.products.layout import Layout, lay_out
from cloak_core.products.print_sheets import write_sheets
from cloak_core.products.tiling import PAGES
from cloak_core.sources.bodies.logos.palette import TOLERANCE, nearest_in_palette
from cloak_core.sources.bodies.meshes.mesh_file import to_linear, to_srgb

DPI = (10, 1200)
MOST_ALLOWANCE = 0.05
"""Metres; more does not fit beside a piece on A4."""


def print_logo(
    bodies: Bodies,
    face_ids: Integer[np.ndarray, " logo"],
    colors: Float32[np.ndarray, "logo 3"],
    out: str | Path,
    **options: object,
) -> dict:
    """Print one colour a face, sRGB in [0, 1]. options and what is raised: `print_pattern`."""
    return print_pattern(bodies, FacePattern(Cover(face_ids, bodies.topology), colors=colors), out, **options)


def print_pattern(
    bodies: Bodies,
    pattern: Pattern,
    out: str | Path,
    dpi: int = 150,
    page: str = "A4",
    project: bool = False,
    title: str = "cloak",
    palette: Float[np.ndarray, "P 3"] | None = None,
    profile: Profile | None = None,
    own_pattern: bool = False,
    allowance: float = 0.0,
) -> dict:
    """Write a print folder: cloak.png (the layout, picture of the whole body), body.glb, body.obj + .mtl, sheets.pdf
    and print.json, the report that is also returned.

    pattern: in its colours; project: replace colours that a four-colour printer cannot mix by the nearest that it
    can (they are counted either way); palette: the colours there are, sRGB, instead of a four-colour printer's, and
    `project` then leaves no others; profile: of the printer and a camera (`cloak calibrate`): the sheets, and a picture
    to-print.png, then have the colours to send so that these come out. Those that cannot come out (counted) get the
    nearest that can, and body and cloak.png show what comes out. own_pattern: lay out the pieces of the mesh's own UV
    map (a garment's) instead of cutting charts; allowance: metres of cloth around each piece.

    Sizes are those of the first pose. The folder appears whole or not at all; raises `InputError` where it exists, and
    for options out of range.
    """
    out = Path(out)
    _check(out, dpi, page, allowance)
    near, beyond, sent = _what_comes_out(pattern.colors, palette, profile)
    faces = pattern.cover.face_ids
    layout = lay_out(bodies, faces, own_pattern)
    shown = pattern.recolored(lambda colors: near) if project or profile is not None else pattern
    texture = bake(bodies, layout, shown, dpi)
    sheets = texture if sent is None else bake(bodies, layout, pattern.recolored(lambda colors: sent), dpi)
    with new_folder(out) as folder:
        save_picture(folder / "cloak.png", Image.fromarray(texture.image))
        if sent is not None:
            save_picture(folder / "to-print.png", Image.fromarray(sheets.image))
        write_glb(folder / "body.glb", bodies, texture)
        write_obj(folder / "body.obj", bodies, texture, "cloak.png")
        drawn = write_sheets(folder / "sheets.pdf", bodies, layout, sheets, page, title, allowance)
        report = {"faces": len(faces), "colors": pattern.count, **_figures(layout), "dpi": dpi}
        report["image"] = list(texture.image.shape[1::-1])
        report |= {"page": page, **drawn, "own_pattern": own_pattern, "allowance_m": allowance}
        report |= {"unprintable_colors": int(beyond.sum()), "projected": bool(project or profile is not None)}
        report |= {"profile": profile is not None, "pose": bodies.names[0]}
        write_json(folder / "print.json", report)
    return report | {"out": str(out)}


def write_worn(path: Path, bodies: Bodies, pattern: Pattern, dpi: int) -> None:
    """Write one .glb of the first pose in its first outfit, with a pattern in its colours on it."""
    write_glb(path, bodies, bake(bodies, lay_out(bodies, pattern.cover.face_ids), pattern, dpi))


def _what_comes_out(
    colors: Float32[np.ndarray, "L 3"], palette: Float[np.ndarray, "P 3"] | None, profile: Profile | None
) -> tuple[Float32[np.ndarray, "L 3"], Bool[np.ndarray, " L"], Float32[np.ndarray, "L 3"] | None]:
    """Find the nearest colours that come out, whether they are others, and what to send, where a profile tells."""
    if profile is None:
        near, beyond = nearest_in_palette(colors, printable() if palette is None else palette)
        if palette is None:  # a printer mixes what lies between these, too
            near = np.where(beyond[:, None], near, colors)
        return near.astype(np.float32), beyond, None
    sent = profile.to_send(colors)
    near = profile.photographed(sent)
    return near, np.abs(near - colors).max(axis=1) > TOLERANCE, sent


def _check(out: Path, dpi: int, page: str, allowance: float) -> None:
    require_new(out)
    if page not in PAGES:
        raise InputError(f"page {page}: {', '.join(PAGES)} are known")
    if not DPI[0] <= dpi <= DPI[1]:
        raise InputError(f"{dpi} dpi: between {DPI[0]} and {DPI[1]} is possible")
    if not 0 <= allowance <= MOST_ALLOWANCE:
        raise InputError(f"an allowance of {100 * allowance:g} cm: 0 to {100 * MOST_ALLOWANCE:g} cm are possible")


def _figures(layout: Layout) -> dict[str, object]:
    return {
        "charts": layout.chart_count,
        "stretch_mean": round(layout.stretch_mean, 4),
        "stretch_99": round(layout.stretch_most, 4),
        "sheet_used": round(layout.used, 4),
        "sheet_m": [round(extent, 4) for extent in layout.size],
    }


# Overprints of (cyan, magenta, yellow), each 0 or 1: paper, Y, M, MY, C, CY, CM, CMY, in sRGB bytes.
OVERPRINTS = np.array([
    [255, 255, 255], [255, 237, 0], [230, 0, 126], [227, 6, 19],
    [0, 158, 224], [0, 150, 64], [49, 39, 131], [38, 35, 33],
])  # fmt: skip
STEPS = 33


def printable() -> Float[np.ndarray, "mixtures 3"]:
    """Mix a dense grid of ink amounts, sRGB in [0, 1], by Neugebauer's model.

    Dots of cyan, magenta and yellow fall on each other at random, so a printed colour is a mean, in linear light, of
    the eight solid overprints on paper. A real printer's own profile will differ; this tells what is surely out of
    reach.
    """
    amount = np.linspace(0, 1, STEPS)
    c, m, y = (axis.reshape(-1, 1) for axis in np.meshgrid(amount, amount, amount, indexing="ij"))
    weights = np.concatenate(
        [(c if i & 4 else 1 - c) * (m if i & 2 else 1 - m) * (y if i & 1 else 1 - y) for i in range(8)], axis=1
    )
    return to_srgb(weights @ to_linear(OVERPRINTS / 255))


def write_glb(path: Path, bodies: Bodies, texture: Texture) -> None:
    """Write binary glTF of the first pose with the picture inside; vertices split where texture coordinates do."""
    import trimesh

    rows = np.concatenate([bodies.triangles.reshape(-1, 1).astype(np.float64), texture.uv.reshape(-1, 2)], axis=1)
    unique, index = np.unique(rows, axis=0, return_inverse=True)
    material = trimesh.visual.material.PBRMaterial(
        name="cloak",
        baseColorTexture=Image.fromarray(texture.image),
        metallicFactor=0.0,
        roughnessFactor=0.8,
    )
    mesh = trimesh.Trimesh(
        bodies.vertices[0][unique[:, 0].astype(np.int64)],
        index.reshape(-1, 3),
        visual=trimesh.visual.TextureVisuals(unique[:, 1:], material),
        process=False,
    )
    write_bytes(path, mesh.export(file_type="glb"))


def write_obj(path: Path, bodies: Bodies, texture: Texture, picture: str) -> None:
    """Write OBJ of the first pose with its polygons in their order, and an MTL beside it.

    The MTL names `picture`, a file in the same folder.
    """
    loop_total, loop, _ = polygon_loops(bodies)
    unique, index = np.unique(texture.uv.reshape(-1, 2), axis=0, return_inverse=True)
    corner_uv = per_corner(bodies, index.reshape(-1, 3))
    lines = [f"mtllib {path.stem}.mtl", f"o {bodies.names[0].replace(' ', '_')}"]
    lines += [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in bodies.vertices[0].tolist()]
    lines += [f"vt {u:.8g} {v:.8g}" for u, v in unique.tolist()]
    lines.append("usemtl cloak")
    words = np.char.add(np.char.add((loop + 1).astype(str), "/"), (corner_uv + 1).astype(str)).tolist()
    at = 0
    for count in loop_total.tolist():
        lines.append("f " + " ".join(words[at : at + count]))
        at += count
    write_text(path, "\n".join(lines) + "\n")
    material = f"newmtl cloak\nKd 1 1 1\nKs 0 0 0\nNs 10\nd 1\nillum 1\nmap_Kd {picture}\n"
    write_text(path.with_suffix(".mtl"), material)
