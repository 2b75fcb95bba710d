"""The library as a notebook uses it: imported lightly, called twice and from a thread, the process left as it was."""

import contextlib
import ctypes
import json
import logging
import os
import shutil
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

import cloak_core
from cloak_core import cli
from cloak_core.exchange.face_lists import write_face_list
from cloak_core.exchange.scenes import write_scene
from tests.core.fakes import TinyDetector, box_bodies, front_logo, noise_backgrounds

HOW = {"steps": 4, "size": 64, "batch": 3, "translation": 5, "samples": 1, "angles": "-10,10", "preview_every": 0}
LOOK = {"angles": "-10,10", "size": 64, "shift": 5, "samples": 1, "images_per_view": 1, "resamples": 100, "bare": 2}


def train(out: Path, **changes: object) -> cloak_core.RunResult:
    bodies = box_bodies()
    return cloak_core.train(
        bodies, front_logo(bodies), [TinyDetector()], noise_backgrounds(), out=out, **(HOW | changes)
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> cloak_core.RunResult:
    return train(tmp_path_factory.mktemp("runs") / "a")


def in_a_thread(work) -> object:
    found = []
    thread = threading.Thread(target=lambda: found.append(work()))
    thread.start()
    thread.join()
    return found[0]


def test_importing_it_is_light_and_shows_its_names() -> None:
    """Neither torch nor numpy, nor anything outside the standard library."""
    script = "import sys; before = set(sys.modules); import cloak_core; dir(cloak_core); cloak_core.InputError\n"
    script += "print(*sorted({m.split('.')[0] for m in set(sys.modules) - before} - set(sys.stdlib_module_names)))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["cloak_core"]


OTHERS = {
    "training": ("core.evaluate", "studies.evaluate", "studies.film", "studies.report", "sources.photographs"),
    "evaluation": ("core.loop", "core.optimizer", "studies.trainings", "studies.hardening", "studies.card"),
}
"""What one call of the library loads nothing of."""


@pytest.mark.slow
@pytest.mark.parametrize("call", OTHERS)
def test_a_call_loads_nothing_that_only_another_needs(call: str) -> None:
    script = f"import sys, cloak_core.library.{call}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    loaded = [name.removeprefix("cloak_core.") for name in done.stdout.split()]
    assert f"library.{call}" in loaded and not [name for name in loaded if name.startswith(OTHERS[call])]


def test_every_public_name_is_there_and_documented() -> None:
    assert set(cloak_core.__all__) == set(cloak_core._PLACES) <= set(dir(cloak_core))
    for name in cloak_core.__all__:
        assert getattr(cloak_core, name).__doc__, name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = cloak_core.nothing


@pytest.mark.slow
def test_twice_in_a_process_and_from_a_thread_the_bits_are_the_same(run, tmp_path: Path) -> None:
    again = train(tmp_path / "b")
    threaded = in_a_thread(lambda: train(tmp_path / "c"))
    assert run.step == again.step == threaded.step == 4 and run.colors.shape == (16, 3)
    assert np.array_equal(run.colors, again.colors) and np.array_equal(run.colors, threaded.colors)
    assert not np.array_equal(run.colors, train(tmp_path / "d", seed=1).colors)
    assert np.array_equal(np.load(again.out / "colors.npy"), run.colors)


def state_of_the_process() -> dict[str, object]:
    loggers = [logging.getLogger(name) for name in (None, "cloak")]
    return {
        "handlers": [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)],
        "logging": [(logger.level, logger.handlers[:]) for logger in loggers],
        "seeds": (torch.get_rng_state().tolist(), repr(np.random.get_state())),
        "threads": (torch.get_num_threads(), in_a_thread(torch.get_num_threads)),
        "warnings": warnings.filters[:],
        "folder": os.getcwd(),
    }


