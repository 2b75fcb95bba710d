import json
import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import settings as runs
from hypothesis import strategies as st

from cloak_core.commands import train
from cloak_core.core.settings import (
    PRESETS,
    TrainSettings,
    make_settings,
    merge,
    settings_from_record,
    settings_record,
)
from cloak_core.core.settings.retired import RETIRED
from cloak_core.core.settings.values import Angles, Azimuths, Range
from cloak_core.files.errors import InputError

OLD_RUNS = Path(__file__).parents[1] / "old_versions" / "v0.1.0"


@pytest.mark.parametrize(
    ("spec", "value"),
    [
        ("0", Angles((0.0,))), ("-10:10:5", Angles((-10.0, -5.0, 0.0, 5.0, 10.0))), ("-1:1", Angles((-1.0, 0.0, 1.0))),
        ("-10,0,10", Angles((-10.0, 0.0, 10.0))), ("0:1:0.1", Angles(round(i / 10, 9) for i in range(11))),
        ("0:9:4", Angles((0.0, 4.0, 8.0))), ("2.2", Range(2.2, 2.2)), ("1.4:3", Range(1.4, 3.0)),
    ],
)  # fmt: skip
def test_angles_and_ranges(spec, value):
    assert type(value).parse(spec) == value


@pytest.mark.parametrize(
    ("kind", "specs"),
    [
        (Angles, "a|1:2:0|1:2:-1|2:1|1:2:3:4|1,2:3|nan|inf|0,0|1,,2|400|0:360:0.0001"),
        (Azimuths, "10..0|0..0|0..400|-200..200|0..|a..b|0..10..20"),
        (Range, "3:1.4|1:2:3|x|nan:1"),
    ],
)
def test_what_is_none_is_refused_in_its_words(kind, specs):
    for spec in specs.split("|"):
        with pytest.raises(ValueError, match=re.escape(spec)):
            kind.parse(spec)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("lr", math.nan), ("lr", 0.0), ("lr", -1.0), ("lr", math.inf), ("tv_weight", -0.1), ("tv_weight", math.nan),
        ("batch", 0), ("batch", -3), ("steps", 0), ("steps", -5), ("epochs", math.nan), ("epochs", 0.0),
        ("momentum", 1.0), ("noise", 2.0), ("noise", math.nan), ("size", 0), ("samples", 3), ("threads", 0),
        ("threshold", 1.0), ("threshold", math.nan), ("translation", -1), ("translation", 208), ("seed", -1),
        ("distance", "3:1"), ("distance", "0:1"), ("distance", "-2"), ("contrast", "1.2:0.8"), ("contrast", "-1:1"),
        ("brightness", "x"), ("angles", "5:1:1"), ("optimizer", "rmsprop"), ("loss", "x"), ("schedule", "linear"),
        ("initial", "blue"), ("device", None), ("elevation", 91.0), ("checkpoint_every", -1),
        ("elevation_jitter", 22.0), ("max_seconds", 0.0), ("optimizer", "none"), ("batch", 1.5),
        ("lr", "fast"), ("batch", True), ("preset", "mine"),
    ],
)  # fmt: skip
def test_bad_values_are_refused_by_name(name, value):
    length = {} if name == "epochs" else {"epochs": None, "steps": 10}
    with pytest.raises(InputError, match="--" + name.replace("_", "-")):
        settings_from_record(length | {name: value})


def test_ranges_of_azimuths():
    circle = Azimuths.parse("0..360")
    assert circle.starts == tuple(range(0, 360, 10)) and circle.width == 10 and circle.centers[0] == 5
    narrow = Azimuths.parse("-12..12")
    assert len(narrow.starts) == 3 and narrow.width == 8
    assert Azimuths.parse("-10:10:5").starts == Angles.parse("-10:10:5") and Azimuths.parse("0").width == 0


@pytest.mark.parametrize(
    ("name", "off", "on"),
    [("hard_views", 0.0, 0.5), ("occluders", 0, 2), ("zoom", "1", "0.8:1.2"), ("jpeg", None, "50:95"),
     ("photometric_on", "logo", "render"), ("reduce", "max", "topk"), ("wrinkles", 0.0, 0.02), ("tint", 0.0, 0.2),
     ("held_out", 0.0, 0.2), ("patience", 0, 5)],
)  # fmt: skip
def test_a_retired_option_is_read_when_off_and_refused_in_one_line_when_on(name, off, on):
    assert make_settings("best", **{name: off}) == make_settings("best")
    option = "--" + name.replace("_", "-")
    with pytest.raises(InputError, match=f"{option} {on}: this version has no such option") as refused:
        make_settings("best", **{name: on})
    assert "\n" not in str(refused.value)


def test_train_has_at_most_72_settings_and_none_that_is_retired():
    names = settings_record(make_settings("best")).keys() - {"preset"}
    assert len(names) <= 72 and not names & RETIRED.keys()


finite = st.floats(-300, 300, allow_nan=False).map(lambda x: round(x, 6) + 0.0)
ranges = st.tuples(finite, finite).map(lambda pair: Range(min(pair), max(pair)))
angles = st.lists(finite, min_size=1, max_size=6, unique=True).map(Angles)
sweeps = ranges.filter(lambda r: 0 < r.width <= 360)


