"""The store of runs and measurements: made once, found by content, continued where they stopped."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cloak_core.core.logo import chest_thighs
from cloak_core.files.errors import InputError, Stopped
from cloak_core.studies import store as store_module
from cloak_core.studies.data_split import DataSplit, open_data_split
from cloak_core.studies.store import RunStore
from tests.studies.made_split import Glow, make_options, make_split

RED, BLUE = "red:a.cfg", "blue:b.cfg"


@pytest.fixture(scope="module")
def split() -> DataSplit:
    return make_split()


@pytest.mark.slow
def test_trainings_and_evaluations_are_made_once(
    split: DataSplit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    faces = chest_thighs(split.bodies)
    first = RunStore(split, make_options(tmp_path))
    trained = first.train_repetitions(faces, [RED])
    results = first.evaluate(trained, (0.0, 5.0))
    assert len({t.folder for t in trained}) == 2 == results.trainings  # one per seed
    for name in ("train", "measure_frozen"):
        monkeypatch.setattr(store_module, name, lambda *_, **__: pytest.fail("made again"))
    evaluated = next((tmp_path / "evaluations").iterdir()).name
    left = [
        tmp_path / "runs" / f".{trained[0].folder.name}.ab12_xyz",
        tmp_path / "evaluations" / f".{evaluated}.ab12_xyz",
    ]
    for folder in left:  # of writers that were killed
        folder.mkdir()
        (folder / "scores.npz").touch()
    again = RunStore(split, make_options(tmp_path))
    found = again.train_repetitions(faces, [RED])
    assert [t.folder for t in found] == [t.folder for t in trained]
    assert again.evaluate(found, (0.0, 5.0)).images.equals(results.images)
    assert not [folder for folder in left if folder.exists()]
    # Whatever decides the result names another run.
    for spec, changes in ((BLUE, {}), (RED, {"tv_weight": 1.0})):
        with pytest.raises(pytest.fail.Exception, match="made again"):
            again.train(faces, [spec], **changes)
    monkeypatch.setattr(store_module, "MEASUREMENT_VERSION", 0)
    assert again.train_repetitions(faces, [RED])  # which a change of measuring does not touch
    with pytest.raises(pytest.fail.Exception, match="made again"):
        again.evaluate(found, (0.0, 5.0))
    monkeypatch.setattr(store_module, "TRAINING_VERSION", 0)
    with pytest.raises(pytest.fail.Exception, match="made again"):
        again.train(faces, [RED])


def test_packages_and_the_device_are_in_every_key(
    split: DataSplit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = RunStore(split, make_options(tmp_path))
    key = store._key({"settings": 1})
    assert key == store._key({"settings": 1}) != store._key({"settings": 2})
    monkeypatch.setattr(store_module, "device_kind", lambda device: "another")
    other = store._key({"settings": 1})
    monkeypatch.setattr(store_module, "package_versions", lambda *names: {"torch": "1.0"})
    assert len({key, other, store._key({"settings": 1})}) == 3


def test_a_detector_run_by_another_source_is_measured_anew(split: DataSplit, tmp_path: Path) -> None:
    before = RunStore(split, make_options(tmp_path))._detector_records[RED]
    other = Glow("red", 0)
    other.source = {"cfg": "edited"}
    after = RunStore(replace(split, detectors={RED: other}), make_options(tmp_path))._detector_records[RED]
    assert after["sha256"] == before["sha256"] and after != before


@pytest.mark.slow
def test_an_interrupted_set_goes_on(split: DataSplit, tmp_path: Path) -> None:
    faces = chest_thighs(split.bodies)
    whole = RunStore(split, make_options(tmp_path, steps=(3,))).train(faces, [RED]).colors
    other = RunStore(split, make_options(tmp_path / "other", steps=(3,)))
    with pytest.raises(Stopped, match="stopped at step 1"):
        other.train(faces, [RED], max_seconds=1e-6)
    assert np.array_equal(other.train(faces, [RED]).colors, whole)


@pytest.mark.slow
def test_each_detector_may_have_its_own_number_of_steps(split: DataSplit, tmp_path: Path) -> None:
    store = RunStore(split, make_options(tmp_path, steps=(2, 3)))
    faces = chest_thighs(split.bodies)
    length = lambda *specs: store.train(faces, specs).settings.run.steps
    assert (length(RED), length(BLUE), length(RED, BLUE)) == (2, 3, 3)
    assert store.steps() == 2 and store.options.counts()["steps"] == "2 / 3 by detector"
    more = store.with_detectors({"green": Glow("green", 1)})
    assert more.specs == (RED, BLUE, "green") and more.options.out == store.options.out
    with pytest.raises(InputError, match="--steps: 3 numbers for 2 detectors"):
        RunStore(split, make_options(tmp_path, steps=(1, 2, 3)))


def test_a_split_keeps_every_second_one() -> None:
    opened = open_data_split({RED: Glow("red", 0)}, backgrounds="procedural:train:5")
    assert len(opened.backgrounds) == 3 and len(opened.unseen_backgrounds) == 2
    assert not set(opened.backgrounds.identities()) & set(opened.unseen_backgrounds.identities())
    assert not set(opened.bodies.names) & set(opened.unseen.names)
    worn = [{outfit.tobytes() for outfit in bodies.face_colors} for bodies in (opened.bodies, opened.unseen)]
    assert worn[0] and worn[1] and not worn[0] & worn[1]
