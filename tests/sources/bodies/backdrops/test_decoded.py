import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from PIL import Image

from cloak_core.files.caching import cache_folder
from cloak_core.sources.backdrops.backgrounds import DecodedImages, load_backgrounds


def picture(seed: int = 0, height: int = 6, width: int = 8) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (height, width, 3)).astype(np.uint8)


def test_what_is_put_is_there_again_and_can_be_written_to_in_memory_alone(tmp_path):
    DecodedImages(tmp_path).put("a", picture())
    images = DecodedImages(tmp_path)
    got = images.get("a", 6, 8)
    assert np.array_equal(got, picture())
    got[:] = 0
    assert np.array_equal(images.get("a", 6, 8), picture())
    assert images.get("a", 8, 6) is None and images.get("b", 6, 8) is None


@pytest.mark.parametrize("damage", ["torn", "changed", "empty", "folder"])
def test_damaged_files_count_as_absent(tmp_path, damage: str):
    images = DecodedImages(tmp_path)
    images.put("a", picture())
    (file,) = tmp_path.iterdir()
    data = file.read_bytes()
    if damage == "folder":
        file.unlink()
        file.mkdir()
    else:
        file.write_bytes({"torn": data[:-9], "changed": bytes([data[0] ^ 1]) + data[1:], "empty": b""}[damage])
    assert images.get("a", 6, 8) is None


def test_the_least_recently_used_go_when_there_are_too_many_and_nothing_else(tmp_path):
    (tmp_path / "holiday.jpg").write_bytes(bytes(10_000))
    size = picture().nbytes + 4
    for i in range(8):
        DecodedImages(tmp_path).put(f"{i}", picture(i))
        for path in tmp_path.glob(f"{i}-*"):
            os.utime(path, (1000 + i, 1000 + i))
    assert DecodedImages(tmp_path).get("2", 6, 8) is not None
    # The first picture of a run already counts those of earlier ones.
    DecodedImages(tmp_path, limit=3 * size).put("8", picture(8))
    images = DecodedImages(tmp_path)
    assert [i for i in range(9) if images.get(f"{i}", 6, 8) is not None] == [2, 7, 8]
    assert (tmp_path / "holiday.jpg").exists()


def test_many_writers_of_one_image_leave_one_sound_file(tmp_path):
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda _: DecodedImages(tmp_path).put("a", picture()), range(40)))
    assert len(list(tmp_path.iterdir())) == 1
    assert np.array_equal(DecodedImages(tmp_path).get("a", 6, 8), picture())


def test_where_nothing_can_be_written_nothing_is_kept(tmp_path, caplog):
    (tmp_path / "file").write_text("in the way")
    images = DecodedImages(tmp_path / "file" / "images")
    images.put("a", picture())
    images.put("b", picture())
    assert images.get("a", 6, 8) is None and caplog.text.count("not kept") == 1


def test_the_second_run_decodes_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("CLOAK_CACHE", str(tmp_path / "cache"))
    for i in range(3):
        Image.fromarray(picture(i, 40, 60)).save(tmp_path / f"{i}.png")
    first = load_backgrounds(tmp_path, (32, 32))
    batch = first.batch([0, 1, 2], 32, 32)
    from cloak_core.sources.backdrops import backgrounds

    monkeypatch.setattr(backgrounds, "_decode", None)
    second = load_backgrounds(tmp_path, (32, 32), memory_bytes=1)
    assert (second.batch([0, 1, 2], 32, 32) == batch).all() and second.identities() == first.identities()
    for i in range(3):
        (tmp_path / f"{i}.png").unlink()
    assert (second.batch([2, 1, 0], 32, 32) == batch.flip(0)).all()


def test_where_the_folder_is(monkeypatch, tmp_path):
    monkeypatch.setenv("CLOAK_CACHE", "off")
    assert cache_folder("images") is None
    monkeypatch.setenv("CLOAK_CACHE", str(tmp_path))
    assert cache_folder("images") == tmp_path / "images"
    monkeypatch.delenv("CLOAK_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder("images") == tmp_path / "cloak" / "images"
