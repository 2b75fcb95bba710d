"""Print what the project needs, one requirement a line: `python tools/list_requirements.py [EXTRA]`."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path


def requirements(extra: str = "") -> list[str]:
    """List the project's requirements and those of one extra, extras within extras unfolded."""
    project = tomllib.loads((Path(__file__).resolve().parents[1] / "pyproject.toml").read_text("utf-8"))["project"]
    extras, left, found = project["optional-dependencies"], [extra] if extra else [], [*project["dependencies"]]
    while left:
        for line in extras[left.pop()]:
            if line.startswith(f"{project['name']}["):
                left += line.partition("[")[2].partition("]")[0].split(",")
            else:
                found.append(line)
    return found


if __name__ == "__main__":
    print("\n".join(requirements(*sys.argv[1:2])))
