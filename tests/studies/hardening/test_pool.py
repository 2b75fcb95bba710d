"""The cloaks that a hardening meets: where they lie, how they are attacked, how long they live."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.core.detector.protocol import state_hash
from cloak_core.core.geometry import face_areas, face_centres
from cloak_core.core.logo import region_mask
from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.paint import compose
from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.fits import fit_people
from cloak_core.sources.photographs.people import load_people
from cloak_core.studies.hardening.decoys import TEXTURE
from cloak_core.studies.hardening.folder import Material
from cloak_core.studies.hardening.hardening import Hardening, harden
from cloak_core.studies.hardening.logos import JUDGED, draw_colors, draw_logo
from cloak_core.studies.hardening.pictures import Pictures
from cloak_core.studies.hardening.pool import Pool
from cloak_core.studies.hardening.settings import HardenSettings
from cloak_core.studies.hardening.student import Student
from cloak_core.studies.hardening.students import open_student
from tests.core.fakes import box_bodies, front_logo, noise_backgrounds
from tests.detectors.helpers import write_tiny
from tests.sources.photographs.made_people import write_people
from tests.studies.hardening.made_students import FEW, hardened


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
        harden(settings, student, Material(box_bodies(), noise_backgrounds(), people=people), tmp_path / "box")
    few, material = replace(settings, steps=2), Material(bodies, noise_backgrounds(), people=people)
    assert harden(few, student, material, tmp_path / "out").step == 2
    with pytest.raises(InputError, match="begun with other people"):
        harden(few, student, replace(material, people=None), tmp_path / "out", resume=True)


def test_cloaks_die_one_after_the_other(student: Student) -> None:
    settings = HardenSettings(**(FEW | {"cloaks": 4, "life": 4}))
    pool = Pool(settings, box_bodies(), noise_backgrounds(), student.detector)
    generations = [pool.place(turn)[1] for turn in range(32)]
    rounds = [generations[turn : turn + 4] for turn in range(0, 32, 4)]
    changes = [sum(a != b for a, b in zip(*pair, strict=True)) for pair in itertools.pairwise(rounds)]
    assert changes == [1] * 7


@pytest.mark.slow
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
