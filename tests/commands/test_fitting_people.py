"""`cloak people fit`: who can be dressed, counted and fitted ahead of need."""

import pytest

from cloak_core import cli
from cloak_core.sources.photographs import fits
from cloak_core.sources.photographs.people import load_people
from tests.schemas import validate
from tests.sources.photographs.made_people import write_people

pytestmark = pytest.mark.slow


def test_people_are_fitted_once_and_found_again(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("CLOAK_CACHE", str(tmp_path / "cache"))
    path = write_people(tmp_path / "people", 2)
    with pytest.raises(SystemExit) as end:
        cli.main(["people", "fit", str(path), "--json"])
    said = capsys.readouterr()
    assert not end.value.code, said.err
    record = validate("people fit", said.out)
    assert record["people"] == record["photographs"] == 2 and record["left_out"] == {}
    assert record["covered"] > 0.7 and record["spilled"] < 0.2
    monkeypatch.setattr(fits, "fit_some", lambda people: pytest.fail("fitted twice"))
    assert len(fits.fit_people(load_people(path))) == 2


def test_a_cluster_fits_where_one_is_named(tmp_path, monkeypatch, capsys):
    """tests/jobs/test_ray.py has a real cluster, and kills a node of it."""
    asked = []
    monkeypatch.setattr("cloak_core.commands.wear.executor_of", lambda address: asked.append(address))
    with pytest.raises(SystemExit):
        cli.main(["people", "fit", str(write_people(tmp_path, 1)), "--ray", "auto"])
    assert asked == ["auto"] and "1 people in 1 photographs; left out: nobody" in capsys.readouterr().out
