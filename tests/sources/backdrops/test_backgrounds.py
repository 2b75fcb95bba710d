"""Backgrounds: folders with every kind of image and damage, and the procedural scenes."""

import logging

import numpy as np
import pytest
import torch
from PIL import Image

from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops import backgrounds as module
from cloak_core.sources.backdrops.backgrounds import load_backgrounds


def _save(path, array, **options):
    Image.fromarray(np.asarray(array, np.uint8)).save(path, **options)


def _halves(height, width, left=(255, 0, 0), right=(0, 0, 255)):
    array = np.empty((height, width, 3), np.uint8)
    array[:, : width // 2], array[:, width // 2 :] = left, right
    return array


def test_folder_takes_all_formats_by_name(tmp_path):
    for name in ("c.webp", "a.JPG", "b.png"):
        _save(tmp_path / name, _halves(40, 60))
    (tmp_path / "notes.txt").write_text("no image")
    _save(tmp_path / ".hidden.png", _halves(40, 60))
    backgrounds = load_backgrounds(tmp_path, size=(32, 32))
    assert backgrounds.names == ("a.JPG", "b.png", "c.webp")
    batch = backgrounds.batch([0, 1, 2], 32, 32)
    assert batch.shape == (3, 3, 32, 32) and batch.dtype == torch.float32
    expected = torch.tensor([1.0, 0, 0])[:, None, None].expand(3, 32, 12)
    assert (batch[:, :, :, :12] - expected).abs().max() < 0.12  # lossy formats


@pytest.mark.parametrize("shape", [(30, 200), (200, 30), (31, 33), (500, 500)])
def test_crop_is_centred_and_undistorted(tmp_path, shape):
    """A disc in the middle of the picture stays a disc in the middle, whatever the aspect."""
    height, width = shape
    radius = min(shape) / 4
    y, x = np.mgrid[:height, :width] + 0.5
    disc = (np.hypot(y - height / 2, x - width / 2) < radius) * 255
    _save(tmp_path / "disc.png", np.repeat(disc[..., None], 3, 2))
    image = load_backgrounds(tmp_path, size=(64, 64)).image(0, (64, 64))[0].float() / 255
    rows, columns = image.sum(1), image.sum(0)
    assert abs(image.sum() - np.pi * 16**2) < 45
    assert abs(rows.max() - 32) < 2.5 and abs(columns.max() - 32) < 2.5
    centre = torch.arange(64) + 0.5
    assert (
        abs((rows * centre).sum() / rows.sum() - 32) < 0.5 and abs((columns * centre).sum() / columns.sum() - 32) < 0.5
    )


def test_exif_orientation_is_applied(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # stored on its side: turn clockwise to view
    _save(tmp_path / "turned.jpg", _halves(64, 64), exif=exif, quality=95)
    image = load_backgrounds(tmp_path, size=(64, 64)).image(0, (64, 64)).float() / 255
    assert image[0, :28].mean() > 0.9 and image[2, :28].mean() < 0.1  # red half is now on top
    assert image[2, 36:].mean() > 0.9


def test_damaged_files_are_named_and_skipped(tmp_path, caplog):
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3))
    _save(tmp_path / "good.png", noise)
    _save(tmp_path / "whole.jpg", noise)
    whole = (tmp_path / "whole.jpg").read_bytes()
    (tmp_path / "truncated.jpg").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "text.webp").write_text("this is no image")
    (tmp_path / "folder.png").mkdir()
    with caplog.at_level(logging.WARNING, logger="cloak"):
        backgrounds = load_backgrounds(tmp_path)
    assert backgrounds.names == ("good.png", "whole.jpg")
    for name in ("truncated.jpg", "empty.png", "text.webp", "folder.png"):
        assert sum(name in r.message for r in caplog.records) == 1


def test_bad_folders_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        load_backgrounds(tmp_path / "missing")
    with pytest.raises(InputError, match="no jpg, png or webp"):
        load_backgrounds(tmp_path)
    (tmp_path / "bad.jpg").write_bytes(b"\xff\xd8\xff")
    with pytest.raises(InputError, match=r"none of its 1 images can be read \(bad\.jpg: not a readable picture"):
        load_backgrounds(tmp_path)
    with pytest.raises(InputError, match="this is a file"):
        load_backgrounds(tmp_path / "bad.jpg")


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_the_largest_pictures_of_telephones_are_taken(tmp_path):
    Image.new("1", (12_000, 9_000), 1).save(tmp_path / "large.png")
    assert (load_backgrounds(tmp_path).image(0) == 255).all()


def test_subsets_and_splits_keep_names_and_images():
    backgrounds = load_backgrounds("procedural:test:6")
    odd = backgrounds.split(2, 1)
    assert odd.names == backgrounds.names[1::2] and len(odd) == 3
    part = odd.subset([2, 0])
    assert torch.equal(part.image(0, (32, 32)), backgrounds.image(5, (32, 32)))
    assert torch.equal(part.image(-1, (32, 32)), backgrounds.image(1, (32, 32)))
    with pytest.raises(IndexError):
        part.image(2)


@pytest.mark.slow
def test_procedural_is_deterministic_and_its_sets_are_disjoint():
    first, again = load_backgrounds("procedural:train:4"), load_backgrounds("procedural:train:9")
    assert all(torch.equal(first.image(i, (64, 64)), again.image(i, (64, 64))) for i in range(4))
    assert len(load_backgrounds("procedural")) > 100
    others = [load_backgrounds(s) for s in ("procedural:train:4", "procedural:test:4", "procedural:train:4:1")]
    images = torch.cat([b.batch(range(4), 64, 64) for b in others]).flatten(1)
    names = [n for b in others for n in b.names]
    distance = torch.cdist(images, images) + torch.eye(12) * 100
    assert distance.min() > 1 and len(set(names)) == 12


@pytest.mark.parametrize(
    "spec", ["procedural:tset", "procedural:train:x", "procedural:0", "procedural:train:1:2:3", "procedural:-3"]
)
def test_bad_procedural_specs_are_refused(spec):
    with pytest.raises(InputError, match="procedural"):
        load_backgrounds(spec)


def test_the_second_run_decodes_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("CLOAK_CACHE", str(tmp_path / "cache"))
    random = np.random.default_rng(0)
    for i in range(3):
        Image.fromarray(random.integers(0, 255, (40, 60, 3)).astype(np.uint8)).save(tmp_path / f"{i}.png")
    first = load_backgrounds(tmp_path, (32, 32))
    batch = first.batch([0, 1, 2], 32, 32)
    monkeypatch.setattr(module, "_decode", None)
    monkeypatch.setattr(module, "MEMORY_BYTES", 1)
    second = load_backgrounds(tmp_path, (32, 32))
    assert (second.batch([0, 1, 2], 32, 32) == batch).all() and second.identities() == first.identities()
    for i in range(3):
        (tmp_path / f"{i}.png").unlink()
    assert (second.batch([2, 1, 0], 32, 32) == batch.flip(0)).all()
