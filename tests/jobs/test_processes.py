"""Jobs here and in processes of this machine: results, bad input, defects, and a process or cluster that dies."""

from pathlib import Path

import pytest

from cloak_core.files.errors import InputError
from cloak_core.jobs.job import Job, in_order
from cloak_core.jobs.processes import Processes
from cloak_core.jobs.ray_cluster import RayCluster
from tests.jobs.work import break_down, die_once, refuse

pytestmark = pytest.mark.slow


def test_who_stops_listening_stops_the_rest(tmp_path: Path):
    outcomes = in_order([Job(str(n), die_once, {"folder": tmp_path, "number": n}) for n in (0, 2, 3)])
    assert next(outcomes).result == 0
    outcomes.close()
    assert [path.name for path in tmp_path.iterdir()] == ["0"]


def test_bad_input_is_an_outcome_and_the_others_go_on():
    jobs = [Job(str(number), refuse, {"number": number}) for number in range(3)]
    outcomes = {outcome.job.name: outcome for outcome in Processes(2).run(jobs)}
    assert {name: outcome.result for name, outcome in outcomes.items()} == {"0": 0, "1": None, "2": 2}
    assert outcomes["1"].error == "one: refused"


def test_a_job_whose_process_dies_is_done_again_and_nothing_else_is(tmp_path: Path):
    jobs = [Job(str(number), die_once, {"folder": tmp_path, "number": number}) for number in range(3)]
    outcomes = list(Processes(1).run(jobs))
    assert sorted(outcome.result for outcome in outcomes) == [0, 1, 2]
    assert {path.name: len(path.read_text()) for path in tmp_path.iterdir()} == {"0": 1, "1": 2, "2": 1}


def test_a_defect_is_raised_here():
    with pytest.raises(ZeroDivisionError):
        list(Processes(1).run([Job("it", break_down)]))


def test_a_cluster_that_does_not_start_is_one_line(monkeypatch):
    def too_busy(*_, **__):
        raise Exception("The current node timed out during startup. This\ncould happen because")

    ray, job = pytest.importorskip("ray"), Job("a", refuse, {"number": 0})
    monkeypatch.setattr(ray, "init", too_busy)
    with pytest.raises(InputError, match="--ray local: The current node timed out during startup"):
        list(RayCluster().run([job]))
    monkeypatch.setattr(ray, "init", lambda *_, **__: {}["defect"])
    with pytest.raises(KeyError):
        list(RayCluster().run([job]))
