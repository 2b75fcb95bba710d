"""A detector learns to see through cloaks, goes on where it was stopped, and is written as what it was."""

import itertools
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.commands.assess import Assess
from cloak_core.commands.harden import Harden
from cloak_core.core.detector.protocol import state_hash
from cloak_core.core.geometry import face_areas, face_centres
from cloak_core.core.logo import region_mask
from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.paint import compose
from cloak_core.core.stopping import StopRequest
from cloak_core.detectors.darknet.layers import BatchNorm
from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.fits import fit_people
from cloak_core.sources.photographs.people import load_people
from cloak_core.studies.hardening.decoys import TEXTURE
from cloak_core.studies.hardening.hardening import Hardening, HardenResult, harden, rate
from cloak_core.studies.hardening.logos import JUDGED, draw_colors, draw_logo
from cloak_core.studies.hardening.pictures import Pictures
from cloak_core.studies.hardening.pool import Given, Pool
from cloak_core.studies.hardening.settings import HardenSettings
from cloak_core.studies.hardening.student import NAME, Student
from cloak_core.studies.hardening.students import open_student
from tests.core.fakes import box_bodies, front_logo, noise_backgrounds
from tests.detectors.helpers import images, write_tiny
from tests.schemas import validate
from tests.sources.photographs.made_people import write_people

FEW = {
    "steps": 4,
    "batch": 2,
    "pictures": 1,
    "decoys": 1,
    "cloaks": 2,
    "life": 2,
    "attack_steps": 1,
    "finished": 0,
    "size": 64,
}


@pytest.fixture
def student(tmp_path: Path) -> Student:
    return open_student(write_tiny(tmp_path))


def hardened(student: Student, out: Path, resume: bool = False, **changes: object) -> HardenResult:
    settings = HardenSettings(**(FEW | changes))
    return harden(settings, student, box_bodies(), noise_backgrounds(), out, resume=resume)


def test_writes_what_loads_as_the_same_kind_and_another_network(student: Student, tmp_path: Path) -> None:
    result = hardened(student, tmp_path / "out")
    assert result.spec == f"darknet:{tmp_path}/out/{NAME}.cfg:{tmp_path}/out/{NAME}.weights"
    before, after = load_detector(student.spec), load_detector(result.spec)
    assert not torch.equal(before(images(2)).scores, after(images(2)).scores)
    torch.testing.assert_close(before(images(2)).scores, after(images(2)).scores, atol=0.2, rtol=0)
    licence = (tmp_path / "out" / f"{NAME}.licence.txt").read_text()
    assert student.spec in licence and "their authors'" in licence
    assert (tmp_path / "out" / f"{NAME}.names").read_text().split() == ["person"]


@pytest.mark.slow
def test_the_teacher_stays_what_it_was_and_batch_norm_keeps_its_statistics(student: Student, tmp_path: Path) -> None:
    teacher = state_hash(student.teacher)
    statistics = [m.running_mean.clone() for m in student.network.modules() if isinstance(m, BatchNorm)]
    hardened(student, tmp_path / "out")
    assert state_hash(student.teacher) == teacher
    after = [m.running_mean for m in student.network.modules() if isinstance(m, BatchNorm)]
    assert statistics and all(torch.equal(*pair) for pair in zip(statistics, after, strict=True))


@pytest.mark.slow
def test_a_stopped_hardening_goes_on_to_the_same_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = write_tiny(tmp_path)
    whole = hardened(open_student(spec), tmp_path / "whole")
    asked = []
    monkeypatch.setattr(
        StopRequest, "reason", lambda *_: (asked.append(1), "cancel file" if len(asked) == 3 else "")[1]
    )
    part = hardened(open_student(spec), tmp_path / "part")
    assert (part.stopped, part.step) == ("cancel file", 3)
    rest = hardened(open_student(spec), tmp_path / "part", resume=True)
    assert (rest.stopped, rest.step) == ("", 4)
    assert state_hash(load_detector(rest.spec)) == state_hash(load_detector(whole.spec))
    types = [json.loads(line)["type"] for line in (tmp_path / "part" / "events.jsonl").read_text().splitlines()]
    assert types == ["start", *["step"] * 3, "resume", "step", "end"]


