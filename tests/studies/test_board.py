"""A leaderboard's folder: which cards join, what is said of those that do not, and the page."""

import base64
import errno
import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from PIL import Image

from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_json
from cloak_core.studies.card import entry
from cloak_core.studies.card.entry import read_entry
from cloak_core.studies.card.leaderboard import add_cards, build_board, check_together, write_leaderboard
from cloak_core.studies.card.page import write_card
from cloak_core.studies.card.protocol import SIZES, parts_of
from tests.schemas import validate
from tests.studies.made_split import TINY, Bulb


@pytest.fixture
def cards(worn: Path, tmp_path: Path) -> Path:
    """The cards, to be changed."""
    return Path(shutil.copytree(worn, tmp_path / "cards"))


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SIZES, "tiny", TINY)


def change(folder: Path, statement: str) -> Path:
    """Change a card by a Python statement about `card`."""
    card = json.loads((folder / "card.json").read_text())
    exec(statement, {"card": card})
    (folder / "card.json").write_text(json.dumps(card))
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    """All files below a folder."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


@pytest.mark.slow
def test_cards_join_and_the_page_sorts_and_filters(worn: Path, tmp_path: Path, cloak) -> None:
    board_folder, named = tmp_path / "board", (worn / "glow", worn / "dark/card.json")
    code, out, _ = cloak("leaderboard", "add", *named, "--to", board_folder, "--json")
    joined = [Path(path) for path in validate("leaderboard add", out)["added"]]
    assert [re.sub("-[0-9a-f]{12}", "", path.name) for path in joined] == ["glow", "dark-net"]
    copied, own = contents(joined[0]), contents(worn / "glow")
    assert own.keys() - copied.keys() == {"spent.json"} and copied.keys() <= own.keys()
    assert json.loads(copied["card.json"]) == json.loads(own["card.json"])
    built = validate("leaderboard build", cloak("leaderboard", "build", board_folder, "--json")[1])
    assert code == 0 and built["cards"] == ["glow", "dark:net.onnx"]
    page, table = map(Path, built["files"])
    text = page.read_text("utf-8")
    assert f'href="{joined[0].name}/card.html"' in text and (joined[0] / "card.html").exists()
    assert not re.search(r"(src|href)=[\"'](https?:)?//", text), "nothing is fetched"
    script = re.search(r"<script>(.*)</script>", text, re.DOTALL)[1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in text, "no other script runs"
    assert "| glow |" in table.read_text("utf-8")
    assert add_cards(joined, board_folder, {}) == joined, "a card of the leaderboard is what joins again"


# --- what is in a card


def leaves(value: object, place: tuple = ()) -> Iterator[tuple]:
    """Places of all values, empty tables and lists among them."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    if not inner:
        yield place
    for key, one in inner:
        yield from leaves(one, (*place, key))


MADE = ("cloak", "command", "python", "torch", "numpy", "platform", "threads")
PROVENANCE = {("seconds",), *(("made", name) for name in MADE)}
PROVENANCE |= {("materials", scene, "name") for scene in ("bodies", "unseen")}
"""What nothing can be held against: a page shows it as it is."""


def other(value: object) -> object:
    """Another value of the same kind, as plausible."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if isinstance(value, float):
        return value / 2 if value > 0.01 else value + 0.01
    if isinstance(value, str):
        return "0" * 64 if re.fullmatch("[0-9a-f]{64}", value) else value + "x"
    return ["x"] if isinstance(value, list) else {"x": 1} if isinstance(value, dict) else 0.5


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_every_value_of_a_card_is_held_against_something(cards: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Changed one at a time beside the same detector's card."""
    folder, whole = cards / "glow", (cards / "glow/card.json").read_text()
    there = json.loads(whole)
    monkeypatch.setattr(entry, "_read_pictures", lambda *_: ({}, {}))
    rows = read_entry(folder).rows
    # Computed once for what a card says itself: most changes leave that as it is.
    read, make = entry._read_rows, entry.card_of
    parts = cache(lambda told: {part.name: part for part in parts_of(json.loads(told), TINY)})
    kept_rows = cache(lambda told, name, part: read(folder, name, parts(told)[part], json.loads(told), TINY))
    kept = cache(lambda told: make(json.loads(told), TINY, rows))
    monkeypatch.setattr(
        entry, "_read_rows", lambda _, name, part, told, size: kept_rows(json.dumps(told), name, part.name)
    )
    monkeypatch.setattr(entry, "card_of", lambda told, size, _: kept(json.dumps(told)))

    def unnoticed(card: dict) -> bool:
        (folder / "card.json").write_text(json.dumps(card))
        try:
            check_together({cards: there, folder: read_entry(folder).card})
        except InputError:
            return False
        return True

    assert unnoticed(json.loads(whole))
    passed, places = set(), list(leaves(there))
    for place in places:
        card = json.loads(whole)
        *way, last = place
        table = card
        for key in way:
            table = table[key]
        table[last] = other(table[last])
        passed |= {place} if unnoticed(card) else set()
        if not isinstance(table[last], float):  # those are figures, and there are many
            del table[last]
            # Cards of earlier versions say no cover: theirs is shirt and trousers.
            assert place == ("cover",) or not unnoticed(card), f"without {place}"
    assert passed == PROVENANCE and len(places) > 450


