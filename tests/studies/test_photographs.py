"""Photographs of painted people, judged by a detector that goes by their colour."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from test_report import parse
from torch import Tensor

from cloak_core.commands import wear as judge_command
from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.core.evaluation.settings import JudgeSettings
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies import videos
from cloak_core.sources.bodies.videos import save_film
from cloak_core.studies.judging.judge import judge
from cloak_core.studies.judging.listing import list_subjects

BLUE, GREEN, RED = (20, 20, 230), (20, 230, 20), (230, 20, 20)
"""Seen surely; seen hardly; seen, but only from a threshold of 0.5 on."""
SCORES = {0: 0.55, 1: 0.1, 2: 0.9}
BODY = (10, 10, 30, 50)


class Painted(Detector):
    """A box around each patch of red, green or blue, in the left and in the right half of a picture."""

    def __init__(self) -> None:
        super().__init__("painted", "painted")
        self.operating_point = 0.5

    def forward(self, images: Tensor) -> Detections:
        (image,), boxes, scores = images, [], []
        half = image.shape[2] // 2
        for left, part in ((0, image[:, :, :half]), (half, image[:, :, half:])):
            for channel, score in SCORES.items():
                pure = (part[channel] > 0.6) & (part.sum(0) - part[channel] < 0.6)
                if pure.sum() > 20:
                    y, x = torch.nonzero(pure, as_tuple=True)
                    boxes.append([left + x.min(), y.min(), left + x.max() + 1, y.max() + 1])
                    scores.append(score)
        return Detections(torch.tensor(boxes).float().reshape(1, -1, 4), torch.tensor(scores).reshape(1, -1))


def paint(path: Path, *people: tuple, size: tuple[int, int] = (80, 60), orientation: int = 1) -> None:
    """A grey picture with filled boxes: (colour,) at the left, or (colour, box)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.new("RGB", size, (120, 120, 120))
    for color, *box in people:
        image.paste(color, box[0] if box else BODY)
    if orientation == 6:  # stored lying, to be turned clockwise
        image = image.transpose(Image.Transpose.ROTATE_90)
    exif = Image.Exif()
    exif[0x0112] = orientation
    image.save(path, quality=95, subsampling=0, exif=exif)


def see(folder: Path, **given: object) -> dict:
    return judge(folder, {"painted": Painted()}, JudgeSettings(resamples=100), **given)


@pytest.mark.slow
def test_a_person_missed_without_the_cloak_is_no_success(tmp_path: Path) -> None:
    for name, clean, worn in (("1", BLUE, GREEN), ("2", GREEN, GREEN), ("3", BLUE, BLUE), ("4", BLUE, RED)):
        paint(tmp_path / f"without/ada/park/{name}.jpg", (clean,))
        paint(tmp_path / f"with/ada/park/{name}.png", (worn,))
    paint(tmp_path / "with/ada/roof/9.png", (GREEN,))  # without a partner
    told = see(tmp_path)
    worn, clean = told["with"], told["without"]
    assert (worn["n"], worn["n_all"], worn["n_conditional"]) == (4, 5, 3)
    assert worn["success"] == pytest.approx(2 / 4) and worn["conditional"] == pytest.approx(2 / 3, abs=1e-6)
    assert worn["success_own"] == pytest.approx(1 / 4)  # red is above its own threshold
    assert worn["detected"] == pytest.approx(1 / 5) and clean["detected"] == pytest.approx(3 / 4)
    assert clean["success"] == pytest.approx(1 / 4)
    assert worn["ci95"][0] < 0.5 < worn["ci95"][1]
    assert (told["people"], told["scenes"], told["pictures"]) == (1, 2, 9)
    assert "1 cloaked pictures have no clean partner and are in no success" in told["warnings"]
    assert set(told["detectors"]["painted"]["by_scene"]) == {"park", "roof"}
    assert told["detectors"]["painted"]["by_scene"]["roof"]["with"]["success"] is None


def test_exif_rotation_boxes_and_bystanders(tmp_path: Path) -> None:
    right = (50, 8, 70, 52)
    for side, color in (("with", GREEN), ("without", BLUE)):
        paint(tmp_path / f"{side}/1.jpg", (color,), (BLUE, right), orientation=6)
    told = see(tmp_path)  # nobody says where the person is: the bystander counts
    assert told["with"]["success"] == 0 and told["with"]["detected"] == 1
    rows = [f"{side}/1.jpg,10,10,30,50\n" for side in ("with", "without")]
    (tmp_path / "boxes.csv").write_text("file,x1,y1,x2,y2\n" + "".join(rows))
    told = see(tmp_path, boxes=tmp_path / "boxes.csv")
    assert told["with"]["success"] == 1 and told["without"]["detected"] == 1
    (tmp_path / "boxes.csv").write_text("file,x1,y1,x2,y2\nwith/1.jpg,10,10,40,30\nwithout/1.jpg,10,10,40,30\n")
    assert see(tmp_path, boxes=tmp_path / "boxes.csv")["without"]["detected"] == 0  # as if it lay on its side


