"""The notebook runs from its first cell to its last, with reduced counts."""

import os
from pathlib import Path

import nbclient
import nbformat
import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "docs" / "notebooks" / "first_cloak.ipynb"
REDUCED = "steps, size, most_images, seconds = 2, 96, 4, 1"


@pytest.mark.long
def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    (counts,) = [cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", ())]
    assert counts.source.partition(" = ")[0] == REDUCED.partition(" = ")[0]
    counts.source = REDUCED
    nbclient.NotebookClient(
        notebook, timeout=500, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    ).execute()
    printed = "".join(out.get("text", "") for cell in notebook.cells for out in cell.get("outputs", ()))
    assert "logo      hidden in" in printed and "steps: 2" in printed and "report.html" in printed
    pictures = [out.data for cell in notebook.cells for out in cell.get("outputs", ()) if "data" in out]
    assert any("image/png" in data for data in pictures) and any("image/gif" in data for data in pictures)


def test_the_notebook_is_kept_without_outputs() -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert not [cell for cell in notebook.cells if cell.get("outputs") or cell.get("execution_count")]