@runs(max_examples=50)
@given(st.one_of(ranges, angles, st.one_of(angles, sweeps).map(Azimuths)))
def test_values_are_read_as_they_are_spelled(value):
    assert type(value).parse(str(value)) == value


@pytest.mark.slow
@runs(max_examples=40)
@given(
    st.fixed_dictionaries(
        {"preset": st.sampled_from(list(PRESETS))},
        optional={
            "angles": st.one_of(angles, sweeps).map(Azimuths).map(str),
            "elevation": ranges.filter(lambda r: -85 <= r.low and r.high <= 85).map(str),
            "contrast": ranges.filter(lambda r: r.low >= 0).map(str),
            "lr": st.floats(1e-9, 1e9),
            "noise": st.floats(0, 1),
            "steps": st.integers(1, 10_000_000),
            "samples": st.sampled_from([None, 1, 4, 16, 64]),
            "seed": st.integers(0, 2**63 - 1),
        },
    )
)
def test_a_record_through_json_is_the_same_settings(changes):
    settings = make_settings(**changes)
    record = json.loads(json.dumps(settings_record(settings)))
    assert settings_from_record(record) == settings
    assert {name: record[name] for name in changes} == changes


@pytest.mark.parametrize("run", ["done", "stopped"])
def test_records_of_the_first_version_are_read(run):
    record = json.loads((OLD_RUNS / run / "config.json").read_text())["settings"]
    now = settings_record(settings_from_record(record))
    changed = {name for name in record.keys() - RETIRED.keys() if now[name] != record[name]}
    assert changed <= {"distance"}  # "2.0:2.4" is spelled "2:2.4" now
    assert settings_from_record(record).views.distance == Range.parse(record["distance"])


def test_later_layers_win_and_steps_and_epochs_replace_each_other():
    merged = merge({"preset": "paper", "lr": 1, "epochs": 3}, {"lr": 2, "steps": 7})
    assert (merged["preset"], merged["lr"], merged["steps"], merged["epochs"]) == ("paper", 2, 7, None)
    assert merge({"preset": "paper"}, {"preset": "reference"})["momentum"] == 0.9
    assert merge({"epochs": 3})["steps"] is None and merge()["steps"] == 600
    with pytest.raises(InputError, match="--steps and --epochs"):
        settings_from_record(merge({"steps": 3, "epochs": 2}))


def from_command_line(tmp_path: Path, toml: str, *options: str) -> TrainSettings:
    from cloak_core import cli

    (tmp_path / "some.toml").write_text(toml)
    required = ["--scene", "s", "--logo", "l", "--out", "o", "--config", str(tmp_path / "some.toml")]
    command = cli.parse("train", [*required, *options])
    assert isinstance(command, train.Train)
    return command.settings


@pytest.mark.slow
@pytest.mark.parametrize(
    ("toml", "options", "wanted"),
    [
        ("momentum = 0.9", ["--optimizer", "sgd"], {"optimizer": "sgd", "momentum": 0.9, "schedule": "cosine"}),
        ("translation = 40", ["--size", "96", "--preset=reference"], {"size": 96, "translation": 40, "momentum": 0.9}),
        ('preset = "paper"', ["--steps", "9"], {"preset": "paper", "steps": 9, "epochs": None}),
        ("steps = 9", ["--epochs=2"], {"steps": None, "epochs": 2.0}),
        ("nps_weight = 1", ["--palette", "p.txt"], {"nps_weight": 1.0, "palette": "p.txt"}),
        ("lr = 1\nangles = 0", ["--brightness", "-0.2:0"], {"lr": 1.0, "angles": "0", "brightness": "-0.2:0"}),
    ],
)  # fmt: skip
def test_preset_file_and_flags_are_merged_before_they_are_checked(tmp_path, toml, options, wanted):
    record = settings_record(from_command_line(tmp_path, toml, *options))
    assert {name: record[name] for name in wanted} == wanted


@pytest.mark.slow
@pytest.mark.parametrize(
    ("toml", "options", "words"),
    [
        ("momentum = 0.9", [], "--momentum: Adam"),
        ("", ["--steps", "3", "--epochs", "2"], "--steps and --epochs"),
        ("colour = 1", [], "some.toml: --colour: no such setting"),
        ('optimizer = "rmsprop"', [], "some.toml: --optimizer: 'rmsprop' is not one of sgd, adam, mi"),
        ("", ["--optimizer", "rmsprop"], "train: --optimizer: 'rmsprop' is not one of adam, mi, sgd"),
        ("", ["--angles", "x"], "train: .*--angles.*'x'"),
        ("", ["--size", "3"], r"--size: 3 is not in \[16, 4096\]"),
    ],
)
def test_what_does_not_go_together_is_one_line_that_names_the_flag(tmp_path, toml, options, words):
    with pytest.raises(InputError, match=words) as refused:
        from_command_line(tmp_path, toml, *options)
    assert "\n" not in str(refused.value)
