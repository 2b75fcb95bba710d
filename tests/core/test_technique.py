"""A technique of one's own: it is found or refused by name, and its penalty is logged under its own."""

import pkgutil
from types import SimpleNamespace

import pytest

from cloak_core.core import technique
from cloak_core.core.events import read_events
from cloak_core.core.technique import GROUPS, Technique
from cloak_core.files.errors import InputError
from tests.core.test_training import run


class Darkness(Technique):
    """Costs twice the mean colour."""

    group = "objective"

    @classmethod
    def build(cls, setup):
        return cls()

    def penalty(self, colors):
        return 2.0, colors.mean()


def test_a_technique_whose_group_does_not_exist_is_named_with_those_that_do(monkeypatch):
    made = SimpleNamespace(__file__="techniques/made.py", TECHNIQUE=type("Made", (Technique,), {"group": "objectives"}))
    monkeypatch.setattr(pkgutil, "iter_modules", lambda _: [SimpleNamespace(name="made")])
    room = SimpleNamespace(__path__=[])
    monkeypatch.setattr(technique.importlib, "import_module", lambda name: made if name.endswith("made") else room)
    with pytest.raises(InputError, match=f"techniques/made.py: .*'objectives'.*{', '.join(GROUPS)}"):
        technique.discovered.__wrapped__()


def test_a_penalty_is_logged_under_its_techniques_own_name(tmp_path, monkeypatch):
    everyone = (*technique.discovered(), Darkness)
    monkeypatch.setattr(technique, "discovered", lambda: everyone)
    result = run(tmp_path / "run", steps=2)
    (event,) = (e for e in read_events(tmp_path / "run" / "events.jsonl") if e["type"] == "step" and e["step"] == 2)
    assert event["nps"] == 0 and 0 < event["test_technique"] <= 1
    parts = event["disappearance"] + 2.5 * event["tv"] + 2 * event["test_technique"]
    assert event["loss"] == pytest.approx(parts, abs=1e-5)
    again = run(tmp_path / "run", steps=2, resume=True)
    assert again.record() | {"seconds": 0} == result.record() | {"seconds": 0}