@pytest.mark.slow
@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("card['protocol'] = '1'", "protocol is '1'; this version has '2'"),
        ("card['format'] = 'x'", "format is 'x', not a cloak card"),
        ("card['size'] = 'huge'", "size is 'huge', none of quick, standard, full, tiny"),
        ("card['made'] = {}", "made has no 'cloak'"),
        ("card['made']['cloak'] = 'a\\nb'", "made.cloak: 'a\\nb' is not a line of text"),
        ("card['operating_point'] = float('nan')", "operating_point: nan is not a number from 0 to 1"),
        ("card['operating_point'] = 0.9", "clean.0.npz: operating point: {0.25}; this card and its size ask for {0.9}"),
        ("card['photographs'] = None", "people.0.npz: of no part of the card"),
        ("card['black_box']['worst'] = None", "black_box.worst is None; computed anew it is 'builtin-sample'"),
        ("card['extra'] = 1", "extra is no part of a card"),
        ("card['patterns'][0]['name'] = '../x'", "patterns[0].name: '../x' is not a name"),
    ],
)
def test_what_does_not_hold_is_one_line(statement: str, said: str, cards: Path, tmp_path: Path, cloak) -> None:
    folder = change(cards / "glow", statement)
    code, _, words = cloak("leaderboard", "add", folder / "card.json", "--to", tmp_path / "board")
    assert code == 2 and said in words.replace("\n", " ") and not (tmp_path / "board").exists()


@pytest.mark.slow
def test_a_card_is_held_against_detectors_and_other_cards(cards: Path, tmp_path: Path) -> None:
    detector = Bulb("glow")
    detector.operating_point_assumed = False
    with pytest.raises(InputError, match="operating_point_assumed differs from that of the detector at hand"):
        add_cards([cards / "glow"], tmp_path / "board", {"glow": detector})
    (joined,) = add_cards([cards / "glow"], tmp_path / "board", {"glow": Bulb("glow")})
    change(cards / "glow", "card['materials']['detectors']['glow'] = 'f' * 64")
    with pytest.raises(InputError, match=rf"materials.detectors.glow differs .* {joined}.*they do not compare"):
        add_cards([cards / "glow"], tmp_path / "board", {})
    shutil.copytree(cards / "dark", cards / "twin")
    with pytest.raises(InputError, match=r"two cards are of dark:net\.onnx, size tiny"):
        add_cards([cards / "dark", cards / "twin"], tmp_path / "board", {})
    shutil.rmtree(cards / "dark/rows")
    with pytest.raises(InputError, match=r"clean\.0\.npz: no such file"):
        read_entry(cards / "dark")
    with pytest.raises(InputError, match=r"holds no card \(NAME/card.json\)"):
        build_board(tmp_path / "empty")


# --- what becomes of folders


