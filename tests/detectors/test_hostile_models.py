"""100 hostile model files: each gives a detector that answers, or one line that names the file; nothing hangs."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.detectors.hostile_models import FILES

MODULES = ("onnx", "onnx2torch", "onnxruntime", "openvino", "ai_edge_litert", "ultralytics", "transformers")


@pytest.mark.long
def test_hostile_model_files_are_read_or_refused(tmp_path: Path) -> None:
    # Not imported here: ultralytics patches Pillow for the whole process, and the tests after this one would meet that.
    for module in MODULES:
        if find_spec(module) is None:
            pytest.skip(f"no package {module}")
    command = [sys.executable, "-m", "tests.detectors.hostile_models", str(tmp_path), "0", str(len(FILES))]
    here = Path(__file__).parents[2]
    done = subprocess.run(command, capture_output=True, text=True, timeout=500, cwd=here, env=os.environ, check=False)
    records = [json.loads(line) for line in done.stdout.splitlines()]
    # A library that ends the process leaves the files after it unread.
    assert len(records) == len(FILES) == 100 and done.returncode == 0, (len(records), done.stderr[-2000:])
    assert not [record for record in records if record["wrong"]]
    read = [record for record in records if not record["said"]]
    assert len(read) >= 3 and {record["kind"] for record in records} == {make.__name__ for make in FILES}
