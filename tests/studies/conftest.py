"""What several files of this folder judge."""

from pathlib import Path

import pytest

from cloak_core.studies.card.assess import Assessment
from cloak_core.studies.card.page import write_card
from tests.studies.made_cards import TINY, Glow, make_store


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict, list]:
    """A folder with the card of a white box and of a black box, the first card, and the progress told."""
    out, told = tmp_path_factory.mktemp("cards"), []
    card = Assessment(
        make_store(out, Glow("glow")), TINY, out / "glow", ["builtin-sample"], lambda *x: told.append(x)
    ).run()
    Assessment(make_store(out, Glow("dark:net.onnx", False)), TINY, out / "dark", []).run()
    for name in ("glow", "dark"):
        write_card(out / name)
    return out, card, told
