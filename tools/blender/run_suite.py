"""Runs the add-on's tests (tests/blender/inside) in a real Blender; its Python needs pytest.

    blender -b --factory-startup --python-exit-code 9 -P tools/blender/run_suite.py -- [PYTEST ARGUMENTS]

Environment: CLOAK_EXTENSION (the zip), CLOAK_TRAINER (a Python that has cloak_core), CLOAK_ROOT (this checkout),
BLENDER_USER_RESOURCES (a private folder).
"""

import os
import sys
from pathlib import Path

import pytest

INSIDE = Path(__file__).resolve().parents[2] / "tests" / "blender" / "inside"
ARGUMENTS = sys.argv[sys.argv.index("--") + 1 :]
sys.path.insert(0, str(INSIDE))
common = ["-c", str(INSIDE / "pytest.ini"), "--rootdir", str(INSIDE), "-p", "no:cacheprovider"]
files = [] if any(a.endswith(".py") or "::" in a for a in ARGUMENTS) else [str(INSIDE)]
code = pytest.main([*common, *files, *ARGUMENTS])
sys.stdout.flush()
os._exit(int(code))
