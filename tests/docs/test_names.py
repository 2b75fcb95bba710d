"""Files and modules that documents and docstrings name are there, so that a move leaves no name behind."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CORE = ROOT / "cloak_core"
ROOMS = {path.name for path in CORE.iterdir() if (path / "__init__.py").exists()}
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
SOURCES = sorted(path for room in (CORE, ROOT / "blender_addon", ROOT / "tools") for path in room.rglob("*.py"))
PATH = re.compile(rf"`((?:[\w-]+/)*[\w*-]+\.py|(?:cloak_core|{'|'.join(ROOMS)})(?:/[\w-]+)+/?)`")
BARE = re.compile(r"(?<![`\w./-])([a-z_]\w*\.py)\b")
"""A path without backticks, as comments and headers have it."""
DOTTED = re.compile(r"`((?:[a-z_]+\.)+\w+)`")
MODULES = {path.relative_to(ROOT).with_suffix("").as_posix() for path in CORE.rglob("*.py")}
MODULES |= {path.parent.relative_to(ROOT).as_posix() for path in CORE.rglob("__init__.py")}
NAMES = {module.rsplit("/")[-1] for module in MODULES}
ELSEWHERE = {"output.layout", "builtin.cfg", "builtin.weights"}
"""Keys of a file, and files: their last part is also the name of a module."""
WRITTEN = {"train.py", "hardened.py"}
"""What users call a file of theirs, and what hardening writes."""


def missing_paths(text: str) -> set[str]:
    """Paths in backticks that no file ends in, and folders below rooms that are not there."""
    return {name for name in PATH.findall(text) if not is_there(name)} - WRITTEN


def is_there(name: str) -> bool:
    if (ROOT / name).exists() or (CORE / name).exists():
        return True
    tops = ("cloak_core", "blender_addon", "tools", "tests", "examples")
    return name.endswith(".py") and any(any((ROOT / top).rglob(name)) for top in tops)


def missing_modules(text: str) -> set[str]:
    """Dotted names in backticks, `room.module.name`, that go through a module which is not where they say."""
    return {name for name in DOTTED.findall(text) if name not in ELSEWHERE and not resolves(name.split("."))}


def resolves(parts: list[str]) -> bool:
    """Whether modules in the name lie in the packages before them; names without a module are variables."""
    if len(set(parts)) < len(parts):  # a function of its module's name
        parts = parts[:-1]
    last = max((place for place, part in enumerate(parts) if place and part in NAMES), default=0)
    return not last or any(f"/{module}".endswith("/" + "/".join(parts[: last + 1])) for module in MODULES)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_files_that_a_page_names_are_there(page: Path) -> None:
    assert not missing_paths(page.read_text("utf-8"))


def test_files_and_modules_that_docstrings_name_are_there() -> None:
    missing = {}
    for path in SOURCES:
        strings = (
            node.value for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.Constant)
        )
        text = "\n".join(value for value in strings if isinstance(value, str))
        bare = {name for name in BARE.findall(text) if not is_there(name)} - WRITTEN
        if names := missing_paths(text) | missing_modules(text) | bare:
            missing[path.relative_to(ROOT).as_posix()] = names
    assert not missing
