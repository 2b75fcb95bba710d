"""What several files of this folder judge."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.people import load_people
from cloak_core.studies.card.assess import Assessment
from cloak_core.studies.card.page import write_card
from tests.sources.photographs.made_people import write_people
from tests.studies.made_split import TINY, Bulb, make_store


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict, list]:
    """A folder with the card of a white box and of a black box, the first card, and the progress told."""
    out, told = tmp_path_factory.mktemp("cards"), []
    glow = Assessment(make_store(out, Bulb("glow")), TINY, out / "glow", ["builtin-sample"], lambda *x: told.append(x))
    card = glow.run()
    Assessment(make_store(out, Bulb("dark:net.onnx", False)), TINY, out / "dark", []).run()
    for name in ("glow", "dark"):
        write_card(out / name)
    return out, card, told


@pytest.fixture(scope="session")
def worn(made: tuple[Path, dict, list], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cards, as cloak assess leaves them; the first with all parts that there are."""
    out = tmp_path_factory.mktemp("worn")
    shutil.copytree(made[0] / "dark", out / "dark")
    Image.fromarray(np.full((8, 8, 3), 255, np.uint8)).save(out / "white.png")
    patterns = tuple(f"{out}/white.png@{form}" for form in ("tile=0.5", "patch=0.3", "tile=0.2"))
    people = Crowd(load_people(str(write_people(out / "people"))))
    store = make_store(made[0], Bulb("glow"))
    Assessment(store, TINY, out / "glow", ["builtin-sample"], None, people, patterns).run()
    return out
