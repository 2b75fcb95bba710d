import dataclasses
import math

import pytest

from cloak_core.attack.parsing import parse_angles, parse_azimuths, parse_range
from cloak_core.attack.settings import (
    PRESETS,
    TrainSettings,
    make_settings,
    settings_from_record,
    settings_record,
)
from cloak_core.files.errors import InputError


@pytest.mark.parametrize(
    ("spec", "angles"),
    [
        ("0", (0.0,)),
        ("-10:10:5", (-10.0, -5.0, 0.0, 5.0, 10.0)),
        ("-10,0,10", (-10.0, 0.0, 10.0)),
        ("-1:1", (-1.0, 0.0, 1.0)),
        ("0:1:0.1", tuple(round(i / 10, 9) for i in range(11))),
        ("0:9:4", (0.0, 4.0, 8.0)),
    ],
)
def test_angles(spec, angles):
    assert parse_angles(spec) == angles


@pytest.mark.parametrize(
    "spec",
    ["", "a", "1:2:0", "1:2:-1", "2:1", "1:2:3:4", "1,2:3", "nan", "inf", "0,0", "1,,2", "400", "0:360:0.0001"],
)
def test_bad_angles_are_named(spec):
    with pytest.raises(InputError, match="--angles"):
        parse_angles(spec)


def test_ranges():
    assert parse_range("2.2", "--distance") == (2.2, 2.2)
    assert parse_range("1.4:3", "--distance") == (1.4, 3.0)
    for spec in ("3:1.4", "1:2:3", "x", "nan:1"):
        with pytest.raises(InputError, match="--distance"):
            parse_range(spec, "--distance")


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_are_valid_and_survive_json(preset):
    settings = make_settings(preset)
    assert settings.preset == preset
    assert settings_from_record(settings_record(settings)) == settings


def test_presets_hold_the_documented_differences():
    paper, reference = make_settings("paper"), make_settings("reference")
    assert (paper.optimizer, paper.lr, paper.schedule, paper.lr_epochs, paper.epochs) == ("sgd", 0.1, "step", 10, 100)
    assert (paper.loss, paper.translation, paper.tv_weight) == ("score", 50, 2.5)
    assert (reference.loss, reference.momentum, reference.translation) == ("objectness", 0.9, 25)
    assert reference.lr == pytest.approx(1e-2 / math.sqrt(reference.batch))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("lr", math.nan), ("lr", 0.0), ("lr", -1.0), ("lr", math.inf), ("tv_weight", -0.1), ("tv_weight", math.nan),
        ("batch", 0), ("batch", -3), ("steps", 0), ("steps", -5), ("epochs", math.nan), ("epochs", 0.0),
        ("momentum", 1.0), ("noise", 2.0), ("noise", math.nan), ("size", 0), ("samples", 3), ("threads", 0),
        ("threshold", 1.0), ("threshold", math.nan), ("translation", -1), ("translation", 208), ("seed", -1),
        ("distance", "3:1"), ("distance", "0:1"), ("distance", "-2"), ("contrast", "1.2:0.8"), ("contrast", "-1:1"),
        ("brightness", "x"), ("angles", "5:1:1"), ("optimizer", "rmsprop"), ("loss", "x"), ("schedule", "linear"),
        ("initial", "blue"), ("device", None), ("field_of_view", 180.0), ("elevation", 91.0), ("checkpoint_every", -1),
        ("elevation_jitter", 22.0), ("max_seconds", 0.0), ("outfits", "none"), ("reduce", "mean"), ("batch", 1.5),
        ("lr", "fast"), ("batch", True), ("preset", "mine"),
    ],
)  # fmt: skip
def test_bad_values_are_refused_by_name(name, value):
    length = {} if name == "epochs" else {"epochs": None, "steps": 10}
    with pytest.raises(InputError, match="--" + name.replace("_", "-")):
        settings_from_record(length | {name: value})


def test_impossible_combinations():
    with pytest.raises(InputError, match="--steps and --epochs"):
        TrainSettings(epochs=1.0, steps=1)
    with pytest.raises(InputError, match="--steps and --epochs"):
        TrainSettings(epochs=None)
    with pytest.raises(InputError, match="--steps and --epochs"):
        make_settings("paper", steps=5, epochs=2)
    with pytest.raises(InputError, match="--momentum"):
        make_settings("best", momentum=0.9)
    with pytest.raises(InputError, match="--colour: no such setting"):
        make_settings("best", colour=1)
    with pytest.raises(InputError, match="--preset"):
        make_settings("worst")


def test_steps_replace_epochs_and_back():
    assert make_settings("paper", steps=5).epochs is None
    assert make_settings("best", epochs=2).steps is None


def test_an_epoch_is_every_background_at_every_angle():
    settings = make_settings("paper", epochs=3, batch=4, angles="-10:10:5")
    assert settings.epoch_images(7) == 35
    assert settings.total_steps(7) == math.ceil(3 * 35 / 4)
    assert make_settings("paper", steps=11).total_steps(7) == 11


def test_whole_numbers_are_taken_where_numbers_are_meant():
    settings = make_settings("best", lr=1, angles=0, distance=2, batch=4.0)
    assert settings.lr == 1.0 and isinstance(settings.lr, float)
    assert settings.angles == "0" and settings.distance == "2" and settings.batch == 4


def test_settings_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        make_settings("best").lr = 1.0


def test_ranges_of_azimuths():
    circle = parse_azimuths("0..360")
    assert circle.starts == tuple(range(0, 360, 10)) and circle.width == 10 and circle.centers[0] == 5
    narrow = parse_azimuths("-12..12")
    assert len(narrow.starts) == 3 and narrow.width == 8
    assert parse_azimuths("-10:10:5").starts == parse_angles("-10:10:5") and parse_azimuths("0").width == 0
    for bad in ("10..0", "0..0", "0..400", "-200..200", "0..", "a..b", "0..10..20"):
        with pytest.raises(InputError, match="--angles"):
            parse_azimuths(bad)


def test_what_distorts_is_off_in_the_papers_presets_and_bounded():
    for preset in ("paper", "reference"):
        settings = make_settings(preset)
        off = (settings.hard_views, settings.occluders, settings.zoom, settings.blur, settings.jpeg)
        assert off == (0, 0, "1", 0, None)
    for bad in ({"zoom": "0:1"}, {"blur": 3}, {"jpeg": "0:50"}, {"hard_views": 1.5}, {"occluders": -1},
                {"elevation": "95"}, {"elevation": "10:5"}):  # fmt: skip
        with pytest.raises(InputError, match="--" + next(iter(bad)).replace("_", "-")):
            make_settings("best", **bad)
