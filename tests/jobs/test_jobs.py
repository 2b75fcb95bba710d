"""Jobs done here, one after the other."""

import itertools
import time

import pytest

from cloak_core.files.errors import InputError
from cloak_core.jobs.job import Job, hand_out, in_order
from cloak_core.jobs.ray_cluster import RayCluster

DONE = []


def square(number: int) -> int:
    if number < 0:
        raise InputError(f"{number}: negative")
    DONE.append(number)
    return number * number


def test_outcomes_come_in_order_and_bad_input_is_one_of_them():
    outcomes = list(in_order([Job(str(n), square, {"number": n}) for n in (3, -1, 2)]))
    assert [outcome.result for outcome in outcomes] == [9, None, 4]
    assert [outcome.error for outcome in outcomes] == ["", "-1: negative", ""]


def test_who_stops_listening_stops_the_rest():
    DONE.clear()
    outcomes = in_order([Job(str(n), square, {"number": n}) for n in range(5)])
    assert next(outcomes).result == 0
    outcomes.close()
    assert DONE == [0]


def test_the_time_left_is_that_of_the_jobs_left(monkeypatch):
    clock = itertools.count(0, 10)  # 0 at the start, then two looks for each job and one after it
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(clock)))
    said: list[str] = []
    list(hand_out(None, [Job(str(n), square, {"number": n}) for n in range(4)], said.append, "job"))
    assert said[0] == "job 1 of 4: 0: 10 s, about 90 s left".replace("90 s", "2 min")
    assert said[1].endswith("about 60 s left") and said[2].endswith("about 30 s left")
    assert said[3] == "job 4 of 4: 3: 10 s"


def test_a_defect_is_raised():
    with pytest.raises(TypeError):
        list(in_order([Job("none", square, {"number": None})]))


def test_a_cluster_that_does_not_start_is_one_line(monkeypatch):
    def too_busy(*_, **__):
        raise Exception("The current node timed out during startup. This\ncould happen because")

    ray = pytest.importorskip("ray")
    monkeypatch.setattr(ray, "init", too_busy)
    with pytest.raises(InputError, match="--ray local: The current node timed out during startup"):
        list(RayCluster().run([Job("a", square, {"number": 1})]))
    monkeypatch.setattr(ray, "init", lambda *_, **__: {}["defect"])
    with pytest.raises(KeyError):
        list(RayCluster().run([Job("a", square, {"number": 1})]))
