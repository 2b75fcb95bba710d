"""`cloak people fit`: who can be dressed, counted and fitted ahead of need."""

import pytest

from cloak_core import cli
from tests.sources.photographs.made_people import write_people

pytestmark = pytest.mark.slow


def test_a_cluster_fits_where_one_is_named(tmp_path, monkeypatch, capsys):
    """tests/jobs/test_ray.py has a real cluster, and kills a node of it."""
    asked = []
    monkeypatch.setattr("cloak_core.commands.wear.executor_of", lambda address: asked.append(address))
    with pytest.raises(SystemExit):
        cli.main(["people", "fit", str(write_people(tmp_path, 1)), "--ray", "auto"])
    assert asked == ["auto"] and "1 people in 1 photographs; left out: nobody" in capsys.readouterr().out
