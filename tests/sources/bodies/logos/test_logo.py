from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.core.geometry import face_centres, face_normals
from cloak_core.core.logo import load_logo, make_logo, select_box, select_region
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.logos.palette import nearest_in_palette, read_palette
from cloak_core.sources.bodies.logos.stamping import project_mask, project_text
from cloak_core.sources.bodies.people.samples import sample_bodies
from tests.sources.bodies.solids import cube, sheet


@pytest.fixture(scope="module")
def samples() -> Bodies:
    return sample_bodies()


def test_regions_combine(samples: Bodies) -> None:
    front = samples.regions["front"]
    thighs = samples.regions["thighs"]
    named = lambda text: set(select_region(samples, text).tolist())
    assert named("thighs") == named("thighs-front") == set(np.flatnonzero(thighs & front))
    assert named("thighs-back") == set(np.flatnonzero(thighs & ~front))
    assert named("thighs-all") == set(np.flatnonzero(thighs)) == named("thighs-front+thighs-back")
    assert named("chest + thighs") == named("chest") | named("thighs")
    assert named("shirt") == set(np.flatnonzero(samples.regions["shirt"])) != named("shirt-front")


def test_regions_stand_where_a_face_list_does(samples: Bodies, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert np.array_equal(load_logo(samples, "chest+thighs").face_ids, select_region(samples, "chest+thighs"))
    with pytest.raises(InputError, match=r"hats: no such face list; region 'hats' is unknown.*chest"):
        load_logo(samples, Path("hats"))
    with pytest.raises(InputError, match=r"chest\.npy.*no such file"):
        load_logo(samples, "chest.npy")
    (tmp_path / "chest").touch()
    with pytest.raises(InputError, match="chest: not a"):
        load_logo(samples, "chest")


@pytest.mark.parametrize(("facing", "face"), [("front", 5), ("back", 4), ("left", 1), ("right", 0)])
def test_box_and_facing(facing: str, face: int) -> None:
    everything = (-1.0, 2.0, -1.0, 2.0, -1.0, 2.0)
    assert select_box(cube(), everything, facing).tolist() == [face]
    assert len(select_box(cube(), everything)) == 6
    assert select_box(cube(), (0.4, 0.6, 0.9, 1.1, 0.4, 0.6)).tolist() == [3]
    with pytest.raises(InputError, match=r"box 5,6.*no face"):
        select_box(cube(), (5.0, 6.0, 0.0, 1.0, 0.0, 1.0))


@pytest.mark.parametrize("ids", [[], [0, 0, 2], [-1, 2], [0, 6], [0.0, 1.0]])
def test_bad_logos(ids: list) -> None:
    with pytest.raises(InputError):
        make_logo(cube(), np.array(ids))


def test_a_letter_is_readable_from_the_front_and_stays_there(samples: Bodies) -> None:
    ids = project_text(samples, "L")
    centres = face_centres(samples)[ids]
    assert len(ids) > 60
    assert (face_normals(samples)[ids, 2] > 0).all() and samples.regions["front"][ids].mean() > 0.95
    assert (np.isin(ids, np.flatnonzero(samples.regions["chest"] | samples.regions["belly"]))).mean() > 0.9
    # The stem of an L is on the viewer's left (-x), its foot at the bottom reaches to the right (+x).
    upper = centres[:, 1] > np.median(centres[:, 1])
    assert centres[upper, 0].max() < 0
    assert centres[~upper, 0].max() > 0.05


def test_a_stamp_goes_where_it_is_told(samples: Bodies) -> None:
    ids = project_text(samples, "O", height=0.1, center=(0.0, 1.2))
    centres = face_centres(samples)[ids]
    assert (np.abs(centres[:, :2] - [0, 1.2]) <= 0.055).all()
    with pytest.raises(InputError, match="no face's centre"):
        project_text(samples, "O", center=(3.0, 1.0))
    with pytest.raises(InputError, match="height"):
        project_text(samples, "O", height=-1.0)


def test_what_stands_in_front_takes_the_ink(tmp_path: Path) -> None:
    """Two walls, the nearer one half as wide: behind it nothing is stamped."""
    far = sheet(10)
    body = Bodies(
        np.concatenate([far.vertices, far.vertices * [0.5, 1, 1] + [0, 0, 1]], axis=1),
        np.concatenate([far.triangles, far.triangles + far.vertices.shape[1]]),
        np.concatenate([far.triangle_face, far.triangle_face + 100]),
    )
    Image.new("L", (8, 8), 0).save(tmp_path / "ink.png")
    ids = project_mask(body, tmp_path / "ink.png", height=1.0, center=(0.5, 0.5))
    column = ids[ids < 100] % 10
    assert (ids >= 100).sum() == 100
    assert sorted(set(column.tolist())) == [5, 6, 7, 8, 9] and len(column) == 50


@pytest.mark.parametrize(("dark", "transparent"), [(True, False), (False, True), (True, True)])
def test_ink_is_what_is_dark_or_what_is_opaque(tmp_path: Path, dark: bool, transparent: bool) -> None:
    """A filled right half: of dark ink on white, or opaque (light) on nothing."""
    pixels = np.full((40, 40, 4), 255, np.uint8)
    pixels[:, :20, 3] = 0 if transparent else 255
    pixels[:, 20:, :3] = 30 if dark else 255
    Image.fromarray(pixels).save(tmp_path / "half.png")
    ids = project_mask(sheet(10), tmp_path / "half.png", height=1.0, center=(0.75, 0.5))  # ink is 20 wide and 40 high
    assert len(ids) == 50 and (ids % 10 >= 5).all()


def test_pictures_that_cannot_be_stamped(tmp_path: Path, samples: Bodies) -> None:
    Image.new("L", (8, 8), 255).save(tmp_path / "white.png")
    for name, words in (("white", "no ink"), ("gone", "no such")):
        with pytest.raises(InputError, match=rf"{name}\.png.*{words}"):
            project_mask(samples, tmp_path / f"{name}.png")


@pytest.mark.parametrize("text", ["", "   ", "x" * 33])
def test_texts_that_cannot_be_stamped(samples: Bodies, text: str) -> None:
    with pytest.raises(InputError, match="text"):
        project_text(samples, text)


# The first lines of the palette that Thys et al. publish (30values.txt), and ways of our own.
PLAIN = "0.7098,0.32549,0.23529\n\n# a comment\n; another\n0 0.5 1\n#ff8000\n#00ff00 grass\n"
GIMP = "GIMP Palette\nName: cloth\nColumns: 2\n#\n255 128   0\tOrange dark\n0 0 255\n"


def write(tmp_path, text, name="palette.txt"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_palettes_of_text(tmp_path):
    expected = [[0.7098, 0.32549, 0.23529], [0, 0.5, 1], [1, 128 / 255, 0], [0, 1, 0]]
    assert np.allclose(read_palette(write(tmp_path, PLAIN)), expected)
    assert np.allclose(read_palette(write(tmp_path, "\ufeff" + PLAIN.replace("\n", "\r\n"))), expected)


def test_palettes_of_gimp(tmp_path):
    assert np.allclose(read_palette(write(tmp_path, GIMP)), [[1, 128 / 255, 0], [0, 0, 1]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no colour"),
        ("# nothing\n", "no colour"),
        ("0 0 0\n0 0 1.5\n", ":2: '0 0 1.5' is no colour"),
        ("0 0\n", ":1"),
        ("0 0 nan\n", ":1"),
        ("0 0 0 0\n", ":1"),
        ("#ff80\n", ":1"),
        ("GIMP Palette\n0 0 256 too much\n", ":2"),
        (b"\xff\xfe\x00", "not UTF-8 text"),
        (b"0 " * (1 << 20), "larger than any file"),
        ("0 0 0\n" * 5000, "more than 4096"),
    ],
)
def test_bad_palettes_are_named(tmp_path, text, words):
    with pytest.raises(InputError) as refused:
        read_palette(write(tmp_path, text))
    assert words in str(refused.value) and "palette.txt" in str(refused.value) and "\n" not in str(refused.value)


def test_nearest_against_looking_at_all():
    random = np.random.default_rng(0)
    colors, palette = random.random((600, 3)), random.random((50, 3))
    nearest, beyond = nearest_in_palette(colors, palette)
    distances = np.linalg.norm(colors[:, None] - palette[None], axis=2)
    assert np.allclose(np.linalg.norm(colors - nearest, axis=1), distances.min(axis=1))
    assert (beyond == (np.abs(nearest - colors).max(axis=1) > 8 / 255)).all() and beyond.any() and not beyond.all()
