"""People whom the body does not fit are left out, and counted."""

import json

import pytest

from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.files.errors import InputError
from cloak_core.library import wear
from cloak_core.sources.photographs.fits import fit_people, fits_well, those_who_fit
from cloak_core.sources.photographs.people import load_people
from tests.sources.photographs.made_people import SIZE, write_people
from tests.studies.test_wearing import BodyDetector

pytestmark = pytest.mark.slow


def wide(path, *numbers):
    """Give these annotations a mask that fills the photograph's middle: the body covers a small part of it."""
    record = json.loads(path.read_text())
    width = SIZE[1]
    for number in numbers:
        box = record["annotations"][number]["bbox"]
        top, bottom = box[1], box[1] + box[3]
        record["annotations"][number]["segmentation"] = [[2, top, width - 2, top, width - 2, bottom, 2, bottom]]
    path.write_text(json.dumps(record))
    return path


def test_a_body_that_does_not_fit_is_left_out(tmp_path):
    people = load_people(wide(write_people(tmp_path, 3), 1))
    assert len(people) == 3
    fits = fit_people(people)
    assert all(fits_well(fit.quality) for fit in fits)
    fitting = those_who_fit(people, fits)
    assert fitting.left_out["does not fit"] == 1 and fitting.photographs == ("made0.png", "made2.png")
    told = wear(["zoo:builtin-sample"], people, {"d": BodyDetector()}, settings=WearSettings(size=96, bare=2))
    assert told["people"] == 2 and told["left_out"]["does not fit"] == 1


def test_nobody_who_fits_is_bad_input(tmp_path):
    people = load_people(wide(write_people(tmp_path, 2), 0, 1))
    with pytest.raises(InputError, match="people: the body fits none of its 2 people"):
        fit_people(people)
