"""A small student for every test of hardening."""

from pathlib import Path

import pytest

from cloak_core.studies.hardening import pool
from cloak_core.studies.hardening.student import Student
from cloak_core.studies.hardening.students import open_student
from tests.detectors.helpers import write_tiny


@pytest.fixture(autouse=True)
def few_finishing_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cloak that is trained to its end takes a tenth of the usual steps."""
    monkeypatch.setattr(pool, "FINISH", 24)


@pytest.fixture
def student(tmp_path: Path) -> Student:
    return open_student(write_tiny(tmp_path))
