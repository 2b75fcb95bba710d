"""Training on more material than a record could list: tiny made pictures, through the command line."""

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
from tests.sources.photographs.made_people import photograph


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


def check(folder: Path, backgrounds: int) -> None:
    """Train one update on so many backgrounds, and one more from the record, which is short."""
    folder.mkdir()
    many_pngs(folder / "pictures", photograph().resize((24, 20)), backgrounds)
    bodies = box_bodies()
    write_scene(folder / "scene", bodies)
    write_face_list(folder / "logo.npy", front_logo(bodies).face_ids, bodies.topology)
    words = ["--backgrounds", folder / "pictures", "--out", folder / "run", "--batch", 2, "--size", 64, "--samples", 1]
    words += ["--translation", 2, "--tv-weight", 0, "--preview-every", 0, "--angles", 0]
    words += ["--scene", folder / "scene", "--logo", folder / "logo.npy", "--detector", write_tiny(folder)]
    for more in ("--steps", "--extend"):
        with pytest.raises(SystemExit) as end:
            main(["train", *map(str, words), more, "1"])
        assert not end.value.code
    config = read_config(folder / "run-2")
    assert len(set(config["backgrounds"]["identities"])) == backgrounds
    assert (folder / "run" / "config.json").stat().st_size < 12_000


def test_the_record_of_a_run_does_not_grow_with_its_material(tmp_path: Path) -> None:
    check(tmp_path / "few", 30)


@pytest.mark.long
def test_as_much_as_a_large_data_set_has(tmp_path: Path) -> None:
    check(tmp_path / "much", 12_000)