@pytest.mark.slow
@pytest.mark.parametrize("named", [".", "card.json", "..", "glow"])
def test_nothing_that_is_not_a_card_is_removed(named: str, cards: Path, monkeypatch: pytest.MonkeyPatch, cloak) -> None:
    """A leaderboard with files of its own, which is a card's folder itself; `add` is called within it."""
    for name in (".git/HEAD", "README.md", "glow/notes.txt", "rows/mine.txt"):
        (cards / name).parent.mkdir(exist_ok=True)
        (cards / name).write_text("mine")
    shutil.copytree(cards / "dark", cards, dirs_exist_ok=True)
    before = contents(cards.parent)
    monkeypatch.chdir(cards)
    code, _, err = cloak("leaderboard", "add", named, "--to", ".")
    after = contents(cards.parent)
    gone = {name for name in before if after.get(name) != before[name]}
    replaced = {".": "cards/dark/", "card.json": "cards/dark/", "glow": "cards/glow/card.json", "..": "none"}[named]
    assert code == (2 if named == ".." else 0), err
    assert all(name.startswith(replaced) for name in gone) and bool(gone) == (named != "..")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "target"),
    [
        ("card.json", "/etc/passwd"),
        ("pictures.json", "/dev/zero"),
        ("rows/clean.0.npz", "/dev/zero"),
        ("pictures/clean/bare-00001.jpg", "/etc/passwd"),
        ("rows", "rows-elsewhere"),
        ("pictures/clean", "clean-elsewhere"),
    ],
)
def test_links_are_not_followed(place: str, target: str, cards: Path, tmp_path: Path) -> None:
    link = cards / "glow" / place
    if "elsewhere" in target:
        target = tmp_path / target
        shutil.move(link, target)
    else:
        link.unlink()
    link.symlink_to(target)
    with pytest.raises(InputError, match=rf"{re.escape(place)}: a link; a card's folder holds its files themselves"):
        add_cards([cards / "glow"], tmp_path / "board", {})
    assert not (tmp_path / "board").exists()
    (tmp_path / "board").mkdir()
    (tmp_path / "board/dark").symlink_to(cards / "dark")
    with pytest.raises(InputError, match="dark: a link; a leaderboard holds its cards themselves"):
        build_board(tmp_path / "board")


@pytest.mark.slow
def test_a_copy_that_fails_leaves_the_card_that_is_there(
    cards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (first,) = add_cards([cards / "glow"], tmp_path / "board", {})
    before = contents(tmp_path / "board")
    change(cards / "glow", "card['seconds'] = 1")

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(entry, "save_picture", full)
        with pytest.raises(InputError, match="cannot be written"):
            add_cards([cards / "glow"], tmp_path / "board", {})
    assert contents(tmp_path / "board") == before
    (second,) = add_cards([cards / "glow"], tmp_path / "board", {})
    assert second != first and list((tmp_path / "board").iterdir()) == [second], "it takes the older one's place"


@pytest.mark.slow
def test_pictures_are_drawn_anew_and_only_those_of_the_card(cards: Path, tmp_path: Path) -> None:
    folder, secret = cards / "glow", b"<script>alert(1)</script>"
    with (folder / "pictures/clean/bare-00001.jpg").open("ab") as file:
        file.write(secret)
    (folder / "pictures/clean/more.jpg").write_bytes(secret)
    (joined,) = add_cards([folder], tmp_path / "board", {})
    copied = contents(joined)
    assert "pictures/clean/bare-00001.jpg" in copied and "pictures/clean/more.jpg" not in copied
    assert not any(secret in data for data in copied.values())
    pictures = json.loads((folder / "pictures.json").read_text())
    for key, value, said in (
        ("body", "somebody else", "body is 'somebody else'; computed anew it is"),
        ("clothing", {"file": "../../card.json", "boxes": {}, "scores": {}}, "is not the name of a picture"),
        ("clothing", {"file": "large.jpg", "boxes": {}, "scores": {}}, "larger than the card's pictures"),
    ):
        Image.new("RGB", (49, 49)).save(folder / "pictures/clean/large.jpg")
        shown = {**pictures, "missed": [pictures["missed"][0] | {key: value}]}
        write_json(folder / "pictures.json", shown)
        with pytest.raises(InputError, match=said):
            read_entry(folder)


@pytest.mark.slow
def test_names_bring_no_html_into_markdown(cards: Path) -> None:
    name = "python:<img src=x onerror=alert(1)>|[here](javascript:alert(1))"
    folder = change(cards / "glow", f"card['spec'], card['made']['torch'] = {name!r}, '<b>2</b>'")
    write_card(folder)
    write_leaderboard([json.loads((folder / "card.json").read_text())], cards / "leaderboard.md")
    for page in (folder / "card.md", folder / "model_card.md", cards / "leaderboard.md"):
        body = page.read_text().rpartition("---\n")[2]
        assert "alert" in body and not re.search(r"<(?!br>)|(?<!\\)\[here", body), page.name