class Naming(Painted):
    """Takes people in green for a plant."""

    class_names = ("person", "plant")

    def forward(self, images: Tensor) -> Detections:
        found = super().forward(images)
        other = torch.where(found.scores == SCORES[1], 0.8, 0.0)
        return found._replace(other=other, other_class=torch.ones_like(other, dtype=torch.long))


def test_a_person_taken_for_something_else_is_told_from_one_who_is_gone(tmp_path: Path) -> None:
    for side, shown in (("with", (GREEN,)), ("without", (BLUE,))):
        paint(tmp_path / side / "1.png", shown)
        paint(tmp_path / side / "2.png", *([shown] if side == "without" else []))
    files = [f"{side}/{n}.png,10,10,30,50\n" for side in ("with", "without") for n in (1, 2)]
    settings = JudgeSettings(resamples=100)
    untold = judge(tmp_path, {"naming": Naming()}, settings)["with"]
    assert untold["success"] == 1 and untold["renamed"] is None  # nobody says where the person is
    (tmp_path / "boxes.csv").write_text("file,x1,y1,x2,y2\n" + "".join(files))
    told = judge(tmp_path, {"naming": Naming()}, settings, boxes=tmp_path / "boxes.csv")
    assert (told["with"]["renamed"], told["with"]["gone"], told["with"]["named"]) == (0.5, 0.5, {"plant": 1})
    assert (told["without"]["renamed"], told["without"]["gone"]) == (0, 0)


def test_a_table_names_several_people_in_a_picture(tmp_path: Path) -> None:
    right = (50, 8, 70, 52)
    paint(tmp_path / "a.png", (BLUE,), (BLUE, right))
    paint(tmp_path / "b.png", (GREEN,), (BLUE, right))
    paint(tmp_path / "c.png", (BLUE,))
    paint(tmp_path / "d.png", (RED,))
    paint(tmp_path / "empty.png")
    rows = ["file,cloak,person,scene,distance,x1,y1,x2,y2"]
    for file, cloak in (("a.png", "no"), ("b.png", "yes")):
        rows += [f"{file},{cloak},ada,park,5,10,10,30,50", f"{file},{cloak},bo,park,5,50,8,70,52"]
    rows += ["c.png,no,ada,park,12.5", "d.png,yes,ada,park,12.5", "empty.png,nobody"]
    (tmp_path / "pictures.csv").write_text("\n".join(rows))
    told = see(tmp_path)
    assert (told["people"], told["scenes"], told["pictures"]) == (2, 1, 5)
    assert told["with"]["n"] == 3 and told["with"]["success"] == pytest.approx(2 / 3, abs=1e-6)
    groups = told["detectors"]["painted"]
    assert list(groups["by_distance"]) == ["5", "12.5"]
    assert groups["by_distance"]["5"]["with"]["success"] == 0.5
    assert groups["by_person"]["ada"]["with"]["success"] == 1 and groups["by_person"]["bo"]["with"]["success"] == 0
    assert (groups["false_alarms"], groups["n_nobody"]) == (0, 1)


@pytest.mark.slow
def test_controls_stand_beside_and_broken_files_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for side, color in (("with", GREEN), ("without", BLUE), ("plain shirt", BLUE)):
        paint(tmp_path / side / "<b>ada/park/1.jpg", (color,))
    paint(tmp_path / "nobody/hall.jpg", (BLUE,))
    (tmp_path / "with/<b>ada/park/2.jpg").write_bytes(b"\xff\xd8 no picture")
    (tmp_path / "with/<b>ada/park/3.heic").write_bytes(b"?")
    (tmp_path / "with/notes.txt").write_text("?")
    told = see(tmp_path, out=tmp_path / "judge")
    assert told["controls"]["plain shirt"]["success"] == 0 and told["with"]["success"] == 1
    assert told["detectors"]["painted"]["false_alarms"] == 1
    (skipped,) = told["skipped"]
    assert "2.jpg: not a readable picture" in skipped
    assert [r.getMessage().rpartition("/")[2].partition(":")[0] for r in caplog.records] == ["3.heic", "2.jpg"]
    again = see(tmp_path, out=tmp_path / "judge")  # its own folder is no control
    assert set(again["controls"]) == {"plain shirt"}
    text = (tmp_path / "judge/report.html").read_text("utf-8")
    assert "script" not in parse(text).tags and "<b>ada" not in text
    for words in ("plain shirt", "2.jpg", "Reported where nobody is", "with the cloak", "is no success"):
        assert words in text
    assert json.loads((tmp_path / "judge/summary.json").read_text())["with"]["n"] == 1
    lines = (tmp_path / "judge/scores.csv").read_text().splitlines()
    assert lines[0].endswith(",painted") and len(lines) == 1 + 4


