"""The cloaks that a hardening meets, and cloth where nobody is: where they lie, how they are attacked, what stays."""

import itertools
from dataclasses import replace
from itertools import repeat
from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.core.batches import Batch
from cloak_core.core.images import dressed
from cloak_core.core.logo import Cover
from cloak_core.core.objective import Step, gradient_step
from cloak_core.core.paint import blank
from cloak_core.core.source import NOBODY
from cloak_core.files.errors import InputError
from cloak_core.patterns.controls import OwnClothing
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.people import load_people
from cloak_core.studies.hardening.decoys import TEXTURE, draw_decoy, random_texture
from cloak_core.studies.hardening.hardening import Hardening, HardenMaterial, harden
from cloak_core.studies.hardening.pictures import Pictures
from cloak_core.studies.hardening.pool import Pool
from cloak_core.studies.hardening.settings import HardenSettings
from cloak_core.studies.hardening.student import Student
from cloak_core.studies.hardening.students import open_student
from tests.core.fakes import box_bodies, front_logo, noise_backgrounds
from tests.detectors.helpers import write_tiny
from tests.sources.photographs.made_people import write_people
from tests.studies.hardening.made_students import FEW, hardened


def _pool(student: Student, **changes: object) -> Pool:
    return Pool(HardenSettings(**(FEW | changes)), box_bodies(), noise_backgrounds(), student.detector)


