"""What a card lets people wear beside trained cloaks: published patterns, on renders and in photographs."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from cloak_core.core.cloth import cloth_coordinates
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.geometry import face_centres, face_normals
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.people import People, Person
from cloak_core.studies.card import assess
from cloak_core.studies.card.assess import Assessment
from cloak_core.studies.cloaked import cloth_colors
from tests.studies.test_card import TINY, Glow, make_store


def test_a_picture_repeats_as_cloth() -> None:
    picture = np.zeros((40, 80, 3), np.uint8)
    picture[:, 40:, 0] = 255  # the right half is red
    bodies, faces = sample_bodies("unseen"), np.arange(0, 2000, 7)
    colors = cloth_colors(picture, 0.4, bodies, faces)
    right = cloth_coordinates(face_centres(bodies)[faces], face_normals(bodies)[faces])[:, 0] % 0.4
    assert np.array_equal(colors[:, 0] > 0.5, right >= 0.2) and not colors[:, 1:].any()


@pytest.mark.slow
def test_patterns_are_worn_on_renders_and_beside_the_largest_cloak_by_people(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Image.fromarray(np.full((8, 8, 3), 255, np.uint8)).save(tmp_path / "white.png")
    spec, worn = f"{tmp_path}/white.png@tile=0.5", []

    def judge(clothes: list, people: People, detectors: dict, backgrounds: object, settings: WearSettings) -> dict:
        assert not settings.bare, "false alarms are counted elsewhere"
        worn.extend(one.name for one in clothes)
        return {"people": len(people), "left_out": {}, "detectors": {name: {"clothing": {}} for name in detectors}}

    monkeypatch.setattr(assess, "wear_and_judge", judge)
    store = make_store(tmp_path, Glow("glow"))
    one = Assessment(store, TINY, tmp_path / "glow", [], None, People((), {}), (spec,))
    row = one._pattern(spec, 1.0)
    assert row["name"] == "white@tile=0.5" and row["n"] == 6 and row["success"] < row["clothing"] <= 1, "white glows"
    faces = one._areas[-1]
    one.shown["area 76%"] = (store.untrained(np.zeros((len(faces), 3), np.float32), faces, Path("cloak")), (0.0,), {})
    told = one._photographs(1.0)
    assert worn == ["made against it", "white@tile=0.5"] and told["rows"].keys() == {"clothing"}


@pytest.mark.slow
def test_people_cost_what_dressing_them_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now, calls = [0.0], []
    monkeypatch.setattr(assess, "time", SimpleNamespace(monotonic=lambda: now[0]))

    def judge(clothes: list, people: People, *_: object, **__: object) -> dict:
        calls.append(len(people))
        now[0] += 16.0 if len(calls) > 1 else 99.0  # the first time compiles
        return {}

    monkeypatch.setattr(assess, "wear_and_judge", judge)
    people = People((object.__new__(Person),) * 30, {})
    one = Assessment(make_store(tmp_path, Glow("glow")), TINY, tmp_path / "glow", [], None, people)
    assert one._worn_image(0.5) == 4, "16 s for two people in four garments: 2 s each"
    assert calls == [2, 2] and one._worn_image(4.0) == 1, "the detector is slower"
    assert one._costs(4.0)["people"] == (0.0, 4 * 30 * (3 + 2))
