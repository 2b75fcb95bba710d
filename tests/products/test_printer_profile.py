"""The chart, its photograph, the fit, and what a profile says."""

import csv
import io

import numpy as np
import pytest
from PIL import Image, ImageCms

from cloak_core.exchange.profiles import Profile, read_profile
from cloak_core.files.errors import InputError
from cloak_core.products import chart
from cloak_core.products.calibration import fit_profile, interpolation, profile_of, read_patches
from cloak_core.sources.bodies.logos.palette import de2000, mean_difference
from tests.products import synthetic_printer as printing
from tests.schemas import validate

# Pairs in CIELAB and their difference: the test data published with Sharma, Wu, Dalal (2005), table 1.
SHARMA = np.array([
    [50, 2.6772, -79.7751, 50, 0, -82.7485, 2.0425], [50, 3.1571, -77.2803, 50, 0, -82.7485, 2.8615],
    [50, 2.8361, -74.0200, 50, 0, -82.7485, 3.4412], [50, -1.3802, -84.2814, 50, 0, -82.7485, 1.0000],
    [50, -1.1848, -84.8006, 50, 0, -82.7485, 1.0000], [50, -0.9009, -85.5211, 50, 0, -82.7485, 1.0000],
    [50, 0, 0, 50, -1, 2, 2.3669], [50, -1, 2, 50, 0, 0, 2.3669],
    [50, 2.49, -0.001, 50, -2.49, 0.0009, 7.1792], [50, 2.49, -0.001, 50, -2.49, 0.0010, 7.1792],
    [50, 2.49, -0.001, 50, -2.49, 0.0011, 7.2195], [50, 2.49, -0.001, 50, -2.49, 0.0012, 7.2195],
    [50, -0.001, 2.49, 50, 0.0009, -2.49, 4.8045], [50, -0.001, 2.49, 50, 0.0010, -2.49, 4.8045],
    [50, -0.001, 2.49, 50, 0.0011, -2.49, 4.7461], [50, 2.5, 0, 50, 0, -2.5, 4.3065],
    [50, 2.5, 0, 73, 25, -18, 27.1492], [50, 2.5, 0, 61, -5, 29, 22.8977],
    [50, 2.5, 0, 56, -27, -3, 31.9030], [50, 2.5, 0, 58, 24, 15, 19.4535],
    [50, 2.5, 0, 50, 3.1736, 0.5854, 1.0000], [50, 2.5, 0, 50, 3.2972, 0, 1.0000],
    [50, 2.5, 0, 50, 1.8634, 0.5757, 1.0000], [50, 2.5, 0, 50, 3.2592, 0.3350, 1.0000],
    [60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644],
    [63.0109, -31.0961, -5.8663, 62.8187, -29.7946, -4.0864, 1.2630],
    [61.2901, 3.7196, -5.3901, 61.4292, 2.2480, -4.9620, 1.8731],
    [35.0831, -44.1164, 3.7933, 35.0232, -40.0716, 1.5901, 1.8645],
    [22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373],
    [36.4612, 47.8580, 18.3852, 36.2715, 50.5065, 21.2231, 1.4146],
    [90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441],
    [90.9257, -0.5406, -0.9208, 88.6381, -0.8985, -0.7239, 1.5381],
    [6.7747, -0.2908, -2.4247, 5.8714, -0.0985, -2.2286, 0.6377],
    [2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082],
])  # fmt: skip


def test_differences_are_the_published_ones():
    found = de2000(SHARMA[:, :3], SHARMA[:, 3:6])
    np.testing.assert_allclose(found, SHARMA[:, 6], atol=1e-4)
    np.testing.assert_allclose(de2000(SHARMA[:, 3:6], SHARMA[:, :3]), found, atol=1e-12)


@pytest.fixture(scope="module")
def tried(tmp_path_factory):
    folder = tmp_path_factory.mktemp("printing") / "tried"
    return folder, printing.try_calibration(folder, photographs=2)


@pytest.mark.slow
def test_a_printer_and_camera_that_the_fit_does_not_know(tried):
    """A slanted and uneven photograph, and one that lies on its side and says so by EXIF."""
    folder, result = tried
    assert result.profile.figures["de2000_before"] > 10
    assert result.profile.figures["de2000_after"] < 3 and result.de2000_unseen < 3
    read = read_profile(folder / "profile.npz")
    assert np.array_equal(read.table, result.profile.table) and read.figures == result.profile.figures


