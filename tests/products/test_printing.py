"""Prints: layout, picture, sheets, the garment's own pieces, and marks that meet when they are sewn."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from cloak_core.core.cameras import Camera
from cloak_core.core.geometry import face_areas
from cloak_core.core.logo import Cover, select_region
from cloak_core.core.paint import compose
from cloak_core.core.places import corner_places
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.profiles import Profile
from cloak_core.files.errors import InputError
from cloak_core.patterns.cloth import ClothPattern, Grid
from cloak_core.patterns.faces import FacePattern
from cloak_core.products import printing
from cloak_core.products.baking import Texture, bake
from cloak_core.products.layout import Layout, lay_out, signed_areas
from cloak_core.products.printing import print_logo, print_pattern
from cloak_core.products.seams import SPACING, find_borders, seam_marks
from cloak_core.products.tiling import PAGES, cloth_of, pages, tiles
from cloak_core.sources.bodies.meshes.importing import import_bodies
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.bodies.view_cache import ViewCache

DPI = 100


@pytest.fixture(scope="module")
def body() -> Bodies:
    return sample_bodies("unseen").select_poses([0])


@pytest.fixture(scope="module")
def logo(body: Bodies) -> np.ndarray:
    return select_region(body, "chest")


def faces_in(body: Bodies, ids: np.ndarray, colors: np.ndarray) -> FacePattern:
    return FacePattern(Cover(ids, body.topology), colors=np.float32(colors))


@pytest.fixture(scope="module")
def noise(body: Bodies, logo: np.ndarray) -> FacePattern:
    return faces_in(body, logo, np.random.default_rng(3).random((len(logo), 3)))


def dressed(body: Bodies, pattern: FacePattern) -> np.ndarray:
    """Colours of all faces: the pattern's where it is worn, the first outfit's elsewhere."""
    faces = body.face_colors[0].copy()
    faces[pattern.cover.face_ids] = pattern.colors
    return faces


@pytest.fixture(scope="module")
def layout(body: Bodies, logo: np.ndarray) -> Layout:
    return lay_out(body, logo)


@pytest.fixture(scope="module")
def texture(body: Bodies, noise: FacePattern, layout: Layout) -> Texture:
    return bake(body, layout, noise, DPI)


def look_up(texture: Texture, uv: np.ndarray) -> np.ndarray:
    """Colour of the pixel that each texture coordinate falls in."""
    height, width = texture.image.shape[:2]
    x = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
    y = np.clip(((1 - uv[:, 1]) * height).astype(int), 0, height - 1)
    return texture.image[y, x]


def test_the_layout_is_at_true_scale_and_never_mirrored(body: Bodies, logo: np.ndarray, layout: Layout) -> None:
    areas = signed_areas(layout.corners)
    assert (areas > 0).mean() > 0.995 and areas.min() > -1e-6
    assert areas.sum() == pytest.approx(face_areas(body)[logo].sum(), rel=0.02)
    assert layout.stretch_mean < 1.05 and layout.stretch_most < 1.3
    assert set(body.triangle_face[layout.triangles]) == set(logo.tolist())
    assert (layout.corners >= 0).all() and (layout.corners <= layout.size).all()


def test_charts_do_not_overlap(layout: Layout) -> None:
    """Random points of the sheet lie in one triangle at most."""
    points = np.random.default_rng(0).random((1500, 2)) * layout.size
    a, b, c = layout.corners.transpose(1, 0, 2)
    side = lambda p, q: (q - p)[:, :1] * (points[:, 1] - p[:, 1:]) - (q - p)[:, 1:] * (points[:, 0] - p[:, :1])
    hits = ((side(a, b) > 1e-9) & (side(b, c) > 1e-9) & (side(c, a) > 1e-9)).sum(axis=0)
    assert hits.max() == 1
    assert hits.mean() == pytest.approx(layout.used, abs=0.05)


def test_every_face_finds_its_colour_in_the_picture(body: Bodies, noise: FacePattern, texture: Texture) -> None:
    wanted, worn = np.rint(dressed(body, noise)[body.triangle_face] * 255), noise.cover.face_ids
    rest = ~np.isin(body.triangle_face, worn)
    assert np.array_equal(look_up(texture, texture.uv.mean(axis=1))[rest], wanted[rest])
    large = ~rest & (np.abs(signed_areas(texture.uv)) * texture.image[..., 0].size > 60)
    assert np.array_equal(look_up(texture, texture.uv[large].mean(axis=1)), wanted[large])


def test_no_white_shows_at_the_charts_borders(texture: Texture, layout: Layout, body: Bodies) -> None:
    """Two pixels outside every border there is still colour, so smooth sampling finds no seam."""
    lines, dots = find_borders(layout, body).lines, DPI / 0.0254
    along = lines[:, 1] - lines[:, 0]
    outwards = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    points = (lines.mean(axis=1) * dots + 2 * outwards).astype(int)
    seen = texture.image[texture.chart_rows - 1 - points[:, 1], points[:, 0]]
    assert (seen == 255).all(axis=1).mean() < 0.01


@pytest.mark.slow
def test_the_textured_body_looks_like_the_coloured_one(body: Bodies, noise: FacePattern, layout: Layout) -> None:
    """Rendered through the picture and through the face colours: within 2/255 but for one pixel in a thousand.

    Those lie where a sliver of a face is seen, thinner than the picture's pixels. White noise is the hardest case.
    """
    faces = dressed(body, noise)
    texture = bake(body, layout, noise, 150)
    corners = texture.uv.reshape(-1, 2)
    plain = replace(body, face_colors=faces[None])
    textured = replace(
        plain,
        uv=corners,
        triangle_uv=np.arange(len(corners)).reshape(-1, 3),
        textures={"baked": texture.image},
        outfit_textures=("baked",),
    )
    camera, none = Camera(width=208, height=208), np.array([0])  # one face stands for a logo, in its own colour
    views = [ViewCache(bodies).bake(0, camera, none) for bodies in (textured, plain)]
    own, black = torch.from_numpy(faces[none]), torch.zeros(1, 3, 208, 208)
    one, two = (compose([view], own, black)[0].reshape(3, -1)[:, views[1].pixels] for view in views)
    difference = (one - two).abs().amax(0).numpy() * 255
    assert len(difference) > 3000
    assert np.percentile(difference, 99.9) < 2
    assert difference.max() < 16


@pytest.mark.slow
def test_print_folder(tmp_path: Path, body: Bodies, noise: FacePattern) -> None:
    report = print_pattern(body, noise, tmp_path / "print", dpi=DPI)
    files = {path.name for path in (tmp_path / "print").iterdir()}
    assert files == {"cloak.png", "body.glb", "body.obj", "body.mtl", "sheets.pdf", "print.json"}
    assert json.loads((tmp_path / "print" / "print.json").read_text()) | {"out": report["out"]} == report
    data = (tmp_path / "print" / "sheets.pdf").read_bytes()
    boxes = re.findall(rb"/MediaBox \[\s*0 0 ([\d.]+) ([\d.]+)\s*\]", data)
    assert len(boxes) == report["pages"]
    assert [float(extent) / 72 * 0.0254 for extent in boxes[0]] == pytest.approx(PAGES["A4"], abs=2e-4)
    wanted = dressed(body, noise)
    glb = import_bodies([tmp_path / "print" / "body.glb"])
    assert np.array_equal(glb.vertices[0][glb.triangles], body.vertices[0][body.triangles])
    close = np.abs(glb.face_colors[0] - wanted[body.triangle_face]).max(axis=1) < 1 / 255
    assert close.mean() > 0.99  # the others are smaller than the picture's pixels
    obj = import_bodies([tmp_path / "print" / "body.obj"])
    assert obj.topology == body.topology
    assert np.abs(obj.vertices - body.vertices).max() < 1e-5
    assert obj.uv is not None


def test_bad_options(tmp_path: Path, body: Bodies, noise: FacePattern) -> None:
    for options, says in (({"page": "A5"}, "A4, A3, Letter, Tabloid are known"), ({"dpi": 5}, "dpi")):
        with pytest.raises(InputError, match=says):
            print_pattern(body, noise, tmp_path / "p", **options)
    assert not (tmp_path / "p").exists()
    (tmp_path / "q").mkdir()
    (tmp_path / "q" / "x").write_text("mine")
    with pytest.raises(InputError, match="exists"):
        print_pattern(body, noise, tmp_path / "q")


def test_what_four_inks_mix_stays_and_other_colours_come_near() -> None:
    mixed, green = [0.612, 0.611, 0.607], [0.0, 1.0, 0.0]
    near, beyond, sent = printing._what_comes_out(np.float32([mixed, green]), None, None)
    assert beyond.tolist() == [False, True] and sent is None
    assert near[0] == pytest.approx(mixed) and near[1] == pytest.approx([0.0, 0.588, 0.251], abs=0.2)


@pytest.mark.slow
def test_projecting_on_a_palette_leaves_only_its_colours(body: Bodies, tmp_path: Path) -> None:
    palette = np.array([[0, 0, 0], [1, 0.5, 0]])
    ids = select_region(body, "chest")[:4]
    colors = np.float32([[0.9, 0.5, 0.1], [0, 0, 0], [0.1, 0, 0.2], [1, 0.5, 0]])
    report = print_logo(body, ids, np.float32(colors), tmp_path / "p", dpi=50, project=True, palette=palette)
    assert report["unprintable_colors"] == 2
    picture = np.asarray(Image.open(tmp_path / "p" / "cloak.png").convert("RGB")).reshape(-1, 3)
    assert {(0, 0, 0), (255, 128, 0)} <= set(map(tuple, picture.tolist()))


@pytest.mark.slow
def test_with_a_profile_the_sheets_have_what_is_to_be_sent(body: Bodies, tmp_path: Path) -> None:
    steps = np.linspace(0, 1, 3)
    sent = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)
    profile = Profile((0.2 + 0.6 * sent).astype(np.float32))
    ids = select_region(body, "chest")[:4]
    colors = np.float32([[0.5, 0.3, 0.2], [0.8, 0.8, 0.2], [0.0, 0.5, 1.0], [0.5, 0.3, 0.2]])
    report = print_pattern(body, faces_in(body, ids, colors), tmp_path / "p", dpi=50, profile=profile)
    assert report["unprintable_colors"] == 1 and report["profile"]
    with Image.open(tmp_path / "p" / "cloak.png") as shown, Image.open(tmp_path / "p" / "to-print.png") as to_print:
        shown, to_print = (np.asarray(picture.convert("RGB")).reshape(-1, 3) / 255 for picture in (shown, to_print))
    differ = (shown != to_print).any(axis=1)
    assert differ.any() and np.abs(profile.photographed(to_print[differ]) - shown[differ]).max() < 2 / 255
    wanted = np.float32([[0.5, 0.3, 0.2], [0.8, 0.8, 0.2], [0.2, 0.5, 0.8]])
    apart = np.abs(shown[differ][:, None] - wanted).max(axis=2)
    assert (apart.min(axis=0) < 2 / 255).all()


@pytest.mark.slow
def test_no_page_is_blank_and_all_cloth_is_shown(body: Bodies) -> None:
    """Also of long and slanting pieces: every cell of cloth lies in a window, every window shows cloth of its own."""
    layout, page = lay_out(body, select_region(body, "shirt+trousers")), "Letter"
    found = tiles(layout, page)
    for chart in range(layout.chart_count):
        cloth, mine = cloth_of(layout, chart, 0.002), [tile for tile in found if tile.chart == chart]
        shown = np.zeros(cloth.cells.shape, int)
        for tile in mine:
            shown[cloth.inside(np.array(tile.low), np.array(tile.high))] += 1
        assert (shown[cloth.cells] > 0).all()
        own = [(shown[place] == 1)[cloth.cells[place]].sum() for tile in mine
               if (place := cloth.inside(np.array(tile.low), np.array(tile.high)))]  # fmt: skip
        assert len(mine) == 1 or min(own) > 0
        assert {tile.part for tile in mine} == ({0} if len(mine) == 1 else set(range(1, len(mine) + 1)))
    placed = list(pages(found, page))
    width, height = PAGES[page]
    for tile, x, y in (item for sheet in placed for item in sheet):
        assert x >= 0.0099 and y >= 0.0299
        assert x + tile.high[0] - tile.low[0] <= width - 0.0099 and y + tile.high[1] - tile.low[1] <= height - 0.0099
    used = [sum(np.prod(np.subtract(t.high, t.low)) for t, _, _ in items) for items in placed]
    assert min(used[:-1]) > 0.15 * np.prod(PAGES[page])
    assert sum(map(len, placed)) == len(found)
    for items in placed:
        for k, (one, x, y) in enumerate(items):
            for other, u, v in items[:k]:
                wide, high = np.subtract(one.high, one.low), np.subtract(other.high, other.low)
                assert x >= u + high[0] or u >= x + wide[0] or y >= v + high[1] or v >= y + wide[1]


@pytest.mark.slow
def test_a_cloth_is_painted_as_fine_as_it_is_printed(body, logo, layout):
    """Every texel has the square that lies under the same point of the body, and no face's mean."""
    squares = np.random.default_rng(1).random((20 * 20, 3)).astype(np.float32)
    cloth = ClothPattern(Cover(logo, body.topology), Grid(0.1, 20, 20), squares)
    image = bake(body, layout, cloth, DPI).image
    dots = DPI / 0.0254
    weights = np.random.default_rng(2).dirichlet([1, 1, 1], len(layout.triangles))[..., None]
    places = corner_places(body)[:, :, layout.triangles].transpose(2, 1, 0)
    on_cloth = (places * weights).sum(1)
    middle = np.floor((layout.corners * dots * weights).sum(1)).astype(int)
    shown = image[: int(np.ceil(layout.size[1] * dots))][::-1][middle[:, 1], middle[:, 0]]
    inner = (np.abs(on_cloth / 0.005 % 1 - 0.5) < 0.3).all(1)  # half a texel, 0.13 mm, from the next square
    right = (np.abs(shown - 255 * squares[cloth.grid.square_at(on_cloth)]) < 1).all(1)
    assert inner.sum() > 50 and right[inner].mean() > 0.95
    assert len(np.intersect1d(color_codes(image), color_codes(np.round(255 * squares)))) > 390


