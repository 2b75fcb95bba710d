"""Training on more material than a record could list: tiny made pictures, through the command line."""

import json
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.cli import main
from cloak_core.core.run_config import read_config
from cloak_core.exchange.face_lists import write_face_list
from cloak_core.exchange.scenes import write_scene
from tests.core.fakes import box_bodies, front_logo
from tests.detectors.helpers import write_tiny
from tests.sources.photographs.made_people import annotation, photograph, standing

SIDE = 340
"""Of a photograph, pixels: its corner is not in the crop of the person in its middle."""


def many_pngs(folder: Path, picture: Image.Image, count: int) -> list[str]:
    """Write a picture many times, each with another colour in its corner: only the palette of a PNG differs."""
    folder.mkdir()
    indices = np.array(picture.convert("L").quantize(255)) + 1
    indices[0, 0] = 0
    paletted = Image.fromarray(indices.astype(np.uint8), "P")
    paletted.putpalette([level for index in range(256) for level in (index, index, index)])
    paletted.save(folder / "0.png")
    data = (folder / "0.png").read_bytes()
    start = data.index(b"PLTE")
    end = start + 4 + int.from_bytes(data[start - 4 : start], "big")
    for number in range(count):
        chunk = b"PLTE" + number.to_bytes(3, "big") + data[start + 7 : end]
        changed = data[:start] + chunk + zlib.crc32(chunk).to_bytes(4, "big") + data[end + 4 :]
        (folder / f"{number}.png").write_bytes(changed)
    return [f"{number}.png" for number in range(count)]


def many_people(folder: Path, count: int) -> Path:
    """A file with as many photographs of one person, no two of them alike in all pixels."""
    record, triangle = annotation(standing(), kind="keypoints")
    small = photograph(triangle >= 0).resize((130, 150))
    mask = np.array(Image.fromarray(triangle >= 0).resize((130, 150)))
    rows = np.flatnonzero(mask.any(1))
    left, top = (SIDE - 130) // 2, (SIDE - 150) // 2
    outline = [(mask[row].argmax(), row) for row in rows]
    outline += [(130 - mask[row][::-1].argmax(), row) for row in rows[::-1]]
    polygon = [float(v) for x, y in outline for v in (x + left, y + top)]
    points = np.reshape(record["keypoints"], (-1, 3)) * (0.5, 0.5, 1) + (left, top, 0)
    points[[1, 2]] = 0.0
    x, y = np.array(polygon).reshape(-1, 2).T
    box = [x.min(), y.min(), np.ptp(x), np.ptp(y)]
    picture = Image.new("RGB", (SIDE, SIDE), (90, 120, 100))
    picture.paste(small, (left, top))
    names = many_pngs(folder, picture, count)
    about = {
        "category_id": 1,
        "iscrowd": 0,
        "bbox": box,
        "segmentation": [polygon],
        "keypoints": points.ravel().tolist(),
    }
    images = [{"id": k, "file_name": name, "width": SIDE, "height": SIDE} for k, name in enumerate(names)]
    annotations = [{"id": k, "image_id": k} | about for k in range(count)]
    (folder / "people.json").write_text(json.dumps({"images": images, "annotations": annotations}))
    return folder / "people.json"


def material(folder: Path, backgrounds: int, people: int) -> list[str]:
    """Write it; return the words that train on it. Without people, on boxes and against a tiny detector."""
    many_pngs(folder / "pictures", photograph().resize((24, 20)), backgrounds)
    words = ["--backgrounds", folder / "pictures", "--out", folder / "run", "--batch", 2, "--size", 64, "--samples", 1]
    words += ["--translation", 2, "--tv-weight", 0, "--preview-every", 0, "--angles", 0]
    if people:
        words += ["--people", many_people(folder / "people", people), "--logo", "chest", "--detector", "builtin@64"]
    else:
        bodies = box_bodies()
        write_scene(folder / "scene", bodies)
        write_face_list(folder / "logo.npy", front_logo(bodies).face_ids, bodies.topology)
        words += ["--scene", folder / "scene", "--logo", folder / "logo.npy", "--detector", write_tiny(folder)]
    return [str(word) for word in words]


def check(folder: Path, backgrounds: int, people: int) -> None:
    """Train one update on so much, and one more from the record, which is short."""
    folder.mkdir()
    words = material(folder, backgrounds, people)
    for more in ("--steps", "--extend"):
        with pytest.raises(SystemExit) as end:
            main(["train", *words, more, "1"])
        assert not end.value.code
    config = read_config(folder / "run-2")
    assert len(set(config["backgrounds"]["identities"])) == backgrounds
    assert not people or len(set(config["people"]["pixels"])) == people
    assert (folder / "run" / "config.json").stat().st_size < 12_000


def test_the_record_of_a_run_does_not_grow_with_its_material(tmp_path: Path) -> None:
    check(tmp_path / "few", 30, 0)


@pytest.mark.long
@pytest.mark.parametrize(("backgrounds", "people"), [(12_000, 0), (4, 500)])
def test_as_much_as_a_large_data_set_has(tmp_path: Path, backgrounds: int, people: int) -> None:
    # 60,000 people take half an hour: `check(folder, 4, 60_000)` by hand.
    check(tmp_path / "much", backgrounds, people)
