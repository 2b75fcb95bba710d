"""Options that are gone are answered for."""

import re
from pathlib import Path

from cloak_core.core.settings.retired import RETIRED

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "migration.md"


def test_every_option_that_is_gone_stands_beside_what_replaces_it() -> None:
    page = PAGE.read_text("utf-8")
    for name, retired in RETIRED.items():
        option = f"`--{name.replace('_', '-')}`"
        (row,) = (line for line in page.splitlines() if line.startswith("| `--") and option in line.split(" | ")[0])
        assert set(re.findall(r"--[a-z-]+", retired.instead)) <= set(re.findall(r"--[a-z-]+", row)), row
