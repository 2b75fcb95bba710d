import dataclasses
import itertools
import json
import threading
from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.core import batches
from cloak_core.core.detector.protocol import state_hash
from cloak_core.core.events import read_events
from cloak_core.core.losses import person_loss, total_variation
from cloak_core.core.settings import make_settings
from cloak_core.exchange.face_lists import read_colors, read_face_list, write_colors
from cloak_core.files.errors import InputError
from cloak_core.files.writing import lock
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.studies.trainings.training import train
from tests.core.fakes import (
    RedDetector,
    TinyDetector,
    back_logo,
    box_bodies,
    front_logo,
    noise_backgrounds,
    tiny_batcher,
)
from tests.core.fakes import tiny_settings as settings


def run(
    out: Path, detectors=None, logo=None, bodies=None, backgrounds=None, resume=False, on_event=None, query_prior=(),
    **changes,
):  # fmt: skip
    """A tiny training; whatever is not given is of a box before noise, by `TinyDetector`."""
    bodies = bodies or box_bodies()
    material = settings(**changes), bodies, logo or front_logo(bodies), detectors or [TinyDetector()]
    more = {"resume": resume, "on_event": on_event, "query_prior": query_prior}
    return train(*material, backgrounds or noise_backgrounds(), out, **more)


def files(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}


@pytest.mark.slow
def test_a_run_folder_is_complete(tmp_path):
    heard = []
    detector = TinyDetector()
    before = state_hash(detector)
    result = run(tmp_path / "run", [detector], on_event=heard.append)
    assert state_hash(detector) == before
    assert (result.step, result.steps, result.stopped) == (6, 6, "")
    folder = tmp_path / "run"
    assert files(folder) == {
        ".lock", "config.json", "material.npz", "logo.npy", "logo.json", "events.jsonl", "colors.npy",
        "checkpoint/step-00000004/state.json", "checkpoint/step-00000004/state.safetensors",
        "checkpoint/step-00000006/state.json", "checkpoint/step-00000006/state.safetensors",
        "previews/step-00000003.png", "previews/step-00000006.png",
    }  # fmt: skip
    bodies = box_bodies()
    config = json.loads((folder / "config.json").read_text())
    assert config["topology"] == bodies.topology
    told = {"spec": "tiny:0", "name": "tiny", "sha256": before, "precision": "float32", "compiled": False}
    told |= {"operating_point": 0.5, "source": {"spec": "tiny:0"}, "packages": {}}
    assert config["detectors"] == [told]
    assert config["settings"]["steps"] == 6
    assert (read_face_list(folder / "logo.npy", bodies).ids == front_logo(bodies).face_ids).all()
    assert np.array_equal(read_colors(folder / "colors.npy", 16), result.colors)
    assert read_events(folder / "events.jsonl") == heard
    assert [e["type"] for e in heard][:2] == ["start", "step"] and heard[-1]["outcome"] == "done"
    steps = [e for e in heard if e["type"] == "step"]
    assert [e["step"] for e in steps] == [1, 2, 3, 4, 5, 6]
    for event in steps:
        assert event["loss"] == pytest.approx(event["disappearance"] + 2.5 * event["tv"], abs=1e-6)
        assert 0 <= event["success"] <= 1
    times = [e["time"] for e in heard]
    assert times == sorted(times)
    assert result.record()["loss"] == steps[-1]["loss"] and "stopped" not in result.record()


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["paper", "reference", "best"])
def test_training_lowers_the_loss(tmp_path, preset):
    small = {"steps": 30, "batch": 4, "size": 64, "translation": 5, "samples": 1, "angles": "0"}
    # An epoch is one image here, so the paper's decay would end learning after ten.
    chosen = make_settings(preset, **small, lr=3, schedule="constant", tv_weight=0)
    heard = []
    bodies = box_bodies()
    night = Backgrounds(["night"], lambda index, height, width: np.zeros((height, width, 3), np.uint8))
    train(chosen, bodies, front_logo(bodies), [RedDetector()], night, tmp_path / "run", on_event=heard.append)
    losses = [e["loss"] for e in heard if e["type"] == "step"]
    assert np.mean(losses[-10:]) < 0.9 * np.mean(losses[:10])


# --- bad input -------------------------------------------------------------------------------------------------------


def test_nothing_is_written_before_a_run_can_begin(tmp_path):
    bodies = box_bodies()
    out = tmp_path / "run"
    with pytest.raises(InputError, match="none of its 16 faces is seen from the training angles -10,10"):
        run(out, logo=back_logo(bodies))
    far = dataclasses.replace(bodies, vertices=bodies.vertices * 1000)
    with pytest.raises(InputError, match=r"faces is seen .*; the body is [0-9.e+]+ m large, people are about 1\.7"):
        train(settings(), far, front_logo(far), [TinyDetector()], noise_backgrounds(), out)
    with pytest.raises(InputError, match="--detector"):
        train(settings(), bodies, front_logo(bodies), [], noise_backgrounds(), out)
    black_box = TinyDetector()
    black_box.differentiable = False
    with pytest.raises(InputError, match="tiny:0: gives no gradients"):
        run(out, [black_box])
    foreign = dataclasses.replace(front_logo(bodies), topology="0" * 64)
    with pytest.raises(InputError, match="topology 0000"):
        run(out, logo=foreign)
    with pytest.raises(InputError, match="--device"):
        run(out, device="gpu")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_an_existing_folder_is_left_alone(tmp_path):
    run(tmp_path / "run", steps=1)
    before = {name: (tmp_path / "run" / name).read_bytes() for name in files(tmp_path / "run")}
    with pytest.raises(InputError, match="exists already"):
        run(tmp_path / "run")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    for resume in (False, True):
        with pytest.raises(InputError, match=r"other: (exists already|not a folder of training)"):
            run(tmp_path / "other", resume=resume)
    assert [path.name for path in (tmp_path / "other").iterdir()] == ["notes.txt"]
    assert before == {name: (tmp_path / "run" / name).read_bytes() for name in files(tmp_path / "run")}