def test_a_turns_cloak_is_attacked_on_the_images_that_are_learned_from(
    student: Student, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = []

    def recorded(objective: object, optimizer: object, batch: Batch) -> Step:
        step = gradient_step(objective, optimizer, batch)
        steps.append((batch, step.images.clone(), step.figures))
        return step

    monkeypatch.setattr("cloak_core.studies.hardening.pool.gradient_step", recorded)
    monkeypatch.setattr("cloak_core.studies.hardening.pool.draw_logo", lambda bodies, rng: front_logo(bodies).face_ids)
    turns = [_pool(student, attack_steps=count).turn(0) for count in (0, 4)]
    assert torch.equal(turns[0].clean, turns[1].clean) and not torch.equal(turns[0].cloaked, turns[1].cloaked)
    assert len(steps) == 4 and len({id(batch) for batch, *_ in steps}) == 1
    (_, first, before), (*_, after) = steps[0], steps[-1]
    assert torch.equal(first, turns[0].cloaked)
    assert turns[0].attack is None and turns[1].attack == after and after.loss < before.loss


def test_a_turns_images_differ_where_the_logo_is(student: Student) -> None:
    pool = _pool(student)
    turn = pool.turn(0)
    apart = (turn.cloaked - turn.clean).abs().amax((1, 2, 3))
    assert turn.cloaked.shape == (2, 3, 64, 64)
    assert float(apart.max()) > 0.05
    assert Pictures(pool, None, student.detector).plain(0).shape == (1, 3, 64, 64)


@pytest.mark.slow
def test_people_in_photographs_wear_the_cloaks_and_are_clean_in_their_own_clothes(
    student: Student, tmp_path: Path
) -> None:
    people, bodies = Crowd(load_people(write_people(tmp_path, 2))), sample_bodies("train")
    settings = HardenSettings(**(FEW | {"batch": 4, "people_share": 1.0, "size": 96}))
    pool = Pool(settings, bodies, noise_backgrounds(), student.detector, people=people)
    pair, cloak = pool.turn(0), pool.cloak(0, 0)
    draws = cloak.batcher.sampler.draw(0)
    own = OwnClothing(Cover(cloak.logo.face_ids[:1], cloak.logo.topology))  # any face: nothing is laid on it
    for image, view in zip(pair.clean, cloak.batcher.images.make_views(draws.views(), own), strict=True):
        photograph = dressed([view], own, blank(1, 96, 96)).paint(own.colors_in(view, 0))
        torch.testing.assert_close(image, photograph[0])
    worn = (pair.cloaked - pair.clean).abs().amax(1) > 0.05
    assert 0.001 < worn.float().mean() < 0.5, "only the person changes"
    with pytest.raises(InputError, match="topology"):
        harden(settings, student, HardenMaterial(box_bodies(), noise_backgrounds(), people=people), tmp_path / "box")
    few, material = replace(settings, steps=2), HardenMaterial(bodies, noise_backgrounds(), people=people)
    assert harden(few, student, material, tmp_path / "out").step == 2
    with pytest.raises(InputError, match="begun with other people"):
        harden(few, student, replace(material, people=NOBODY), tmp_path / "out", resume=True)


def test_decoys_show_the_last_cloaks_beside_patterns_that_nobody_trained(
    student: Student, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cloak_core.studies.hardening.pool.KEPT", 2)
    pool = _pool(student)
    pictures = Pictures(pool, None, student.detector)
    shown = lambda: {texture.tobytes() for texture in itertools.islice(pictures.textures(np.random.default_rng(0)), 40)}
    assert len(shown()) == 40, "there are no cloaks yet"
    for turn in range(6):
        pool.turn(turn)
    recent = {texture.tobytes() for texture in pool.recent}
    assert len(recent) == 2 and recent < shown()
    again = _pool(student)
    again.load(pool.state())
    resumed = Pictures(again, None, student.detector)
    assert torch.equal(pictures.decoys(6).shown, resumed.decoys(6).shown)


def test_a_perturbation_moves_images_in_cloaks_within_its_bound_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    update, seen = Hardening._update, []

    def recorded(self: Hardening, images: torch.Tensor, wanted: object, count: int, kept: int) -> torch.Tensor:
        seen.append(images.detach().clone())
        return update(self, images, wanted, count, kept)

    monkeypatch.setattr(Hardening, "_update", recorded)
    spec = write_tiny(tmp_path)
    hardened(open_student(spec), tmp_path / "plain", steps=1, perturbation=0.0)
    hardened(open_student(spec), tmp_path / "moved", steps=1, perturbation=0.02, replays=3)
    plain, *moved = seen
    assert len(moved) == 3
    for shown, earlier in zip(moved, [plain, *moved], strict=False):
        away = (shown[:2] - plain[:2]).abs()
        assert 0.005 < float(away.mean()) and float(away.max()) <= 0.02 + 1e-6
        assert not torch.equal(shown[:2], earlier[:2]) and torch.equal(shown[2:], plain[2:])


# --- decoys: in the picture's frame, off the people in it, and never twice the same

SIZE = 96
GREY = torch.full((3, SIZE, SIZE), 0.5)


def red() -> np.ndarray:
    texture = np.zeros((3, TEXTURE, TEXTURE), np.float32)
    texture[0] = 1
    return texture


def test_a_decoy_changes_a_part_of_the_picture_and_depends_on_the_draw_alone() -> None:
    drawn = [draw_decoy(GREY, repeat(red()), np.random.default_rng(seed)) for seed in range(12)]
    changed = [float((one != GREY).any(0).float().mean()) for one in drawn]
    assert sum(share > 0.01 for share in changed) >= 10 and min(changed) < 0.5
    assert all(0 <= one.min() and one.max() <= 1 for one in drawn)
    assert torch.equal(drawn[3], draw_decoy(GREY, repeat(red()), np.random.default_rng(3)))
    assert not torch.equal(drawn[3], drawn[4])
    # Cloth is red in the picture's own light, wherever it lies.
    cloth = drawn[3][:, (drawn[3] != GREY).any(0)]
    assert cloth[0].mean() > 0.4 and cloth[1:].max() < 0.5


def test_people_in_the_picture_are_kept_clear() -> None:
    box = [20.0, 10.0, 60.0, 90.0]
    for seed in range(30):
        shown = draw_decoy(GREY, repeat(red()), np.random.default_rng(seed), keep_clear=[box])
        hidden = (shown != GREY).any(0)[10:91, 20:61].float().mean()
        assert hidden <= 0.11


@pytest.mark.parametrize("seed", range(24))
def test_patterns_fill_their_texture(seed: int) -> None:
    texture = random_texture(np.random.default_rng(seed), lambda: torch.rand(3, 64, 48))
    assert texture.shape == (3, TEXTURE, TEXTURE) and texture.dtype == np.float32
    assert texture.min() >= 0 and texture.max() <= 1
