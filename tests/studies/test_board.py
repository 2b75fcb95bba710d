"""A leaderboard's folder: which cards join, what is said of those that do not, and the page."""

import base64
import hashlib
import json
import re
import shutil
from pathlib import Path

import pytest

from cloak_core.cli import main
from cloak_core.files.errors import InputError
from cloak_core.studies.card import board
from cloak_core.studies.card.board import add_cards, build_board, check_card
from tests.schemas import validate
from tests.studies.made_cards import TINY


@pytest.fixture
def cards(made: tuple[Path, dict, list]) -> Path:
    """Two cards, as cloak assess leaves them."""
    return made[0]


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(board, "SIZES", {"tiny": TINY})


def changed(cards: Path, to: Path, change: str) -> Path:
    """A copy of a card in which a Python statement changed `card`."""
    shutil.copytree(cards / "glow", to / "glow")
    card = json.loads((to / "glow/card.json").read_text())
    exec(change, {"card": card})
    (to / "glow/card.json").write_text(json.dumps(card))
    return to / "glow"


@pytest.mark.slow
def test_cards_join_and_the_page_sorts_and_filters(cards: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    board_folder, named = tmp_path / "board", [str(cards / "glow"), str(cards / "dark/card.json")]
    with pytest.raises(SystemExit, match="0"):
        main(["leaderboard", "add", *named, "--to", str(board_folder), "--json"])
    joined = validate("leaderboard add", capsys.readouterr().out)["added"]
    assert joined == [str(board_folder / "glow"), str(board_folder / "dark")]
    assert not (board_folder / "glow/spent.json").exists()
    with pytest.raises(SystemExit, match="0"):
        main(["leaderboard", "build", str(board_folder), "--json"])
    built = validate("leaderboard build", capsys.readouterr().out)
    assert built["cards"] == ["glow", "dark:net.onnx"]
    page, table = map(Path, built["files"])
    text = page.read_text("utf-8")
    assert 'href="glow/card.html"' in text and (tmp_path / "board/glow/card.html").exists()
    assert not re.search(r"(src|href)=[\"'](https?:)?//", text), "nothing is fetched"
    script = re.search(r"<script>(.*)</script>", text, re.DOTALL)[1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in text, "no other script runs"
    assert "| glow |" in table.read_text("utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("card['protocol'] = '1'", "protocol is '1'; this version has '2'"),
        ("card['format'] = 'x'", "format is 'x', not a cloak card"),
        ("del card['black_box']", "black_box is missing"),
        ("card['clean'] = 3", "clean is 3"),
        ("card['size'] = 'huge'", "size is 'huge', none of tiny"),
        ("card['counts']['steps'] = 1", "counts.steps is 1; size tiny has 2"),
        ("card['white_box'][1]['steps'] = 1", "white_box.76.steps is 1; size tiny has 2"),
        ("card['versions']['measurement'] = 3", "versions.measurement is 3; this version has"),
        ("card['materials']['detectors'] = {}", "materials.detectors has no digest of glow"),
        ("card['white_box'][1]['success_own'] = 0.123", "white_box.76.success_own is 0.123, its rows say "),
        ("card['white_box'][1]['state'] = 'measured'", "white_box.76.state is 'measured', its rows say 'at least'"),
        ("card['clean']['recall_own'] = 0.99", "clean.recall_own is 0.99, its rows say"),
        ("card['black_box']['worst'] = None", "black_box.worst is None, its rows say 'builtin-sample'"),
        ("card['not_tested'] = []", "not_tested is [], its rows say"),
        ("card['white_box'][1].pop('ci95')", "white_box.76.ci95 is missing"),
        ("card['white_box'][0]['asked'] = 'x'", "not the figures of a card"),
    ],
)
def test_what_does_not_hold_is_one_line(
    change: str, said: str, cards: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    folder = changed(cards, tmp_path, change)
    with pytest.raises(SystemExit, match="2"):
        main(["leaderboard", "add", str(folder / "card.json"), "--to", str(tmp_path / "board")])
    words = capsys.readouterr().err.replace("\n", " ")
    assert said in words and "card.json: " in words and not (tmp_path / "board").exists()


@pytest.mark.slow
def test_digests_and_rows_are_held_against_others(cards: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"card.json: materials.detectors.glow is [0-9a-f]+, the detector's is 0123"):
        check_card(cards / "glow", "0123456789abcdef")
    add_cards([cards / "glow"], tmp_path / "board", {})
    other = changed(cards, tmp_path / "other", "card['materials']['detectors']['glow'] = 'f' * 64")
    shutil.move(other, tmp_path / "other/glow2")
    with pytest.raises(InputError, match=r"materials.detectors.glow differs from that of .*they do not compare"):
        add_cards([tmp_path / "other/glow2"], tmp_path / "board", {})
    shutil.copytree(cards / "glow", tmp_path / "bare")
    shutil.rmtree(tmp_path / "bare/rows")
    with pytest.raises(InputError, match="rows: holds no rows of clean"):
        check_card(tmp_path / "bare")
    with pytest.raises(InputError, match=r"holds no card \(NAME/card.json\)"):
        build_board(tmp_path / "empty")
