"""The site is built without a dead link, opens without a network, and leaves no public name without words."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import griffe
import pytest

import cloak_core
from cloak_core.cli import COMMANDS
from tests.shared_folders import fill_once

ROOT = Path(__file__).parents[2]
FETCHED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=[\"']?(?:https?:)?//[^>]*>")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fill_once(tmp_path_factory, "built-site", build) / "site"


def build(folder: Path) -> None:
    command = [sys.executable, str(ROOT / "tools" / "build_docs.py"), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, env=None)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.long
def test_the_site_has_every_page_and_fetches_nothing(site: Path) -> None:
    pages = {page.relative_to(site).as_posix(): page.read_text("utf-8") for page in site.rglob("*.html")}
    assert {f"docs/{page.stem}.html" for page in (ROOT / "docs").glob("*.md") if page.stem != "index"} <= set(pages)
    assert "docs/tutorial.html" in pages["index.html"]
    fetched = {name: FETCHED.findall(text) for name, text in pages.items() if FETCHED.search(text)}
    assert not fetched
    assert "file-worker.js" in pages["docs/tutorial.html"]
    assert (site / "assets" / "javascripts" / "file-worker.js").exists()


@pytest.mark.long
def test_the_reference_has_every_command_and_every_public_name(site: Path) -> None:
    commands = (site / "docs" / "reference" / "commands.html").read_text("utf-8")
    for name in COMMANDS:
        assert f'id="cloak-{name.replace(" ", "-")}"' in commands, name
    assert "--total-variation" not in commands and "--tv-weight" in commands
    python = (site / "docs" / "reference" / "python.html").read_text("utf-8")
    for name in cloak_core.__all__:
        assert f'id="cloak_core.{name}"' in python, name


def test_the_list_of_commands_says_what_their_help_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    build_docs = importlib.import_module("build_docs")
    written = build_docs.COMMANDS_LIST.read_text("utf-8")
    assert written == build_docs.commands_list(), f"run `make docs` to write {build_docs.COMMANDS_LIST.name} again"


@pytest.mark.slow
def test_no_public_name_is_without_words() -> None:
    package = griffe.load("cloak_core", search_paths=[ROOT], resolve_aliases=True)
    bare = []
    for name in cloak_core.__all__:
        thing = package[name].final_target if package[name].is_alias else package[name]
        members = thing.members.items() if thing.is_class else ()
        own = [member for member, m in members if not (member.startswith("_") or m.is_alias or m.has_docstring)]
        bare += [f"{name}.{member}" for member in own] + [name] * (not thing.has_docstring)
    assert not bare
