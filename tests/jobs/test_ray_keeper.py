"""What a killed driver leaves of its Ray session is ended, and nothing else."""

import subprocess
import time
from pathlib import Path

import pytest

from cloak_core.jobs import ray_cluster
from cloak_core.jobs.ray_cluster import kept, processes_of

pytestmark = pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="looks into /proc")


def stand_in(title: str, log: Path) -> subprocess.Popen:
    """A process of this title, with a file open."""
    return subprocess.Popen(["bash", "-c", f"exec -a '{title}' sleep 100 3>'{log}'"])


@pytest.mark.slow
def test_agents_and_named_processes_end_with_their_owner(tmp_path: Path) -> None:
    session = f"session_of_{tmp_path.name}"
    (tmp_path / session).mkdir()
    logs = tmp_path / session / "agent.out"
    agent, server = stand_in("ray::DashboardAgent", logs), stand_in(f"gcs_server --log_dir={session}", tmp_path / "x")
    reader, other = stand_in("tail", logs), stand_in("ray::DashboardAgent", tmp_path / "other.out")
    try:
        until = time.monotonic() + 20
        while len(processes_of(session)) < 2 and time.monotonic() < until:
            time.sleep(0.1)
        assert sorted(processes_of(session)) == sorted([agent.pid, server.pid])
        with kept(session):
            assert agent.poll() is None
        assert agent.wait(60) == server.wait(60) == -9
        assert reader.poll() is other.poll() is None
    finally:
        for process in (agent, server, reader, other):
            process.kill()
            process.wait()
    assert ray_cluster.GRACE_SECONDS < ray_cluster.CLOSE_SECONDS
