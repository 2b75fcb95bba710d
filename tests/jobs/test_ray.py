"""Sweeps on a real Ray cluster of this machine: the same bits as in order, also when a node dies in the middle."""

import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ray
from ray.cluster_utils import Cluster

from cloak_core.commands.options import prepare_process
from cloak_core.core.events import read_events
from cloak_core.exchange.face_lists import read_colors, write_face_list
from cloak_core.files.errors import InputError
from cloak_core.files.writing import lock
from cloak_core.jobs.job import Job
from cloak_core.jobs.ray_cluster import RayCluster, processes_of
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.photographs import fits
from cloak_core.sources.photographs.people import load_people
from cloak_core.studies.sweeps import Sweep, read_grid
from tests.jobs.work import fit_and_note, refuse
from tests.sources.photographs.made_people import write_people

pytestmark = pytest.mark.long
ROOT = Path(__file__).parents[2]
GRID = """[base]
scene = 'sample:unseen[0:1]'
backgrounds = 'procedural:train:2'
logo = 'chest.npy'
steps = {steps}
batch = 2
size = 64
translation = 5
samples = 1
angles = '0'
threads = 1
checkpoint_every = 2
preview_every = 0
[grid]
seed = [0, 1]
lr = [0.02, 0.05]
"""


def grid(folder: Path, steps: int) -> list:
    folder.mkdir()
    bodies = load_scene("sample:unseen[0:1]")
    write_face_list(folder / "chest.npy", np.flatnonzero(bodies.regions["chest"]), bodies.topology)
    path = folder / "grid.toml"
    path.write_text(GRID.format(steps=steps).replace("chest.npy", str(folder / "chest.npy")))
    return read_grid(path)


@pytest.fixture
def cluster():
    """A head that does no work, and two nodes of one core each."""
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
    try:
        yield cluster, nodes
    finally:
        if ray.is_initialized():
            ray.shutdown()
        cluster.shutdown()


def steps_done(out: Path) -> list[int]:
    """Of each run that has begun."""
    found = [read_events(path) for path in out.glob("runs/*/events.jsonl")]
    return [sum(event.get("type") == "step" for event in events) for events in found]


@pytest.fixture(autouse=True)
def alone(tmp_path_factory):
    """Clusters of several test processes would share two cores."""
    with lock(tmp_path_factory.getbasetemp().parent / "ray.lock", wait=True):
        yield


def test_a_node_dies_and_the_colours_are_those_of_one_process(tmp_path, cluster):
    cluster, nodes = cluster
    runs = grid(tmp_path / "grid", steps=100)
    here, there = Sweep(runs, tmp_path / "here"), Sweep(runs, tmp_path / "there")
    here.run(prepare=prepare_process)

    def lose_a_node() -> None:
        # Two runs under way, each past a checkpoint: a node has one core, so each has one of them.
        while len([steps for steps in steps_done(tmp_path / "there") if 4 <= steps < 100]) < 2:
            time.sleep(0.1)
        cluster.remove_node(nodes[0], allow_graceful=False)

    killer = threading.Thread(target=lose_a_node, daemon=True)
    killer.start()
    said: list[str] = []
    assert there.run(said.append, prepare=prepare_process, executor=RayCluster(cluster.address)) == ""
    killer.join(timeout=120)
    record = there.write_results()
    assert record["done"] == record["runs"] == 4 and said[0] == "4 of 4 runs to train" and len(said) == 1 + 4
    assert len(cluster.list_all_nodes()) == 2
    for folders in zip(here.folders, there.folders, strict=True):
        assert np.array_equal(*(read_colors(folder / "colors.npy") for folder in folders))
    resumed = [e for path in (tmp_path / "there").glob("runs/*/events.jsonl") for e in read_events(path)]
    assert any(event["type"] == "resume" for event in resumed)


def test_people_are_fitted_to_the_same_bits_when_a_node_dies(tmp_path, cluster, monkeypatch):
    """What had come back is not fitted again."""
    monkeypatch.setattr(fits, "TOGETHER", 1)
    cluster, nodes = cluster
    people = load_people(write_people(tmp_path / "people", 4))
    expected = [fit.identity for fit in fits.fit_people(people)]
    (tmp_path / "noted").mkdir()
    heard, back, kept = [], [], []

    class Noting(RayCluster):
        def run(self, jobs):
            noted = {"folder": str(tmp_path / "noted")}
            for outcome in super().run([replace(j, work=fit_and_note, arguments=j.arguments | noted) for j in jobs]):
                back.extend(person.photograph for person in outcome.job.arguments["people"])
                yield outcome

    def lose_a_node(done, _all):
        heard.append(done)
        if done == 1:
            kept.extend(back)  # a job that was done, and had not come back, is lost with its node
            cluster.remove_node(nodes[0], allow_graceful=False)

    fitted = fits.fit_people(people, lose_a_node, Noting(cluster.address))
    assert [fit.identity for fit in fitted] == expected
    assert heard == [0, 1, 2, 3, 4] and len(cluster.list_all_nodes()) == 2
    assert len(kept) == 1 and (tmp_path / "noted" / kept[0]).read_text() == "x"


def test_outcomes_errors_and_what_no_machine_has(cluster):
    executor = RayCluster(cluster[0].address)
    outcomes = list(executor.run([Job(str(n), refuse, {"number": n}) for n in range(3)]))
    assert sorted((outcome.job.name, outcome.result, outcome.error) for outcome in outcomes) == [
        ("0", 0, ""), ("1", None, "one: refused"), ("2", 2, ""),
    ]  # fmt: skip
    with pytest.raises(InputError, match="a run asks for 64 cores"):
        list(executor.run([Job("large", refuse, {"number": 0}, cores=64.0)]))


def test_no_cluster_there_is_one_line():
    with pytest.raises(InputError, match=r"--ray 127\.0\.0\.1:1"):
        list(RayCluster("127.0.0.1:1").run([Job("a", refuse, {"number": 0})]))


def test_control_c_ends_runs_in_order(tmp_path):
    grid(tmp_path / "grid", steps=5000)
    command = [sys.executable, "-m", "cloak_core", "sweep", str(tmp_path / "grid" / "grid.toml")]
    command += ["--out", str(tmp_path / "out"), "--ray", "local"]
    # Whoever runs the tests in the background may have had SIGINT ignored, which children inherit.
    heed = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, preexec_fn=heed)
    try:
        while sum(steps_done(tmp_path / "out")) < 4:
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=200)[1]
    finally:
        process.kill()
    assert process.returncode == 3, said
    ends = [read_events(path)[-1] for path in (tmp_path / "out").glob("runs/*/events.jsonl")]
    assert ends and all(end["type"] == "end" and end["outcome"] == "stopped" for end in ends)


LONG = """
import time
import ray
from cloak_core.jobs.ray_cluster import RayCluster

with RayCluster()._connected(ray):
    print(ray.get_runtime_context().get_session_name(), flush=True)
    forever = ray.remote(time.sleep).remote(600)
    time.sleep(600)
"""


def test_nothing_of_a_cluster_outlives_a_killed_process() -> None:
    child = subprocess.Popen([sys.executable, "-c", LONG], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    session = child.stdout.readline().strip()
    assert processes_of(session)
    child.kill()
    child.wait()
    until = time.monotonic() + 60
    while processes_of(session) and time.monotonic() < until:
        time.sleep(0.5)
    assert processes_of(session) == []
