"""What a cloth covers is chosen where it is worn, and said."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core import evaluate, film, wear
from cloak_core.core.detector.protocol import Detections
from cloak_core.core.evaluation.settings import FilmSettings, WearSettings
from cloak_core.core.logo import Cover
from cloak_core.files.errors import InputError
from cloak_core.patterns.cloth import ClothPattern, Grid
from cloak_core.sources.bodies.people.clothed import clothed_bodies
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.fits import fit_people
from cloak_core.sources.photographs.people import People, load_people
from cloak_core.sources.photographs.rig import faces_on_rig
from cloak_core.sources.photographs.source import PeopleSource
from cloak_core.studies.opening import clothes_cover, open_pattern
from cloak_core.zoo.entry import entry
from tests.core.fakes import RedDetector
from tests.schemas import validate
from tests.sources.photographs.made_people import write_people

pytestmark = pytest.mark.slow
HOOD, CLOTHES = "shirt+trousers+hood", "shirt+trousers"


class Brightness(RedDetector):
    """One box over the middle of the image, the surer the brighter the image is."""

    def forward(self, images: torch.Tensor) -> Detections:
        box = torch.tensor([0.25, 0.1, 0.75, 0.9]).mul(images.shape[-1]).expand(len(images), 1, 4)
        return Detections(box, images.mean((1, 2, 3))[:, None])


@pytest.fixture(scope="module")
def people(tmp_path_factory: pytest.TempPathFactory) -> People:
    return load_people(write_people(tmp_path_factory.mktemp("people"), 2))


def covered(people: People, logo: str) -> set[int]:
    """Faces that the first person's pixels show of a cloth."""
    cover = clothes_cover(logo)
    pattern = open_pattern("print:balls@tile=0.25")[0].on(cover)
    face = PeopleSource(fit_people(people), 96).view({"person": 0}, None, pattern).places.face.numpy()
    return set(cover.face_ids[face[face >= 0]].tolist())


@pytest.mark.parametrize("where", ["people", "bodies"])
def test_evaluate_judges_a_cloth_where_it_is_told(people: People, tmp_path: Path, where: str) -> None:
    run = entry("transfer-people").write_run(tmp_path / "run")
    shown = {"people": people} if where == "people" else {"scene": "sample:unseen[0]", "angles": "0"}
    judge = partial(evaluate, run, detectors={"red": Brightness()}, controls=("grey",), size=64, shift=4, bare=1)
    judge = partial(judge, images_per_view=1, resamples=100, **shown)
    said = [judge(), judge(logo=CLOTHES), judge(logo=HOOD)]
    assert [one["cover"] for one in said] == [CLOTHES, CLOTHES, HOOD]
    scores = [one["detectors"]["red"]["grey"]["mean_score"] for one in said]
    assert scores[0] == scores[1] != scores[2]
    folder = run / f"evaluation{'-people' * (where == 'people')}-{HOOD}"
    validate("evaluate", (folder / "summary.json").read_text())


def test_wear_and_film_say_what_is_covered(people: People, tmp_path: Path) -> None:
    how = {"settings": WearSettings(size=64, bare=1), "out": tmp_path / "out", "logo": HOOD}
    said = wear(["zoo:transfer-people", "print:balls@patch=0.3"], people, {"red": RedDetector()}, **how)
    rows = said["detectors"]["red"]
    assert json.loads((tmp_path / "out" / "wear.json").read_text())["cover"] == said["cover"] == HOOD
    covers = {name: row["cover"] for name, row in rows.items()}
    assert covers == dict.fromkeys(rows, HOOD) | {"print:balls@patch=0.3": "chest", "grey headwear": "headwear"}
    plain = wear("zoo:transfer-people", people, {"red": RedDetector()}, settings=how["settings"])
    assert plain["cover"] == plain["detectors"]["red"]["zoo:transfer-people"]["cover"] == CLOTHES
    took = film(
        "zoo:transfer-people",
        tmp_path / "film",
        "sample:unseen[0]",
        detectors={"red": RedDetector()},
        logo=HOOD,
        settings=FilmSettings(size=64, seconds=0.1),
    )
    assert took["cover"] == HOOD


def test_who_shows_nothing_of_a_cloth_is_left_out_and_counted(people: People) -> None:
    topology = sample_bodies().topology
    first, second = (set(faces_on_rig(topology)[np.unique(fit.main)].tolist()) for fit in fit_people(people))
    unseen = set(range(sample_bodies().face_count)) - first - second

    def dressed(faces: set[int]) -> Crowd:
        cover = Cover(np.array(sorted(faces)[:1]), topology, name="one face")
        return Crowd(people).wearers([ClothPattern(cover, Grid.of(0.25, 0.01))])

    shown = dressed(first - second)
    assert len(shown) == len(shown.fits) == 1 and shown.people.left_out == {"nothing is covered": 1}
    with pytest.raises(InputError, match="one face shows on nobody"):
        dressed(unseen)


BAD = {
    "region 'hoodie' is unknown; scene 'samples' has: .*hood": {"logo": "shirt+hoodie"},
    "colours of faces": {"logo": HOOD, "colors": "zoo:transfer-anny"},
    "scene 'sample-clothed' has: .*scarf": {"logo": "beard", "scene": clothed_bodies},
}


@pytest.mark.parametrize("words", BAD)
def test_what_cannot_be_covered_is_refused(people: People, words: str) -> None:
    asked = {"colors": "zoo:transfer-people"} | BAD[words]
    judges = {"red": RedDetector()}
    with pytest.raises(InputError, match=words):
        if scene := asked.pop("scene", None):
            evaluate("zoo:builtin-clothed", scene("unseen"), detectors=judges, **asked)
        else:
            wear(people=people, detectors=judges, **asked)