def color_codes(colors: np.ndarray) -> np.ndarray:
    """One number [N] for each colour [..., 3] of 0 to 255."""
    return colors.reshape(-1, 3).astype(int) @ (65536, 256, 1)


AROUND, UP = 24, 10
RADIUS, HEIGHT = 0.1, 0.5
LEVELS = HEIGHT * (np.arange(UP + 1) / UP) ** 1.3  # not evenly, so that marks lie within edges


def sleeve(mirrored: bool = False) -> Bodies:
    """An open tube whose UV map is one rectangle: its left and right sides are sewn together, its ends are hems."""
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    rows = [np.stack([RADIUS * np.sin(angle), np.full(AROUND, y), RADIUS * np.cos(angle)], 1) for y in LEVELS]
    u, v = np.meshgrid(np.arange(AROUND + 1) / AROUND, LEVELS / HEIGHT)
    uv = np.stack([-u if mirrored else u, v], axis=-1).reshape(-1, 2)
    triangles, on_map = [], []
    for row in range(UP):
        for column in range(AROUND):
            a, b = row * AROUND + column, row * AROUND + (column + 1) % AROUND
            p = row * (AROUND + 1) + column
            triangles += [(a, b, b + AROUND), (a, b + AROUND, a + AROUND)]
            on_map += [(p, p + 1, p + AROUND + 2), (p, p + AROUND + 2, p + AROUND + 1)]
    vertices = np.concatenate(rows)[None].astype(np.float32)
    return Bodies(vertices, np.int32(triangles), uv=uv.astype(np.float32), triangle_uv=np.int32(on_map))


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_garments_own_pieces_keep_their_shape_and_are_not_mirrored(mirrored):
    body = sleeve(mirrored)
    layout = lay_out(body, np.arange(body.face_count), own_pattern=True)
    assert layout.chart_count == 1 and (signed_areas(layout.corners) > 0).all()
    assert signed_areas(layout.corners).sum() == pytest.approx(face_areas(body).sum(), rel=1e-5)
    width, height = np.ptp(layout.corners.reshape(-1, 2), axis=0)
    # The map is a square, the tube is not: its area is kept, and its stretch is said.
    assert width == pytest.approx(height, rel=1e-5) and layout.stretch_mean > 1.05


