"""Run folders that strangers made: one clear line, nothing executed, nothing written elsewhere."""

import json
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cloak_core.core.checkpoints import Checkpoint, save_checkpoint
from cloak_core.core.settings import make_settings, settings_from_record, settings_record
from cloak_core.files.errors import InputError
from tests.core.test_training import run


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained") / "run"
    run(folder)
    return folder


@pytest.fixture
def finished(trained, tmp_path):
    return Path(shutil.copytree(trained, tmp_path / "run"))


def _config(change):
    def damage(folder: Path) -> None:
        record = json.loads((folder / "config.json").read_text())
        change(record)
        (folder / "config.json").write_text(json.dumps(record))

    return damage


def _symlink(name: str):
    def damage(folder: Path) -> None:
        elsewhere = folder.parent / "elsewhere"
        elsewhere.mkdir()
        (elsewhere / ".step-mine").mkdir()
        (folder / name).rename(folder.parent / "moved")
        (folder / name).symlink_to(elsewhere)

    return damage


def _as_file(folder: Path) -> None:
    (folder / "previews").rename(folder.parent / "moved")
    (folder / "previews").write_text("")


@pytest.mark.slow
@pytest.mark.parametrize(
    "damage",
    [
        lambda folder: (folder / "config.json").unlink(),
        lambda folder: (folder / "config.json").write_text("{"),
        lambda folder: (folder / "config.json").write_text("[" * 100_000),
        lambda folder: (folder / "config.json").write_bytes(pickle.dumps({})),
        lambda folder: (folder / "config.json").write_text("{}"),
        _config(lambda record: record.update(settings=[])),
        _config(lambda record: record.update(settings=None)),
        _config(lambda record: record["settings"].update(lr="NaN")),
        _config(lambda record: record["scene"].update(sha256="0" * 64)),
        _config(lambda record: record.update(detectors={"spec": "tiny:0"})),
        _symlink("checkpoint"),
        _symlink("previews"),
        _as_file,
    ],
)
def test_a_run_folder_that_is_not_ours_is_refused(finished, damage):
    damage(finished)
    with pytest.raises(InputError) as refused:
        run(finished, resume=True)
    assert "\n" not in str(refused.value) and "run" in str(refused.value)
    elsewhere = finished.parent / "elsewhere"
    assert not elsewhere.exists() or [p.name for p in elsewhere.iterdir()] == [".step-mine"]


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@pytest.mark.slow
@settings(max_examples=40)
@given(st.sampled_from(list(settings_record(make_settings("best")))), json_values)
def test_any_value_of_any_setting_is_taken_or_refused_by_name(name, value):
    record = {"epochs": None, "steps": 5} | {name: value}
    try:
        settings_from_record(record)
    except InputError as error:
        named = "--" + name.replace("_", "-")
        assert named in str(error) or name in ("size", "steps", "epochs"), error
        assert "\n" not in str(error).replace(repr(value), "")


def test_colours_of_another_run_are_named(finished):
    save_checkpoint(finished / "checkpoint", Checkpoint(99, 1.0, {"parameter": torch.zeros(2, 3)}))
    with pytest.raises(InputError, match="holds another run's state"):
        run(finished, resume=True)
    assert np.load(finished / "colors.npy").shape == (16, 3)
