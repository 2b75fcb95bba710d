"""`cloak judge` on stand-ins for photographs: renders on real backgrounds, with what cameras and people do to them."""

import csv
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.core.evaluation import CLOTHING, LOGO
from cloak_core.core.evaluation.settings import EvaluateSettings, JudgeSettings
from cloak_core.core.evaluation.trials import draw_trials
from cloak_core.core.images import ImageSet
from cloak_core.core.logo import load_logo
from cloak_core.core.pattern import Pattern
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.detectors.loading import load_detector
from cloak_core.patterns.controls import OwnClothing
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.bodies.videos import save_film
from cloak_core.studies.imagery import body_images
from cloak_core.studies.judging.judge import judge
from cloak_core.studies.opening import run_pattern
from cloak_core.studies.report.pictures import to_pil
from cloak_core.zoo.entry import run_path

LYING = 6
"""EXIF: stored turned to the left."""


def make_images(data: Path, people: int, scenes: int, size: int) -> tuple[ImageSet, dict[str, Pattern]]:
    """People of the zoo's transfer cloak, each once in each scene from each of two distances."""
    bodies = load_scene(f"{data / 'bodies_anny.npz'}[4:{4 + people}]")
    photographs = load_backgrounds(f"{data / 'backgrounds'}[1::2]").subset(range(scenes))
    run = run_path("zoo:transfer-anny")
    worn = run_pattern(run, load_logo(bodies, run / "logo.npy"))
    patterns = {CLOTHING: OwnClothing(worn.cover), LOGO: worn}
    asked = EvaluateSettings(size=size, shift=size // 16, images_per_view=scenes, distances=(2.2, 3.5), samples=4)
    trials = draw_trials(people, (5.0,), scenes, bodies.outfit_count, asked)
    trials["background"] = np.tile(np.arange(scenes), 2 * people)
    about = bodies, photographs, trials, RenderSettings(samples=4), asked.camera
    return body_images(*about, patterns.values()), patterns


def make_stand_ins(folder: Path, shared: Path, people: int = 2, scenes: int = 2, size: int = 320) -> Path:
    """A folder of pictures with pictures.csv: every third lies on its side but for EXIF, every fourth has people
    beside, one pair is a video, and some show nobody. A person's box is told wherever it is needed."""
    data, rows = shared / "data", []
    images, patterns = make_images(data, people, scenes, size)
    with Image.open(data / "photos/person.jpg") as photograph:
        beside = photograph.convert("RGB").resize((size * photograph.width // photograph.height, size))
    folder.mkdir(parents=True)
    for i in range(len(images.trials)):
        box = images.boxes(images.views([i], patterns[LOGO]), [i])[0].tolist()
        shown = images.trials.loc[i]
        labels = [f"person {shown['pose']:g}", f"scene {shown['background']:g}", shown["distance"]]
        for control, (image,) in zip(patterns, images.compose([i], list(patterns.values())), strict=True):
            picture = to_pil(image)
            if i % 4 == 3:
                wide = Image.new("RGB", (size + beside.width, size))
                wide.paste(picture, (0, 0))
                wide.paste(beside, (size, 0))
                picture = wide
            name, exif = f"{i:03d}-{control}.jpg", Image.Exif()
            if i % 3 == 2:
                picture = picture.transpose(Image.Transpose.ROTATE_90)
                exif[0x0112] = LYING
            picture.save(folder / name, quality=92, exif=exif)
            rows.append([name, "yes" if control == LOGO else "no", *labels, *box])
    for control, pattern in patterns.items():
        frames = [to_pil(image) for i in range(2) for image in images.render([i], pattern)]
        save_film(folder / f"walk-{control}.mp4", frames * 2, fps=4.0)
        rows.append([f"walk-{control}.mp4", "yes" if control == LOGO else "no", "person 0", "walk", "", *[""] * 4])
    for index in range(3):
        to_pil(images.bare([index % scenes])[0]).save(folder / f"nobody-{index}.png")
        rows.append([f"nobody-{index}.png", "nobody", *[""] * 7])
    (folder / "broken.jpg").write_bytes(b"\xff\xd8\xff")
    rows.append(["broken.jpg", "yes", "person 0", "scene 0", 2.2, *[""] * 4])
    with (folder / "pictures.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["file", "cloak", "person", "scene", "distance", "x1", "y1", "x2", "y2"])
        writer.writerows(rows)
    return folder


@pytest.mark.long
def test_stand_ins_are_judged_as_what_they_are(shared: Path, tmp_path: Path) -> None:
    pytest.importorskip("av")
    pytest.importorskip("onnx2torch")
    folder = make_stand_ins(tmp_path / "stand-ins", shared)
    spec = f"onnx:{shared / 'data/detectors/nanodet_m.onnx'}@conf=0.4"
    report = judge(folder, {spec: load_detector(spec)}, JudgeSettings(every=2), out=tmp_path / "report")
    assert report["people"] == 2 and report["scenes"] == 3
    assert report["pictures"] == 16 + 2 * 2 + 3 and len(report["skipped"]) == 1
    # Clothed people are found, lying files and bystanders or not; the cloak was trained against this detector.
    assert report["without"]["detected_own"] >= 0.8
    assert report["with"]["detected"] < 0.5 * report["without"]["detected"]
    assert report["with"]["success"] <= report["with"]["conditional"]
    assert report["detectors"][spec]["false_alarms"] == 0
    assert set(report["detectors"][spec]["by_distance"]) == {"2.2", "3.5"}
