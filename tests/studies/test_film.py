"""Films on tiny frames with a detector whose mind is known: paths, tracks, counts, pictures, files."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.core.evaluation.settings import EvaluateSettings, FilmSettings
from cloak_core.core.logo import Logo, load_logo
from cloak_core.core.settings.values import Angles
from cloak_core.files.errors import InputError
from cloak_core.patterns.controls import OwnClothing
from cloak_core.patterns.faces import FacePattern
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.bodies import videos
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.bodies.videos import read_frames, save_film
from cloak_core.studies.film import approaches, camera_path, make_film, write_turntable
from cloak_core.studies.imagery import drawn_images
from cloak_core.studies.statistics_film import track

SIZE = 48


class NoGreen(Detector):
    """Finds what is not white and large enough: a person, less surely (or a kite) where anything is purely green."""

    def __init__(self, finds_kites: bool = False) -> None:
        super().__init__("nogreen", "nogreen")
        self.operating_point, self.finds_kites = 0.3, finds_kites
        self.class_names = ("person", "kite")

    def forward(self, images: Tensor) -> Detections:
        green = ((images[:, 1] > 0.4) & (images[:, [0, 2]].amax(1) < 0.3)).flatten(1).any(1)
        boxes, score = torch.zeros(len(images), 1, 4), torch.zeros(len(images), 1)
        for k, body in enumerate(images.mean(1) < 0.95):
            if body.float().mean() > 0.01:
                y, x = torch.nonzero(body, as_tuple=True)
                boxes[k, 0] = torch.stack([x.min(), y.min(), x.max() + 1, y.max() + 1])
                score[k] = 0.9
        if not self.finds_kites:
            return Detections(boxes, torch.where(green[:, None], score - 0.5, score).clamp(min=0))
        kite = torch.where(green[:, None], 0.8, 0.0)
        return Detections(boxes, score - kite, other=kite, other_class=torch.ones(len(images), 1, dtype=torch.int64))


def chosen(**given: object) -> FilmSettings:
    """Settings, whole numbers where the command line would have made floats of them."""
    whole = {"size", "outfit", "batch", "samples", "track_hits", "track_misses", "follow"}
    floats = {k: float(v) for k, v in given.items() if isinstance(v, int) and k not in whole}
    angles = {"angles": Angles(given["angles"])} if "angles" in given else {}
    return FilmSettings(**(given | floats | angles))


@pytest.fixture(scope="module")
def logo() -> Logo:
    return load_logo(sample_bodies("unseen"), region="shirt+trousers")


@pytest.fixture(scope="module")
def white() -> Backgrounds:
    return Backgrounds(["white"], lambda index, height, width: np.full((height, width, 3), 255, np.uint8))


def film(logo: Logo, white: Backgrounds, out: Path, detector: Detector | None = None, **settings: object) -> dict:
    bodies = sample_bodies("unseen").select_poses([0, 1])
    green = FacePattern(logo, colors=np.tile(np.array([[0, 1, 0]], np.float32), (len(logo), 1)))
    asked = chosen(**{"size": SIZE, "samples": 1, "fps": 5.0, "seconds": 1.0} | settings)
    detector = detector or NoGreen()
    return make_film(green, bodies, white, {detector.spec: detector}, out, asked)


def test_keyframes_are_joined_by_lines(tmp_path: Path) -> None:
    keys = tmp_path / "path.csv"
    keys.write_text("\ufefftime, distance,Azimuth\n0,8,0\n1,4,90\n2,4,\n")
    path = camera_path(chosen(camera=str(keys), fps=2, elevation=10), 1)
    assert path["distance"].tolist() == [8, 6, 4, 4] and path["azimuth"].tolist() == [0, 45, 90, 45]
    assert set(path["elevation"]) == {10} and approaches(path)
    for text, words in (
        ("time,distance\n1,2\n0,3\n", "begin at 0 or later and grow"),
        ("time,distance\n0,0\n", "distances are above 0"),
        ("time,speed\n0,1\n", "column 'speed' is not one of time, azimuth"),
        ("distance\n1\n", "no column 'time'"),
        ("time\nsoon\n", "time 'soon' is not a number"),
    ):
        keys.write_text(text)
        with pytest.raises(InputError, match=words):
            camera_path(chosen(camera=str(keys)), 1)
    with pytest.raises(InputError, match="'fly' is none of still, orbit, approach"):
        camera_path(chosen(camera="fly"), 1)


def box(x: float, y: float = 0, side: float = 10) -> list[float]:
    return [x, y, x + side, y + side, 0.9]


def frames(*rows: list[list[float]]) -> list[np.ndarray]:
    return [np.array(row, float).reshape(-1, 5) for row in rows]


def test_a_track_is_confirmed_by_hits_in_a_row_and_outlives_misses() -> None:
    rule = FilmSettings(track_hits=3, track_misses=2, track_iou=0.3)
    assert track(frames([box(0)], [box(1)]), rule) == []  # two hits
    assert track(frames([box(0)], [box(1)], [], [box(2)], [box(3)]), rule) == []  # never three in a row
    (one,) = track(frames([box(0)], [box(1)], [box(2)], [], [], [box(3)]), rule)
    assert one.number == 1 and sorted(one.boxes) == [0, 1, 2, 5]
    (lost,) = track(frames([box(0)], [box(1)], [box(2)], [], [], [], [box(3)]), rule)
    assert sorted(lost.boxes) == [0, 1, 2]
    (jumped,) = track(frames([box(0)], [box(1)], [box(2)], [box(50)]), rule)
    assert sorted(jumped.boxes) == [0, 1, 2]


def test_crossing_boxes_keep_to_their_nearest_track() -> None:
    two = track(frames(*[[box(4 * k), box(40 - 4 * k, y=9)] for k in range(8)]), FilmSettings())
    assert [sorted(one.boxes) for one in two] == [list(range(8))] * 2
    assert [one.boxes[7] for one in two] == [0, 1]


@pytest.mark.slow
def test_a_film_counts_what_the_detector_sees(logo: Logo, white: Backgrounds, tmp_path: Path) -> None:
    told = film(logo, white, tmp_path / "film")
    assert (told["frames"], told["hidden"], told["longest_run"], told["first_sight_m"]) == (5, 1.0, 0, None)
    assert told["tracks"] == 1  # at its own 0.3 it sees the green body, too
    cloaked, clothed = told["detectors"]["nogreen"]["logo"], told["detectors"]["nogreen"]["clothing"]
    assert cloaked["hidden_own"] == 0 and cloaked["longest_run_own"] == 5 and cloaked["conditional"] == 1
    assert (clothed["hidden"], clothed["longest_run"], clothed["tracked"], clothed["conditional"]) == (0, 5, 1.0, 0)
    numbers = json.loads((tmp_path / "film/film.json").read_text())
    assert len(numbers["by_frame"]) == 5 and numbers["hidden"] == 1.0
    row = numbers["by_frame"][1]
    assert row["body"] == sample_bodies("unseen").names[0] and row["detectors"]["nogreen"]["logo"]["hidden"]
    pictures = sorted((tmp_path / "film").glob("*.png"))
    assert len(pictures) == 5
    frame = np.asarray(Image.open(pictures[0])).astype(int)[20:60]
    green = (frame[..., 1] > 100) & (frame[..., [0, 2]].max(-1) < 30)
    assert green[:, SIZE + 2 :].sum() > 20 > green[:, :SIZE].sum()  # the cloak is on the right


def test_first_sight_is_the_distance_of_the_first_frame_that_sees(
    logo: Logo, white: Backgrounds, tmp_path: Path
) -> None:
    told = film(logo, white, tmp_path / "film.gif", camera="approach", far=20, near=1.6, seconds=2.0, size=64)
    clothed = told["detectors"]["nogreen"]["clothing"]
    rows = json.loads((tmp_path / "film.json").read_text())["by_frame"]
    seen = [row["distance"] for row in rows if not row["detectors"]["nogreen"]["clothing"]["hidden"]]
    assert clothed["first_sight_m"] == seen[0] and 1.6 < seen[0] < 20 and clothed["never_seen"] == 0
    assert told["first_sight_m"] is None and told["detectors"]["nogreen"]["logo"]["never_seen"] == 1
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.n_frames == 10 and gif.info["duration"] == 200 and gif.info["loop"] == 0


def test_a_video_holds_what_was_put_in(tmp_path: Path) -> None:
    pytest.importorskip("av")
    shades = (40, 120, 200, 90)
    save_film(tmp_path / "film.mp4", (Image.new("RGB", (65, 33), (v, v, v)) for v in shades), fps=12.5)
    found = list(read_frames(tmp_path / "film.mp4"))
    assert [frame.shape for frame in found] == [(32, 64, 3)] * 4
    assert np.abs([frame.mean() for frame in found] - np.array(shades)).max() < 4
    assert len(list(read_frames(tmp_path / "film.mp4", every=2))) == 2
    assert len(list(read_frames(tmp_path / "film.mp4", every=1, most=3))) == 3


def test_a_phone_that_filmed_lying_is_turned_upright(tmp_path: Path) -> None:
    pytest.importorskip("av")
    frame = Image.new("RGB", (64, 32))
    frame.paste((255, 255, 255), (0, 0, 16, 16))
    save_film(tmp_path / "film.mp4", [frame], fps=5.0)
    data, one = (tmp_path / "film.mp4").read_bytes(), 1 << 16
    matrix = lambda *rows: struct.pack(">9i", *rows, 0, 0, 1 << 30)
    place = data.index(matrix(one, 0, 0, 0, one, 0), data.index(b"tkhd"))
    turned = matrix(0, one, 0, -one, 0, 0)  # to the right becomes downwards: a quarter clockwise
    (tmp_path / "film.mp4").write_bytes(data[:place] + turned + data[place + 36 :])
    (upright,) = read_frames(tmp_path / "film.mp4")
    assert upright.shape == (64, 32, 3) and upright[:12, -12:].mean() > 240 > 15 > upright[:12, :12].mean()


def test_bad_films_are_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(b"nothing" * 50)
    with pytest.raises(InputError, match=r"broken\.mp4: not a readable video"):
        list(read_frames(broken))
    with pytest.raises(InputError, match=r"film.avi: a film is a .mp4, a .gif, or a folder"):
        videos.check_film(tmp_path / "film.avi")
    monkeypatch.setattr(videos.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"videos need the package av: pip install 'cloak-core\[film\]'"):
        videos.check_film(tmp_path / "film.mp4")
    with pytest.raises(InputError, match="--near: 5 m is not nearer"):
        chosen(camera="approach", near=5, far=4)
    with pytest.raises(InputError, match="frames in all, more than"):
        camera_path(chosen(seconds=1e5), 1)


@pytest.mark.slow
def test_an_evaluation_leaves_a_turntable_unless_it_is_tiny(logo: Logo, white: Backgrounds, tmp_path: Path) -> None:
    bodies = sample_bodies("unseen").select_poses([0, 1])
    asked = EvaluateSettings(size=SIZE, shift=4, images_per_view=4, samples=1)
    patterns = {"logo": FacePattern(logo, colors=np.zeros((len(logo), 3), np.float32)), "clothing": OwnClothing(logo)}
    images = drawn_images(bodies, white, tuple(map(float, range(8))), asked, "cpu", patterns.values())
    few = {"logo": patterns["logo"]}
    about = 3, {"nogreen": NoGreen()}, 0.6
    assert not write_turntable(tmp_path / "none.gif", images, few, *about) and not (tmp_path / "none.gif").exists()
    assert write_turntable(tmp_path / "turntable.gif", images, patterns, *about)
    with Image.open(tmp_path / "turntable.gif") as gif:
        assert gif.n_frames == 8


@pytest.mark.slow
def test_the_command_says_what_the_contract_promises(tmp_path: Path, cloak) -> None:
    out = tmp_path / "film.gif"
    words = ["film", "zoo:builtin-sample", "--scene", "sample:unseen[0:2]", "--size", "32", "--fps", "2", "--samples"]
    code, printed, _ = cloak(*words, "1", "--backgrounds", "procedural:test:1", "--out", out, "--json")
    told = json.loads(printed)
    assert {"frames", "hidden", "longest_run", "first_sight_m", "tracks", "out"} <= set(told)
    # Each of two single poses is held for a second.
    assert code == 0 and told["frames"] == 4 and told["out"] == str(out) and out.exists()
    code, _, err = cloak(*words, "1", "--out", out)
    assert code == 2 and "exists already" in err
