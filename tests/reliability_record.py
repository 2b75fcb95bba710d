"""docs/reports/reliability.md, written from what the tests marked `reliability` measured."""

import os
import platform
import time
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs" / "reports" / "reliability.md"
rows: dict[str, list[tuple[str, str]]] = {}
"""By section: what was measured, and the figure."""
HEAD = """# Report: reliability

**Question.** What does a run survive, and what does it say when it cannot?

**Answer.** Kills at any moment, full disks, broken files and lost processes: the run folder stays valid, and the
resumed run has the same bits, on the same device with the same number of threads. Every figure was measured by a
test, which wrote it here:

    CLOAK_KILLS=50 CLOAK_WRITE_DOCS=1 pytest -m reliability

`pytest -m reliability` alone runs the same tests with fewer kills and leaves this page as it is.
"""
ORDER = ("Killed", "Trouble while training", "Files from strangers", "Memory", "Several processes")


def record(section: str, what: str, figure: object) -> None:
    """One line of the page."""
    rows.setdefault(section, []).append((what, str(figure)))


def write_docs() -> None:
    """Write the page, where CLOAK_WRITE_DOCS asks for it."""
    if not rows or not os.environ.get("CLOAK_WRITE_DOCS"):
        return
    missing = [section for section in ORDER if section not in rows]
    if missing:
        raise RuntimeError(f"{DOCS.name} is written whole: nothing was measured for {', '.join(missing)}")
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    lines = [HEAD, f"Measured {time.strftime('%Y-%m-%d')}: {machine}."]
    for section in ORDER:
        lines += ["", f"## {section}", "", "| what | figure |", "|---|---|"]
        lines += [f"| {what} | {figure} |" for what, figure in rows[section]]
    DOCS.write_text("\n".join(lines) + "\n", encoding="utf-8")
