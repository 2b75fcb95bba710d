"""Print the checkout that an environment's editable installation of the project belongs to, if it is not this one.

`PYTHON tools/editable_elsewhere.py`: nothing is printed where the project is not installed, or is installed from here,
or from a folder that is gone.
"""

from __future__ import annotations

import importlib.metadata
import json
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).resolve().parents[1]


def elsewhere(name: str = "cloak-core") -> Path | None:
    """Find the folder of another checkout that `name` is installed from as editable."""
    for found in importlib.metadata.distributions(name=name):
        told = json.loads(found.read_text("direct_url.json") or "{}")
        if told.get("dir_info", {}).get("editable"):
            folder = Path(unquote(urlsplit(told["url"]).path)).resolve()
            return folder if folder != ROOT and (folder / "pyproject.toml").exists() else None
    return None


if __name__ == "__main__":
    print(elsewhere() or "", end="")
