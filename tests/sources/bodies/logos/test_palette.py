import numpy as np
import pytest

from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.logos.palette import nearest_in_palette, read_palette

# The first lines of the palette that Thys et al. publish (30values.txt), and ways of our own.
PLAIN = "0.7098,0.32549,0.23529\n\n# a comment\n; another\n0 0.5 1\n#ff8000\n#00ff00 grass\n"
GIMP = "GIMP Palette\nName: cloth\nColumns: 2\n#\n255 128   0\tOrange dark\n0 0 255\n"


def write(tmp_path, text, name="palette.txt"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_text(tmp_path):
    expected = [[0.7098, 0.32549, 0.23529], [0, 0.5, 1], [1, 128 / 255, 0], [0, 1, 0]]
    assert np.allclose(read_palette(write(tmp_path, PLAIN)), expected)
    assert np.allclose(read_palette(write(tmp_path, "\ufeff" + PLAIN.replace("\n", "\r\n"))), expected)


def test_gimp(tmp_path):
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