@pytest.mark.slow
def test_two_runs_in_one_folder(tmp_path):
    """tests/core/test_reliability.py starts four at once."""
    run(tmp_path / "run", steps=1)
    with lock(tmp_path / "run" / ".lock"), pytest.raises(InputError, match="another process is training"):
        run(tmp_path / "run", resume=True)


@pytest.mark.slow
def test_when_a_batch_is_built_changes_no_bit(tmp_path, monkeypatch):
    """Beside the detector, or between two steps."""
    scheme = {"steps": 8, "angles": "0..360", "distance": "2:2.5", "cutout": 0.3}
    found, threads = {}, {}
    build = batches.Batcher.batch

    def told(self: batches.Batcher, step: int, rank: int = 0, ranks: int = 1) -> batches.Batch:
        threads.setdefault(ahead, set()).add(threading.current_thread().name.partition("_")[0])
        return build(self, step, rank, ranks)

    monkeypatch.setattr(batches.Batcher, "batch", told)
    for ahead in (True, False):
        monkeypatch.setattr(batches, "looks_ahead", lambda device, ahead=ahead: ahead)
        found[ahead] = run(tmp_path / str(ahead), **scheme).colors
    assert threads == {True: {"MainThread", "batches"}, False: {"MainThread"}}
    assert np.array_equal(found[True], found[False])


@pytest.mark.slow
def test_a_run_goes_on_from_another_runs_colours_or_from_a_file(tmp_path):
    first = run(tmp_path / "first")
    close = {"steps": 1, "lr": 1e-6}
    for name, init in (("run", tmp_path / "first"), ("file", tmp_path / "first" / "colors.npy")):
        np.testing.assert_allclose(run(tmp_path / name, init=str(init), **close).colors, first.colors, atol=1e-4)
    assert np.abs(run(tmp_path / "anew", **close).colors - first.colors).max() > 0.01


@pytest.mark.slow
def test_resuming_needs_the_same_first_colours(tmp_path):
    write_colors(tmp_path / "c.npy", np.full((16, 3), 0.25))
    done = run(tmp_path / "run", init=str(tmp_path / "c.npy"))
    (tmp_path / "c.npy").rename(tmp_path / "moved.npy")
    again = run(tmp_path / "run", resume=True, init=str(tmp_path / "moved.npy"))
    assert np.array_equal(again.colors, done.colors)
    write_colors(tmp_path / "moved.npy", np.full((16, 3), 0.75))
    for init in (str(tmp_path / "moved.npy"), None):
        with pytest.raises(InputError, match=r"start(\.sha256)? = "):
            run(tmp_path / "run", resume=True, init=init)


def test_first_colours_that_do_not_fit(tmp_path):
    write_colors(tmp_path / "c.npy", np.zeros((3, 3)))
    run(tmp_path / "back", logo=back_logo(box_bodies()), angles="180", steps=1)
    (tmp_path / "empty").mkdir()
    for init, says in (
        ("c.npy", "colours for 3 faces, but the logo has 16"),
        ("back", "was trained on another logo"),
        ("empty", "not a run folder"),
        ("absent", "no such file"),
    ):
        with pytest.raises(InputError, match=says):
            run(tmp_path / "run", init=str(tmp_path / init))
    assert not (tmp_path / "run").exists()


def test_gradient_of_the_whole_chain_against_finite_differences():
    """Colours -> compositing with all augmentations -> detector -> loss, on the real step's objective."""
    logo, detector = front_logo(box_bodies()), TinyDetector()
    batch = tiny_batcher(settings(batch=2), logo).batch(0)
    edges, lengths = torch.from_numpy(logo.edges), torch.from_numpy(logo.edge_lengths).float()

    def objective(colors):
        loss = person_loss(detector(batch.images(colors)), "score").mean()
        return loss + 0.1 * total_variation(colors, edges, lengths)

    generator = torch.Generator().manual_seed(0)
    colors = (0.3 + 0.4 * torch.rand(16, 3, generator=generator)).requires_grad_()
    objective(colors).backward()
    assert (colors.grad != 0).all()
    for _ in range(5):
        direction = torch.randn(16, 3, generator=generator)
        with torch.no_grad():
            ends = [objective(colors + sign * 3e-3 * direction).double() for sign in (1, -1)]
        numeric = (ends[0] - ends[1]) / 6e-3
        assert numeric.item() == pytest.approx((colors.grad * direction).sum().item(), rel=0.03, abs=2e-4)


# --- what is seen of a run that goes on, and printable colours -------------------------------------------------------


@pytest.mark.slow
def test_the_latest_colours_are_shown_while_a_run_goes_on(tmp_path, monkeypatch):
    """Every LIVE_SECONDS, without a checkpoint; here after every step."""
    monkeypatch.setattr("cloak_core.core.training.LIVE_SECONDS", 0.0)
    shown = []

    def watch(event):
        path = tmp_path / "run" / "colors.npy"
        if event["type"] == "step" and path.exists():
            shown.append(read_colors(path, 16))
            assert not any((tmp_path / "run" / "checkpoint").iterdir())

    result = run(tmp_path / "run", on_event=watch, checkpoint_every=0)
    assert len(shown) == 5
    assert all(not np.array_equal(a, b) for a, b in itertools.pairwise([*shown, result.colors]))