def test_a_cancel_file_and_a_time_budget_end_it_in_order(student: Student, tmp_path: Path) -> None:
    started = time.monotonic()
    result = hardened(student, tmp_path / "out", steps=1000, max_seconds=0.01)
    assert (result.stopped, result.step) == ("time budget", 1)
    assert time.monotonic() - started < 60
    assert load_detector(result.spec)


@pytest.mark.parametrize(
    ("changes", "message"),
    [({}, "exists already"), ({"resume": True, "lr": 0.1}, "begun with other --lr = 0.001, not 0.1")],
)
def test_a_folder_that_is_there_is_not_taken_for_another(
    student: Student, tmp_path: Path, changes: dict, message: str
) -> None:
    hardened(student, tmp_path / "out", steps=1)
    with pytest.raises(InputError, match=message):
        hardened(student, tmp_path / "out", **({"steps": 1} | changes))


def test_a_folder_of_an_earlier_version_says_why_it_does_not_go_on(student: Student, tmp_path: Path) -> None:
    hardened(student, tmp_path / "out", steps=1)
    config = json.loads((tmp_path / "out" / "config.json").read_text())
    (tmp_path / "out" / "config.json").write_text(json.dumps(config | {"format": "cloak hardening 1"}))
    with pytest.raises(InputError, match="earlier version, which drew other cloaks; begin in another --out"):
        hardened(student, tmp_path / "out", resume=True, steps=1)


def test_cloaks_finished_before_the_first_update_are_kept_by_a_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cloak_core.studies.hardening.pool.FINISH", 2)
    finish, finished = Pool.finish_one, []
    monkeypatch.setattr(Pool, "finish_one", lambda pool: (finish(pool), finished.append(1)))
    spec = write_tiny(tmp_path)
    whole = hardened(open_student(spec), tmp_path / "whole", steps=1, finished=2)
    with monkeypatch.context() as patched:
        patched.setattr(StopRequest, "reason", lambda *_: "cancel file")
        assert hardened(open_student(spec), tmp_path / "part", steps=1, finished=2).step == 0
    rest = hardened(open_student(spec), tmp_path / "part", resume=True, steps=1, finished=2)
    assert len(finished) == 2 + 2 and rest.step == 1
    assert state_hash(load_detector(rest.spec)) == state_hash(load_detector(whole.spec))


def test_a_folder_begun_before_a_setting_was_there_goes_on(student: Student, tmp_path: Path) -> None:
    hardened(student, tmp_path / "out", steps=1)
    config = json.loads((tmp_path / "out" / "config.json").read_text())
    for name in ("perturbation", "replays", "cloths"):
        del config["settings"][name]
    (tmp_path / "out" / "config.json").write_text(json.dumps(config))
    assert hardened(student, tmp_path / "out", resume=True, steps=1).step == 1
    with pytest.raises(InputError, match="begun with other --cloths"):
        hardened(student, tmp_path / "out", resume=True, steps=1, cloths=0.5)


def test_cloaked_images_count_as_much_as_asked_in_the_last_fifth(student: Student, tmp_path: Path) -> None:
    hardened(student, tmp_path / "out", steps=5, cloaked_weight=3.0)
    told = [json.loads(line) for line in (tmp_path / "out" / "events.jsonl").read_text().splitlines()]
    steps = [event for event in told if event["type"] == "step"]
    for weight, step in ((1, steps[3]), (3, steps[4])):
        wanted = weight * 2 * step["cloaked"] + 2 * step["clean"] + step["pictures"] + step["decoys"]
        assert step["cloaked"] != step["clean"]
        assert step["loss"] == pytest.approx(wanted / (weight * 2 + 2 + 1 + 1), rel=1e-5)


