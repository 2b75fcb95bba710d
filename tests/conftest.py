"""Shared fixtures; also switches on run-time checks of every type and tensor shape in cloak_core (pytest only)."""

import gc
import os
from collections.abc import Callable
from pathlib import Path

# Of several pytest processes each gets one thread; before anything imports torch.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest
from hypothesis import settings

import cloak_core
from tests import reliability_record
from tests.type_checks import check_rooms

# No test is judged by the clock: machines are shared.
settings.register_profile("cloak", deadline=None)
settings.load_profile("cloak")

# Modules and collected tests are two million objects that live to the end: the garbage collector leaves them alone,
# which would take it a quarter of the collection's time.
gc.disable()

# What tests decode stays out of the user's cache.
os.environ["CLOAK_CACHE"] = "off"

# Every room but two. Commands: tyro fills required options with a marker before the user's words replace it. Library:
# it says in words what is wrong with what a program gives it.
ROOMS = {path.parent.name for path in Path(cloak_core.__file__).parent.glob("*/__init__.py")} - {"commands", "library"}
check_rooms([f"cloak_core.{room}" for room in sorted(ROOMS)])


@pytest.fixture
def cloak(capsys: pytest.CaptureFixture) -> Callable[..., tuple[int, str, str]]:
    """Call the command line in this process: its exit code, and what it wrote to standard output and error."""
    from cloak_core import cli  # not before its rooms are checked

    def call(*words: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as end:
            cli.main([str(word) for word in words])
        return (end.value.code or 0, *capsys.readouterr())

    return call


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of real detectors, bodies and photographs; tests that need it skip where it is absent, and say so."""
    folder = Path(os.environ.get("CLOAK_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    if not (folder / "data" / "README.md").exists():
        pytest.skip(f"the measuring data is not there: {folder} (set CLOAK_SHARED)")
    return folder


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


def pytest_sessionfinish(exitstatus: int) -> None:
    if exitstatus == 0:
        reliability_record.write_docs()