@pytest.mark.slow
@pytest.mark.parametrize("work", ["train", "evaluate"])
def test_the_process_is_left_as_it_was(work: str, run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor is its C library told how to keep memory: a command may do that, a function may not."""
    load = ctypes.CDLL
    monkeypatch.setattr(
        "ctypes.CDLL", lambda name, *more, **named: load(name or pytest.fail("mallopt"), *more, **named)
    )
    numbers = torch.get_num_threads()
    torch.set_num_threads(numbers + 1)
    try:
        before = state_of_the_process()
        if work == "train":
            train(tmp_path / "a")
        else:
            cloak_core.evaluate(run, box_bodies(1), noise_backgrounds(2), [TinyDetector()], **LOOK)
        assert state_of_the_process() == before
    finally:
        torch.set_num_threads(numbers)


@pytest.mark.slow
def test_an_evaluation_reads_the_run(run) -> None:
    shown = []
    result = in_a_thread(
        lambda: cloak_core.evaluate(
            run.out, box_bodies(3), noise_backgrounds(3), {"mine": TinyDetector()},
            on_progress=lambda done, total: shown.append((done, total)), **LOOK,
        )
    )  # fmt: skip
    assert result["detectors"]["mine"]["logo"]["n"] == 6 and 0 <= result["detectors"]["mine"]["logo"]["success"] <= 1
    assert result["white_box"] == {"mine": True}
    assert shown[-1][0] == shown[-1][1] and (run.out / "evaluation" / "summary.json").exists()


@pytest.mark.slow
def test_what_is_given_by_name_is_recorded_and_the_command_line_does_the_same(tmp_path: Path, capfd) -> None:
    bodies = box_bodies()
    write_scene(tmp_path / "scene", bodies)
    write_face_list(tmp_path / "logo.npy", front_logo(bodies).face_ids, bodies.topology)
    names = str(tmp_path / "scene"), str(tmp_path / "logo.npy"), "procedural:train:4"
    ours = cloak_core.train(*names[:2], ["builtin@64"], names[2], out=tmp_path / "ours", **HOW)
    words = [f"--{key.replace('_', '-')}={value}" for key, value in HOW.items()]
    command = ["train", "--scene", names[0], "--logo", names[1], "--backgrounds", names[2], "--detector", "builtin@64"]
    with pytest.raises(SystemExit) as end:
        cli.main([*command, *words, "--out", str(tmp_path / "theirs"), "--json"])
    assert not end.value.code, capfd.readouterr().err
    assert np.array_equal(np.load(tmp_path / "theirs" / "colors.npy"), ours.colors)
    records = [json.loads((tmp_path / name / "config.json").read_text()) for name in ("ours", "theirs")]
    assert (
        records[0]["inputs"] == records[1]["inputs"] == dict(zip(("scene", "logo", "backgrounds"), names, strict=True))
    )


@contextlib.contextmanager
def double_precision() -> Iterator[None]:
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


SURROUNDINGS = {
    "no_grad": torch.no_grad,
    "inference_mode": torch.inference_mode,
    "autocast": lambda: torch.autocast("cpu", torch.bfloat16),
    "float64": double_precision,
    "another device": lambda: torch.device("meta"),
}


def look(run: cloak_core.RunResult) -> dict:
    shutil.rmtree(run.out / "evaluation", ignore_errors=True)
    return cloak_core.evaluate(run, box_bodies(), noise_backgrounds(3), "builtin@64", **LOOK)["detectors"]


@pytest.fixture(scope="module")
def seen(run: cloak_core.RunResult) -> dict:
    return look(run)


@pytest.mark.slow
@pytest.mark.parametrize("name", SURROUNDINGS)
def test_what_surrounds_a_call_changes_no_bit(name: str, run, seen, tmp_path: Path) -> None:
    bodies, outside = box_bodies(), TinyDetector()
    train_here = partial(cloak_core.train, bodies, front_logo(bodies), backgrounds=noise_backgrounds(), **HOW)
    with SURROUNDINGS[name]():
        before = torch.get_default_dtype(), torch.is_inference_mode_enabled(), torch.is_autocast_enabled("cpu")
        assert np.array_equal(train_here(detectors=outside, out=tmp_path / "a").colors, run.colors)
        assert look(run) == seen
        if name != "another device":  # where no module has any numbers
            assert train_here(detectors=[TinyDetector(), Mine()], out=tmp_path / "b").step == 4
        assert (
            torch.get_default_dtype(),
            torch.is_inference_mode_enabled(),
            torch.is_autocast_enabled("cpu"),
        ) == before


def test_logos_from_files_and_regions(tmp_path: Path) -> None:
    bodies = cloak_core.load_scene("sample:train[0]")
    logo = cloak_core.load_logo(bodies, region="chest+thighs")
    write_face_list(tmp_path / "logo.npy", logo.face_ids, bodies.topology)
    assert np.array_equal(cloak_core.load_logo(bodies, tmp_path / "logo.npy").face_ids, logo.face_ids)
    with pytest.raises(TypeError, match="either the path of a face list, or region="):
        cloak_core.load_logo(bodies)
    with pytest.raises(cloak_core.InputError, match="made for topology"):
        cloak_core.load_logo(box_bodies(), tmp_path / "logo.npy")


def test_bad_input_is_said_in_one_line(run, tmp_path: Path) -> None:
    with pytest.raises(cloak_core.InputError, match="exists"):
        train(run.out)
    with pytest.raises(cloak_core.InputError, match="--stepz: no such setting"):
        train(tmp_path / "x", stepz=3)
    with pytest.raises(TypeError, match="settings are given: change lr there"):
        cloak_core.train("sample", "x.npy", out=tmp_path / "x", settings=cloak_core.make_settings(), lr=1)
    with pytest.raises(cloak_core.InputError, match="not a run folder"):
        cloak_core.evaluate(tmp_path, box_bodies(), noise_backgrounds(1))
    with pytest.raises(cloak_core.InputError, match="--scene: say what to evaluate on"):
        cloak_core.evaluate(run, detectors=[TinyDetector()])


class Mine(torch.nn.Module):
    """A researcher's module: it takes images and returns boxes and scores."""

    def __init__(self) -> None:
        super().__init__()
        self.weights = torch.nn.Parameter(torch.tensor([3.0, -2.0, 1.0]))

    def forward(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        height, width = images.shape[2:]
        boxes = images.new_tensor([0.0, 0.0, width, height]).expand(len(images), 1, 4)
        return boxes, torch.sigmoid(images.mean(dim=(2, 3)) @ self.weights)[:, None]


def brightness(picture: np.ndarray) -> tuple[list, list]:
    """A black box on pictures, as somebody's service is one."""
    assert picture.dtype == np.uint8 and picture.shape[2] == 3
    return [[0, 0, picture.shape[1], picture.shape[0]]], [float(picture.mean()) / 255]


@pytest.mark.slow
def test_modules_and_functions_are_detectors(tmp_path: Path) -> None:
    module, bodies = Mine().train(), box_bodies()
    how = {"out": tmp_path / "run", **HOW}
    trained = cloak_core.train(bodies, front_logo(bodies), [module, Mine()], noise_backgrounds(), **how)
    assert trained.step == 4
    assert module.training and module.weights.requires_grad, "the caller's module stays as it was"
    recorded = json.loads((tmp_path / "run" / "config.json").read_text())["detectors"]
    assert [record["spec"] for record in recorded] == ["Mine", "Mine-2"]
    judges = [module, brightness]
    figures = cloak_core.evaluate(trained, bodies, noise_backgrounds(3), judges, **LOOK)
    assert figures["white_box"] == {"Mine": True, "brightness": False}
    frame = figures.to_frame()
    assert set(frame["detector"]) == {"Mine", "brightness"} and {"logo", "clothing"} <= set(frame["worn"])
    assert frame["success"].between(0, 1).all() and (frame["low"] <= frame["high"]).all()
    json.dumps(figures)
    with pytest.raises(cloak_core.InputError, match="trained against Mine, an object of a program: give it again"):
        cloak_core.evaluate(trained, bodies, noise_backgrounds(3))
    with pytest.raises(cloak_core.InputError, match=r"detectors: int '3' is no detector: give a module, a function"):
        cloak_core.evaluate(trained, bodies, noise_backgrounds(3), [3])
    with pytest.raises(cloak_core.InputError, match="brightness: gives no gradients"):
        cloak_core.train(bodies, front_logo(bodies), brightness, noise_backgrounds(), **how | {"out": tmp_path / "x"})


def test_a_module_that_returns_something_else_is_named() -> None:
    with pytest.raises(cloak_core.InputError, match=r"Linear: .*must return \(boxes, scores\)"):
        cloak_core.as_detector(torch.nn.Linear(3, 3))(torch.rand(1, 3, 3, 3))


@pytest.mark.slow
def test_a_listener_that_returns_true_ends_the_run(tmp_path: Path) -> None:
    heard = []

    def listener(event: dict) -> bool:
        heard.append(event["type"])
        return event["type"] == "step" and event["step"] == 2

    result = train(tmp_path / "run", on_event=listener)
    assert result.step == 2 and result.stopped and "step" in heard
    assert train(tmp_path / "run", resume=True).step == 4
