"""A small student for every test of hardening."""

from pathlib import Path

import pytest

from cloak_core.studies.hardening.student import Student
from cloak_core.studies.hardening.students import open_student
from tests.detectors.helpers import write_tiny


@pytest.fixture
def student(tmp_path: Path) -> Student:
    return open_student(write_tiny(tmp_path))