@pytest.mark.slow
def test_the_chart_is_read_whichever_way_up_it_lies(tried, tmp_path):
    folder, _ = tried
    upright = chart.read_photograph(folder / "photograph-1.jpg")
    true = printing.come_out(chart.patch_colors())
    assert mean_difference(upright, true) < 2.5
    with Image.open(folder / "photograph-1.jpg") as picture:
        picture.rotate(180).save(tmp_path / "turned.png")
        picture.crop((0, 0, picture.width, picture.height * 2 // 3)).save(tmp_path / "half.png")
    turned = chart.read_photograph(tmp_path / "turned.png")
    assert mean_difference(turned, upright) < 0.5
    with pytest.raises(InputError, match=r"half.png: 2 of the chart's four marks"):
        chart.read_photograph(tmp_path / "half.png")


@pytest.mark.slow
def test_another_chart_between_the_marks_is_refused(tried, tmp_path, monkeypatch):
    folder, _ = tried
    others = chart.patch_colors()[np.random.default_rng(5).permutation(352)]
    monkeypatch.setattr(chart, "patch_colors", lambda: others)
    with pytest.raises(InputError, match="what lies between the marks is not the chart"):
        chart.read_photograph(folder / "photograph-1.jpg")


def bent(sent: np.ndarray) -> np.ndarray:
    return 0.1 + 0.6 * sent**1.4 @ np.array([[0.8, 0.1, 0.1], [0.2, 0.7, 0.1], [0.0, 0.3, 0.7]]).T


def test_measured_patches_make_a_profile(tmp_path):
    """A CSV with bytes, some patches left unmeasured: as it is written beside the chart."""
    rows = list(csv.DictReader(io.StringIO(chart.chart_table())))
    for row in rows[::2]:
        sent = np.array([[int(row[f"sent_{c}"]) for c in "rgb"]]) / 255
        row |= {f"seen_{c}": f"{255 * value:.2f}" for c, value in zip("rgb", bent(sent)[0], strict=True)}
    with (tmp_path / "patches.csv").open("w") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    sent, seen = read_patches(tmp_path / "patches.csv")
    assert len(sent) == 176 and np.allclose(bent(sent), seen, atol=1e-4)
    profile = fit_profile(sent, seen)
    unseen = np.random.default_rng(1).random((200, 3))
    assert mean_difference(profile.photographed(unseen), bent(unseen)) < 1 < profile.figures["de2000_before"]
    assert profile.figures["patches"] == 176


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("r,g,b\n1,2,3\n", "needs the columns"),
        ("sent_r,sent_g,sent_b,seen_r,seen_g,seen_b\n1,2,3,4,5,x\n", r"patches.csv:2: .*float"),
        ("sent_r,sent_g,sent_b,seen_r,seen_g,seen_b\n1,2,3,4,5,300\n", r"patches.csv:2: '300' is no number from 0"),
        ("sent_r,sent_g,sent_b,L,a,b\n1,2,3,4,5,6\n", "1 patches were measured"),
    ],
)
def test_bad_tables_are_refused(tmp_path, text, words):
    (tmp_path / "patches.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        profile_of([tmp_path / "patches.csv"], tmp_path / "p.npz")


def test_a_profile_interpolates_and_inverts():
    steps = np.linspace(0, 1, 9)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1)
    profile = Profile(bent(grid.reshape(-1, 3)).reshape(grid.shape).astype(np.float32))
    colors = np.random.default_rng(0).random((50, 3))
    by_weights = interpolation(colors) @ profile.table.reshape(-1, 3)
    np.testing.assert_allclose(profile.photographed(colors), by_weights, atol=1e-6)
    seen = profile.photographed(colors)
    np.testing.assert_allclose(profile.photographed(profile.to_send(seen)), seen, atol=2e-3)
    # Beyond reach: no colour of a fine grid comes nearer.
    wanted = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    fine = np.stack(np.meshgrid(*[np.linspace(0, 1, 25)] * 3, indexing="ij"), -1).reshape(-1, 3)
    least = [np.linalg.norm(profile.photographed(fine) - color, axis=1).min() for color in wanted]
    missed = np.linalg.norm(profile.photographed(profile.to_send(wanted)) - wanted, axis=1)
    assert (missed <= np.array(least) + 1e-3).all()


def test_an_icc_profile_of_a_screen_changes_nothing(tmp_path):
    (tmp_path / "screen.icc").write_bytes(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    profile = profile_of([tmp_path / "screen.icc"], tmp_path / "p.npz")
    colors = np.random.default_rng(0).random((50, 3))
    assert np.abs(profile.photographed(colors) - colors).max() < 0.02
    (tmp_path / "torn.icc").write_bytes(b"no profile")
    with pytest.raises(InputError, match=r"torn.icc: not a usable ICC profile"):
        profile_of([tmp_path / "torn.icc"], tmp_path / "p.npz")
    with pytest.raises(InputError, match="stands alone"):
        profile_of([tmp_path / "screen.icc", tmp_path / "more.csv"], tmp_path / "p.npz")


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"a": np.zeros(3)}, "not a profile"),
        ({"version": np.int64(9), "table": np.zeros((2, 2, 2, 3))}, "version 9 is newer"),
        ({"version": np.int64(1), "table": np.zeros((2, 3, 2, 3))}, "a table of colours"),
        ({"version": np.int64(1), "table": np.full((2, 2, 2, 3), np.nan)}, "outside"),
    ],
)
def test_bad_profiles_are_refused(tmp_path, arrays, words):
    np.savez(tmp_path / "p.npz", **arrays)
    with pytest.raises(InputError, match=words):
        read_profile(tmp_path / "p.npz")


@pytest.mark.slow
def test_the_command_writes_a_chart_and_a_profile(tmp_path, cloak):
    code, out, _ = cloak("calibrate", "--chart", tmp_path / "chart.pdf", "--json")
    assert code == 0 and validate("calibrate", out)["patches"] == 352
    assert (tmp_path / "chart.pdf").read_bytes().startswith(b"%PDF")
    lines = (tmp_path / "chart.csv").read_text().splitlines()
    head, rows = lines[0], [line.split(",") for line in lines[1:]]
    measured = ["row,column,sent_r,sent_g,sent_b,seen_r,seen_g,seen_b"]
    measured += [",".join(row[:5] + [str(int(v) // 2 + 40) for v in row[2:5]]) for row in rows]
    assert head == measured[0]
    (tmp_path / "seen.csv").write_text("\n".join(measured))
    code, out, _ = cloak("calibrate", "--measured", tmp_path / "seen.csv", "--out", tmp_path / "p.npz", "--json")
    told = validate("calibrate", out)
    assert code == 0 and told["patches"] == 352 and told["de2000_after"] < 1 < told["de2000_before"]
    assert cloak("calibrate", "--out", tmp_path / "q.npz")[0] == 2


def test_grey_patches_alone_are_refused():
    greys = np.linspace(0, 1, 40)[:, None].repeat(3, 1)
    with pytest.raises(InputError, match="do not differ in red, green and blue"):
        fit_profile(greys, greys)
