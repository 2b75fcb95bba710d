"""The store of runs and measurements: made once, found by content, continued where they stopped."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluate import identity
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.logo import Cover, chest_thighs, make_logo
from cloak_core.core.pattern import Pattern
from cloak_core.core.run_config import check_same
from cloak_core.core.settings import make_settings
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError, Stopped
from cloak_core.patterns.cloth import ClothPattern, Grid
from cloak_core.patterns.faces import FacePattern
from cloak_core.studies import store as store_module
from cloak_core.studies import training_store
from cloak_core.studies.store import DataSplit, RunStore, open_data_split
from cloak_core.studies.training_store import Training, TrainingStore
from cloak_core.studies.trainings.training import training_config
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
    results = first.measure_repetitions(trained, (0.0, 5.0))
    assert len({t.folder for t in trained}) == 2 == results.trainings  # one per seed
    for module, name in ((training_store, "train"), (store_module, "measure_frozen")):
        monkeypatch.setattr(module, name, lambda *_, **__: pytest.fail("made again"))
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
    assert again.measure_repetitions(found, (0.0, 5.0)).images.equals(results.images)
    assert not [folder for folder in left if folder.exists()]
    # Whatever decides the result names another run.
    for spec, changes in ((BLUE, {}), (RED, {"tv_weight": 1.0})):
        with pytest.raises(pytest.fail.Exception, match="made again"):
            again.train_faces(faces, [spec], **changes)
    monkeypatch.setattr("cloak_core.core.evaluate.MEASUREMENT_VERSION", 0)
    assert again.train_repetitions(faces, [RED])  # which a change of measuring does not touch
    with pytest.raises(pytest.fail.Exception, match="made again"):
        again.measure_repetitions(found, (0.0, 5.0))
    monkeypatch.setattr(training_store, "TRAINING_VERSION", 0)
    with pytest.raises(pytest.fail.Exception, match="made again"):
        again.train_faces(faces, [RED])


def test_a_training_is_its_key_where_a_run_folder_goes_on(split: DataSplit, tmp_path: Path) -> None:
    """Two trainings have one key exactly where one may go on with the other's run folder."""
    bodies = split.bodies.select_poses([0])
    logo = make_logo(bodies, chest_thighs(bodies))
    settings = make_settings(steps=2, batch=2, size=48, translation=4)
    base = Training(settings, bodies, logo, [split.detectors[RED]], split.backgrounds)
    palettes = [tmp_path / "a.txt", tmp_path / "b.txt"]
    for number, palette in enumerate(palettes):
        palette.write_text(f"0.1 0.1 0.{number}\n")
    with_palettes = [replace(base, settings=settings.changed(palette=str(p), nps_weight=0.1)) for p in palettes]
    store = TrainingStore(tmp_path)
    others = [
        replace(base, settings=settings.changed(seed=1)),
        replace(base, bodies=split.bodies),
        replace(base, detectors=[split.detectors[BLUE]]),
        replace(base, backgrounds=split.unseen_backgrounds),
        *with_palettes,
    ]
    keys = {store.folder(training) for training in (base, *others)}
    assert len(keys) == 1 + len(others)
    for free in ({"preview_every": 7}, {"max_seconds": 5.0}):
        again = replace(base, settings=settings.changed(**free))
        assert store.folder(again) == store.folder(base)
        check_same(training_config(base), training_config(again), tmp_path)
    for other in others:
        with pytest.raises(InputError, match="was started with"):
            check_same(training_config(base), training_config(other), tmp_path)


def test_whatever_decides_an_evaluation_is_in_its_identity(split: DataSplit, tmp_path: Path) -> None:
    store, detector = RunStore(split, make_options(tmp_path)), split.detectors[RED]
    settings = store.evaluate_settings()
    cover = Cover(chest_thighs(split.unseen), split.unseen.topology)
    green = FacePattern(cover, colors=np.tile(np.float32([0, 1, 0]), (len(cover), 1)))
    fewer = FacePattern(replace(cover, face_ids=cover.face_ids[1:]), colors=green.colors[1:])
    cloth = ClothPattern.of_picture(cover, np.full((1, 1, 3), 255, np.uint8), 0.5)

    def key(
        worn: Pattern = green,
        judge: Detector = detector,
        angles: tuple[float, ...] = (0.0,),
        bodies: Bodies = split.unseen,
        how: EvaluateSettings = settings,
        kept: RunStore = store,
    ) -> str | None:
        return identity(*kept.shown(worn, angles, how, bodies), {RED: judge}, how)

    edited, unknown, brighter = Glow("red", 0), Glow("red", 0), Glow("red", 0)
    edited.source, unknown.source = {"cfg": "edited"}, {}
    brighter.gain.data.mul_(2)
    sooner = Glow("red", 0)
    sooner.operating_point = 0.2
    keys = [
        key(),
        *(key(judge=one) for one in (edited, brighter, sooner)),
        *map(key, (green.recolored(lambda colors: 1 - colors), fewer, cloth, replace(cloth, grid=Grid(0.4, 1, 1)))),
        key(angles=(5.0,)),
        key(bodies=split.unseen.select_poses([0])),
        key(how=replace(settings, seed=1)),
        key(how=replace(settings, controls=())),
        key(how=replace(settings, threshold=0.3)),
        key(kept=RunStore(replace(split, unseen_backgrounds=split.backgrounds), make_options(tmp_path))),
    ]
    assert None not in keys and len(set(keys)) == len(keys)
    assert key() == keys[0] == key(judge=Glow("red", 0))
    assert key(judge=unknown) is None, "its code may be anything: it is measured each time"


@pytest.mark.slow
def test_an_interrupted_set_goes_on(split: DataSplit, tmp_path: Path) -> None:
    faces = chest_thighs(split.bodies)
    whole = RunStore(split, make_options(tmp_path, steps=(3,))).train_faces(faces, [RED]).pattern.colors
    other = RunStore(split, make_options(tmp_path / "other", steps=(3,)))
    with pytest.raises(Stopped, match="stopped at step 1"):
        other.train_faces(faces, [RED], max_seconds=1e-6)
    assert np.array_equal(other.train_faces(faces, [RED]).pattern.colors, whole)


@pytest.mark.slow
def test_each_detector_may_have_its_own_number_of_steps(split: DataSplit, tmp_path: Path) -> None:
    store = RunStore(split, make_options(tmp_path, steps=(2, 3)))
    faces = chest_thighs(split.bodies)
    length = lambda *specs: store.train_faces(faces, specs).settings.run.steps
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