def test_the_learning_rate_falls_twice() -> None:
    rates = [rate(step, 100) for step in range(100)]
    assert max(rates) == rates[4] == 1.0 and rates[79] < 0.01
    assert rates[80] == 0.5 and rates[99] < 0.01 and sorted(rates[80:], reverse=True) == rates[80:]
    assert 0 < rate(0, 1) <= 1


def test_what_cannot_be_trained_is_refused_in_one_line() -> None:
    words = (
        r"cannot train 'openvino', only builtin, darknet, onnx, python, torchvision and ultralytics; harden the weights"
    )
    with pytest.raises(InputError, match=words):
        open_student("openvino:net.xml")
    with pytest.raises(InputError, match=r"net.onnx: no such file"):
        open_student("net.onnx")
    with pytest.raises(InputError, match="cannot train 'jpeg=75', only builtin"):
        open_student("jpeg=75:builtin")


def test_a_hardened_built_in_detector_is_a_built_in_one(tmp_path: Path) -> None:
    student = open_student("builtin@96")
    spec = student.write(student.network.state_dict(), tmp_path, 0)
    assert spec == f"builtin:{tmp_path}/{NAME}.weights@96"
    again, first = load_detector(spec), load_detector("builtin@96")
    torch.testing.assert_close(again(images(1)).scores, first(images(1)).scores)
    assert (again.operating_point, again.operating_point_assumed) == (0.5, False)
    assert "Apache-2.0" in (tmp_path / f"{NAME}.licence.txt").read_text()


@pytest.mark.slow
def test_the_epsilon_of_the_original_darknet_moves_into_the_scale(tmp_path: Path) -> None:
    spec = write_tiny(tmp_path)
    weights = tmp_path / "tiny.weights"
    data = bytearray(weights.read_bytes())
    data[8:12] = (0).to_bytes(4, "little")  # the original's revision
    weights.write_bytes(bytes(data))
    student = open_student(spec)
    again = student.write(student.network.state_dict(), tmp_path, 0)
    torch.testing.assert_close(load_detector(again)(images(2)).scores, load_detector(spec)(images(2)).scores)