def test_of_a_video_every_so_many_th_frame_is_a_picture(tmp_path: Path) -> None:
    pytest.importorskip("av")
    for side, shown in (("without", [BLUE] * 8), ("with", [GREEN] * 4 + [BLUE] * 4)):
        (tmp_path / side).mkdir()
        frames = [Image.new("RGB", (80, 60), (120, 120, 120)) for _ in shown]
        for frame, color in zip(frames, shown, strict=True):
            frame.paste(color, BODY)
        save_film(tmp_path / side / "walk.mp4", frames, fps=8.0)
    told = judge(tmp_path, {"painted": Painted()}, JudgeSettings(resamples=100, every=2, most_frames=3))
    assert told["pictures"] == 6 and told["with"]["n"] == 3
    assert told["with"]["success"] == pytest.approx(2 / 3, abs=1e-6)


def test_bad_lists_are_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="absent: no such folder"):
        list_subjects(tmp_path / "absent")
    with pytest.raises(InputError, match="no picture of anybody"):
        list_subjects(tmp_path)
    paint(tmp_path / "with/1.png", (GREEN,))
    table = tmp_path / "list.csv"
    for text, words in (
        ("file,cloak\n../../etc/passwd,yes\n", "'../../etc/passwd' lies outside"),
        ("file,who\nwith/1.png,ada\n", "column 'who' is not one of"),
        ("file\nwith/1.png\n", "no column 'cloak'"),
        ("file,cloak,x1\nwith/1.png,yes,5\n", "y1 '' is not a number"),
        ("file,cloak,x1,y1,x2,y2\nwith/1.png,yes,5,5,5,9\n", "has no area"),
    ):
        table.write_text(text)
        with pytest.raises(InputError, match=words):
            list_subjects(tmp_path, table)
    table.write_text("file,x1,y1,x2,y2\nwith/2.png,1,1,2,2\n")
    with pytest.raises(InputError, match=r"'with/2\.png' is none of the pictures"):
        list_subjects(tmp_path, boxes=table)
    (tmp_path / "with/1.png").write_bytes(b"")
    with pytest.raises(InputError, match="none of its 1 pictures with or without the cloak can be read"):
        see(tmp_path)


@pytest.mark.slow
def test_the_command_says_what_the_contract_promises(tmp_path: Path, cloak, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(judge_command.Judge, "load", lambda self, spec: Painted())
    for side, color in (("with", GREEN), ("without", BLUE)):
        paint(tmp_path / side / "1.png", (color,))
    code, out, _ = cloak("judge", tmp_path, "--detector", "builtin", "--json")
    told = json.loads(out)
    assert code == 0 and {"with", "without", "people", "pictures"} <= set(told)
    assert {"success", "conditional", "n", "ci95"} <= set(told["with"])
    assert "2 pictures, people: 1, scenes: 1; wrote" in cloak("judge", tmp_path, "--detector", "builtin")[1]
    code, _, err = cloak("judge", tmp_path)
    assert code == 2 and "--detector: none given" in err


def test_a_video_that_breaks_off_is_left_out_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for side, color in (("with", GREEN), ("without", BLUE)):
        paint(tmp_path / side / "1.png", (color,))
    (tmp_path / "with/2.mp4").write_bytes(b"?")

    def broken(path: Path, every: int, most: int) -> Iterator[np.ndarray]:
        yield np.zeros((60, 80, 3), np.uint8)
        raise InputError(f"{path}: breaks off")

    monkeypatch.setattr(videos, "read_frames", broken)
    told = see(tmp_path)
    assert told["skipped"] == ["with/2.mp4: breaks off"] and told["pictures"] == 2 and told["with"]["n_all"] == 1


def test_large_pictures_are_reduced_and_boxes_with_them(tmp_path: Path) -> None:
    far = (100, 100, 300, 500)
    for side, color in (("with", GREEN), ("without", BLUE)):
        paint(tmp_path / side / "1.png", (color, far), size=(800, 600))
    (tmp_path / "boxes.csv").write_text("file,x1,y1,x2,y2\nwith/1.png,100,100,300,500\nwithout/1.png,100,100,300,500\n")
    files = {"boxes": tmp_path / "boxes.csv", "out": tmp_path / "judge"}
    told = judge(tmp_path, {"painted": Painted()}, JudgeSettings(resamples=100, longest=80), **files)
    assert told["with"]["success"] == 1 and told["without"]["detected"] == 1