def test_the_two_sides_of_a_sleeve_carry_the_same_marks_at_the_same_heights():
    body = sleeve()
    layout = lay_out(body, np.arange(body.face_count), own_pattern=True)
    marks = seam_marks(layout, body)
    count = round(HEIGHT / SPACING)
    assert [mark.name for mark in marks] == [f"A{n}" for n in range(1, count + 1) for _ in range(2)]
    low, high = layout.corners.reshape(-1, 2).min(axis=0), layout.corners.reshape(-1, 2).max(axis=0)
    for number, (one, other) in enumerate(zip(marks[::2], marks[1::2], strict=True)):
        assert one.point[1] == pytest.approx(other.point[1], abs=1e-6)
        assert sorted([one.point[0], other.point[0]]) == pytest.approx([low[0], high[0]], abs=1e-6)
        assert one.outwards == pytest.approx(-other.outwards) and abs(one.outwards[0]) == pytest.approx(1)
        assert np.sign(one.outwards[0]) == (1 if one.point[0] > other.point[0] else -1)
        share = (one.point[1] - low[1]) / (high[1] - low[1])
        assert min(abs(share - (number + 0.5) / count), abs(1 - share - (number + 0.5) / count)) < 1e-3


def test_marks_of_one_name_are_one_place_on_the_body():
    body = sample_bodies("unseen").select_poses([0])
    layout = lay_out(body, select_region(body, "chest"))
    borders, marks = find_borders(layout, body), seam_marks(layout, body)
    assert len(marks) >= 4
    _, merged = np.unique(np.round(body.vertices[0] / 1e-6), axis=0, return_inverse=True)
    place = np.zeros((merged.max() + 1, 3))
    place[merged.reshape(-1)] = body.vertices[0]

    def on_body(mark) -> np.ndarray:
        start, end = borders.lines[:, 0], borders.lines[:, 1]
        along = ((mark.point - start) * (end - start)).sum(1) / np.maximum(((end - start) ** 2).sum(1), 1e-18)
        away = np.linalg.norm(start + along.clip(0, 1)[:, None] * (end - start) - mark.point, axis=1)
        edge = np.where(borders.chart == mark.chart, away, np.inf).argmin()
        first, last = place[borders.ends[edge]]
        return first + along[edge] * (last - first)

    for one, other in zip(marks[::2], marks[1::2], strict=True):
        assert one.name == other.name and np.linalg.norm(on_body(one) - on_body(other)) < 1e-6


@pytest.mark.slow
def test_an_allowance_surrounds_the_pieces_and_takes_room(tmp_path):
    body = sleeve()
    colors = np.full((body.face_count, 3), 0.5, np.float32)
    grey = FacePattern(Cover(np.arange(body.face_count), body.topology), colors=colors)
    told = [
        print_pattern(body, grey, tmp_path / str(cm), dpi=30, own_pattern=True, allowance=cm / 100) for cm in (0.0, 5.0)
    ]
    assert told[0]["marks"] == told[1]["marks"] == round(HEIGHT / SPACING) and told[1]["pages"] > told[0]["pages"]
    with pytest.raises(InputError, match="an allowance of 6 cm"):
        print_pattern(body, grey, tmp_path / "wide", allowance=0.06)
    with pytest.raises(InputError, match="has no UV map"):
        print_pattern(replace(body, uv=None, triangle_uv=None), grey, tmp_path / "none", own_pattern=True)
    assert not (tmp_path / "wide").exists() and not (tmp_path / "none").exists()