def test_an_attack_moves_the_colours_of_the_cloak_whose_turn_it_is(
    student: Student, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cloak_core.studies.hardening.pool.draw_logo", lambda bodies, rng: front_logo(bodies).face_ids)
    settings = HardenSettings(**(FEW | {"attack_steps": 2}))
    pool = Pool(settings, box_bodies(), noise_backgrounds(), student.detector)
    first, second = pool.cloak(0), pool.cloak(1)
    before = [cloak.optimizer.colors().detach().clone() for cloak in (first, second)]
    assert pool.attack(0) is not None
    assert not torch.equal(first.optimizer.colors(), before[0])
    assert torch.equal(second.optimizer.colors(), before[1])


def test_a_pair_differs_where_the_logo_is(student: Student) -> None:
    pool = Pool(HardenSettings(**FEW), box_bodies(), noise_backgrounds(), student.detector)
    pair = pool.pair(0)
    apart = (pair.cloaked - pair.clean).abs().amax((1, 2, 3))
    assert pair.cloaked.shape == (2, 3, 64, 64)
    assert float(apart.max()) > 0.05
    assert Pictures(pool, None, student.detector).plain(0).shape == (1, 3, 64, 64)


@pytest.mark.slow
def test_people_in_photographs_wear_the_cloaks_and_are_clean_in_their_own_clothes(
    student: Student, tmp_path: Path
) -> None:
    people = load_people(write_people(tmp_path, 2))
    fits, bodies = fit_people(people), sample_bodies("train")
    settings = HardenSettings(**(FEW | {"batch": 4, "people_share": 1.0, "size": 96}))
    pool = Pool(settings, bodies, noise_backgrounds(), student.detector, people=fits)
    pair, cloak = pool.pair(0), pool.cloak(0)
    draws = cloak.batcher.sampler.draw(settings.attack_steps)
    nothing = torch.zeros(len(cloak.logo), 3)
    for image, (shown, seed) in zip(pair.clean, draws.views(), strict=True):
        photograph = compose([cloak.batcher.source.undressed(shown, seed)], nothing, torch.zeros(1, 3, 96, 96))
        torch.testing.assert_close(image, photograph[0])
    worn = (pair.cloaked - pair.clean).abs().amax(1) > 0.05
    assert 0.001 < worn.float().mean() < 0.5, "only the person changes"
    with pytest.raises(InputError, match="topology"):
        harden(settings, student, box_bodies(), noise_backgrounds(), tmp_path / "box", people=people)
    few, given = replace(settings, steps=2), (student, bodies, noise_backgrounds(), tmp_path / "out")
    assert harden(few, *given, people=people).step == 2
    with pytest.raises(InputError, match="begun with other people"):
        harden(few, *given, resume=True)


def test_cloaks_die_one_after_the_other_and_given_ones_are_among_them(student: Student) -> None:
    logo = front_logo(box_bodies())
    given = Given(logo, np.full((len(logo), 3), 0.25, np.float32))
    settings = HardenSettings(**(FEW | {"cloaks": 4, "life": 4}))
    pool = Pool(settings, box_bodies(), noise_backgrounds(), student.detector, [given])
    generations = [pool.place(turn)[1] for turn in range(32)]
    rounds = [generations[turn : turn + 4] for turn in range(0, 32, 4)]
    changes = [sum(a != b for a, b in zip(*pair, strict=True)) for pair in itertools.pairwise(rounds)]
    assert changes == [1] * 7
    colors = [pool.cloak(turn).optimizer.colors() for turn in range(32)]
    shares = [bool((c == 0.25).all()) for c in colors]
    assert 0 < sum(shares) < len(shares)


def test_a_cloaks_learning_rate_falls_over_its_life(student: Student, monkeypatch: pytest.MonkeyPatch) -> None:
    rates = []
    monkeypatch.setattr(ColorOptimizer, "update", lambda _, rate: rates.append(rate))
    pool = Pool(HardenSettings(**(FEW | {"cloaks": 1, "life": 3})), box_bodies(), noise_backgrounds(), student.detector)
    for turn in range(6):
        pool.attack(turn)
    first, second = rates[:3], rates[3:]
    assert first[0] == pool.settings.attack_lr > first[1] > first[2] > 0 and first == second
    pool.finish_one()
    assert rates[6] == pool.settings.attack_lr and rates[-1] < 0.02 * rates[6]


def test_each_slot_in_turn_has_a_cloak_over_the_whole_body(student: Student) -> None:
    pool = Pool(HardenSettings(**(FEW | {"cloaks": 4})), box_bodies(), noise_backgrounds(), student.detector)
    for generation in range(8):
        whole = [slot for slot in range(4) if len(pool._new(slot, generation).logo) == box_bodies().face_count]
        assert (3 - generation) % 4 in whole


def test_every_other_cloak_is_seen_from_one_side(student: Student) -> None:
    pool = Pool(HardenSettings(**FEW), box_bodies(), noise_backgrounds(), student.detector)
    seen = [np.exp(1j * np.radians(pool._train_settings(slot).views.angles.of)) for slot in range(4)]
    spread = [np.abs(np.angle(towards / towards[0])).max() for towards in seen]
    assert max(spread[0::2]) <= np.radians(30.001) and min(spread[1::2]) > np.radians(120)
    assert abs(np.angle(seen[0].mean())) < np.radians(15)


@pytest.mark.long
def test_drawn_logos_are_of_many_kinds_and_none_is_one_that_judges() -> None:
    bodies, rng = sample_bodies("train"), np.random.default_rng(0)
    areas = face_areas(bodies)
    judged = [np.any([region_mask(bodies, name) for name in names], 0) for names in JUDGED]
    shares = []
    for _ in range(60):
        chosen = np.isin(np.arange(bodies.face_count), draw_logo(bodies, rng))
        shares.append(areas[chosen].sum() / areas.sum())
        for mask in judged:
            assert areas[chosen & mask].sum() <= 0.7 * areas[chosen | mask].sum()
    assert 0.05 <= min(shares) and 0.7 < max(shares) <= 1
    assert np.std(shares) > 0.05


def test_first_colours_are_colours() -> None:
    centres = face_centres(box_bodies()).astype(np.float32)
    for seed in range(12):
        colors = draw_colors(centres, np.random.default_rng(seed))
        assert colors.shape == centres.shape and colors.dtype == np.float32
        assert 0 <= colors.min() and colors.max() <= 1


def test_the_command_names_a_folder_that_is_there(tmp_path: Path) -> None:
    (tmp_path / "something").touch()
    with pytest.raises(InputError, match="exists already"):
        Harden(spec="builtin", out=tmp_path).run()


@pytest.mark.parametrize("asked", [True, False])
def test_the_command_gives_the_cards_before_and_after_or_says_why_not(
    asked: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = write_tiny(tmp_path)
    monkeypatch.setattr("cloak_core.commands.harden.load_scene", lambda _: box_bodies())
    made: list[tuple[str, ...]] = []

    def assess(command: Assess) -> dict:
        made.append(command.specs)
        return {"cards": {one: {"spec": one} for one in command.specs}, "files": []}

    monkeypatch.setattr(Assess, "run", assess)
    few = HardenSettings(**(FEW | {"steps": 1}))
    told = Harden(spec=spec, out=tmp_path / "out", backgrounds="procedural:train:2", assess=asked, settings=few).run()
    if asked:
        assert made == [(spec, told["spec"])]
        assert (told["before"], told["after"]) == ({"spec": spec}, {"spec": told["spec"]})
    else:
        assert not made and (told["before"], told["after"]) == (None, None)
        assert "--no-assess" in told["no_cards"]
        validate("harden", json.dumps(told))


def test_a_new_cloak_goes_on_where_the_slots_earlier_one_ended(
    student: Student, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cloak_core.studies.hardening.pool.draw_logo", lambda bodies, rng: front_logo(bodies).face_ids)
    monkeypatch.setattr("cloak_core.studies.hardening.pool.GOES_ON", 1.0)
    monkeypatch.setattr("cloak_core.studies.hardening.pool.WHOLE_BODY", 100)
    pool = Pool(HardenSettings(**(FEW | {"cloaks": 1})), box_bodies(), noise_backgrounds(), student.detector)
    first = pool.cloak(0)
    pool.attack(0)
    ended, second = first.optimizer.colors().detach().clone(), pool.cloak(2)
    assert second is not first
    assert torch.equal(second.optimizer.colors(), ended)
    again = Pool(HardenSettings(**(FEW | {"cloaks": 1})), box_bodies(), noise_backgrounds(), student.detector)
    again.load(3, pool.state())
    assert torch.equal(again.skins[0], pool.skins[0])


def test_decoys_show_cloaks_that_were_trained_to_their_end_and_those_whose_life_is_over(
    student: Student, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cloak_core.studies.hardening.pool.FINISH", 3)
    monkeypatch.setattr("cloak_core.studies.hardening.pool.KEPT", 1)
    settings = HardenSettings(**(FEW | {"cloaks": 1, "finished": 2}))
    pool = Pool(settings, box_bodies(), noise_backgrounds(), student.detector)
    pictures = Pictures(pool, None, student.detector)
    shown = lambda: {texture.tobytes() for texture in itertools.islice(pictures.textures(np.random.default_rng(0)), 40)}
    pool.finish_one()
    pool.finish_one()
    trained = [texture.tobytes() for texture in pool.finished]
    assert len(set(trained)) == 2 and set(trained) & shown()
    assert not pool.skins  # they are for decoys alone: no cloak of the pool goes on from them
    ends = []
    for turn in range(6):
        pool.attack(turn)
        ends.append(pool.cloak(turn).flat.texture(pool.cloak(turn).optimizer.colors().detach().numpy()).tobytes())
    # Lives are of two turns. What was trained to the end stays, and of the others the last whose life is over.
    assert [texture.tobytes() for texture in pool.finished] == [*trained, ends[3]]
    again = Pool(settings, box_bodies(), noise_backgrounds(), student.detector)
    again.load(6, pool.state())
    assert [texture.tobytes() for texture in again.finished] == [*trained, ends[3]]
    resumed = Pictures(again, None, student.detector)
    assert torch.equal(pictures.decoys(6).shown, resumed.decoys(6).shown)


@pytest.mark.slow
def test_finished_cloaks_are_made_once_and_before_the_first_update(
    student: Student, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cloak_core.studies.hardening.pool.FINISH", 2)
    made = []
    finish_one = Pool.finish_one
    monkeypatch.setattr(Pool, "finish_one", lambda pool: made.append(1) or finish_one(pool))
    whole = hardened(student, tmp_path / "whole", finished=2)
    assert len(made) == 2
    part = hardened(open_student(student.spec), tmp_path / "part", finished=2, max_seconds=1e-9)
    assert part.stopped and part.step == 0
    ended = hardened(open_student(student.spec), tmp_path / "part", finished=2, resume=True)
    assert state_hash(load_detector(ended.spec)) == state_hash(load_detector(whole.spec))
    hardened(student, tmp_path / "none", finished=2, decoys=0, steps=1)
    assert len(made) == 2 + 2, "a hardening that was stopped before its first update keeps its finished cloaks"


def test_what_learned_in_bfloat16_is_written_in_float32(student: Student, tmp_path: Path) -> None:
    result = hardened(student, tmp_path / "out", steps=1, precision="bfloat16")
    again = load_detector(result.spec)
    assert again.precision == "float32"
    assert all(p.dtype == torch.float32 and bool(p.isfinite().all()) for p in again.parameters())
    assert not torch.equal(again(images(1)).scores, load_detector(student.spec)(images(1)).scores)


def test_cloths_that_repeat_are_among_the_cloaks_beside_the_same_clean_images(student: Student) -> None:
    settings = HardenSettings(**(FEW | {"cloths": 1.0}))
    pool, plain = (
        Pool(one, box_bodies(), noise_backgrounds(), student.detector)
        for one in (settings, replace(settings, cloths=0.0))
    )
    cloak = pool.cloak(0)
    assert 0.2 <= cloak.worn.cloth.cloth.metres <= 0.55 and plain.cloak(0).worn.cloth is None
    pair, other = pool.pair(0), plain.pair(0)
    assert torch.equal(pair.clean, other.clean) and not torch.equal(pair.cloaked, other.cloaked)
    before = cloak.optimizer.colors().detach().clone()
    pool.attack(0)
    assert not torch.equal(cloak.optimizer.colors(), before)
    assert cloak.face_colors().shape == (len(cloak.logo), 3) and cloak.texture().shape == (3, TEXTURE, TEXTURE)
    again = Pool(settings, box_bodies(), noise_backgrounds(), student.detector)
    again.load(1, pool.state())
    assert torch.equal(again.cloak(0).optimizer.colors(), cloak.optimizer.colors())
    for turn in range(1, 5):  # a life is over: the faces remember what lay on them
        pool.attack(turn)
    assert pool.skins[0].shape == (box_bodies().face_count, 3)


def test_a_perturbation_moves_images_in_cloaks_within_its_bound_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    update, seen = Hardening._update, []

    def recorded(self: Hardening, images: torch.Tensor, wanted: object, count: int, kept: int) -> torch.Tensor:
        seen.append(images.detach().clone())
        return update(self, images, wanted, count, kept)

    monkeypatch.setattr(Hardening, "_update", recorded)
    spec = write_tiny(tmp_path)
    hardened(open_student(spec), tmp_path / "plain", steps=1)
    hardened(open_student(spec), tmp_path / "moved", steps=1, perturbation=0.02, replays=3)
    plain, *moved = seen
    assert len(moved) == 3
    for shown, earlier in zip(moved, [plain, *moved], strict=False):
        away = (shown[:2] - plain[:2]).abs()
        assert 0.005 < float(away.mean()) and float(away.max()) <= 0.02 + 1e-6
        assert not torch.equal(shown[:2], earlier[:2]) and torch.equal(shown[2:], plain[2:])
