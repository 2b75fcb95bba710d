"""Rooms import downwards only, and the ground floor needs numpy alone."""

import ast
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from cloak_core.core.detector.protocol import at_least_float32
from cloak_core.files.caching import cache_folder

CORE = Path(__file__).parents[1] / "cloak_core"
ADD_ON = CORE.with_name("blender_addon")
MAY_IMPORT = {
    "files": set(),
    "jobs": {"files"},
    "exchange": {"files"},
    "core": {"files", "exchange"},
    "patterns": {"files", "exchange", "core"},
    "zoo": {"files", "exchange", "core"},
    "sources": {"files", "jobs", "exchange", "core"},
    "detectors": {"files", "exchange", "core", "sources"},
    "techniques": {"files", "exchange", "core", "sources", "patterns", "zoo"},
    "studies": {"files", "jobs", "exchange", "core", "patterns", "zoo", "sources", "detectors", "techniques"},
    "products": {"files", "exchange", "core", "patterns", "sources", "studies"},
    "experiments": {"files", "exchange", "core", "patterns", "sources", "detectors", "studies"},
    "library": {"files", "exchange", "core", "patterns", "zoo", "sources", "detectors", "studies"},
}
"""Nobody imports `experiments`, `library` and `bench` but the commands; these are imported by the command line alone.

tools/draw_rooms.py draws this table for the page for contributors."""
TOP = {"commands", "cli", "bench", "__main__", "__init__"}


def test_types_and_shapes_of_what_the_tests_import_are_checked() -> None:
    with pytest.raises(TypeCheckError):
        cache_folder(3)
    with pytest.raises(TypeCheckError):
        at_least_float32(np.zeros(3, np.float32))


def room_of(path: Path) -> str:
    return path.relative_to(CORE).parts[0].removesuffix(".py")


@cache
def imported(path: Path) -> set[str]:
    """Modules that a file imports anywhere, also inside functions; relative ones resolved."""
    return names_imported(ast.parse(path.read_text("utf-8")), path)


def names_imported(tree: ast.AST, path: Path) -> set[str]:
    root = ADD_ON if path.is_relative_to(ADD_ON) else CORE
    package = path.relative_to(root.parent).parts[:-1]
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*above, *([node.module] if node.module else [])])
            found |= {f"{module}.{alias.name}" for alias in node.names} | {module}
    return found


def rooms_imported(path: Path) -> set[str]:
    return {name.split(".")[1] for name in imported(path) if name.startswith("cloak_core.")}


FILES = [path for path in sorted(CORE.rglob("*.py")) if room_of(path) not in TOP]


@pytest.mark.slow
def test_a_room_imports_only_the_rooms_below_it():
    """All files are read in one test: a test for each takes longer than reading it."""
    assert {room_of(path) for path in FILES} <= MAY_IMPORT.keys(), "a room has no place among the rooms yet"
    above = {path: rooms_imported(path) - {room_of(path), "__version__"} - MAY_IMPORT[room_of(path)] for path in FILES}
    assert not {path.relative_to(CORE).as_posix(): rooms for path, rooms in above.items() if rooms}


@pytest.mark.slow
@pytest.mark.parametrize("room", ["experiments", "library", "bench", "commands"])
def test_nobody_below_imports_what_stands_above(room):
    for path in CORE.rglob("*.py"):
        if room_of(path) not in (room, "commands", "cli", "__init__"):
            assert room not in rooms_imported(path), path


def loaded_by(path: Path) -> set[str]:
    """Modules that a file loads at run time: at its top or inside functions, but not for type checkers alone."""
    tree = ast.parse(path.read_text("utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = []
    return names_imported(tree, path)


@pytest.mark.slow
@pytest.mark.parametrize(("root", "of_file"), [(CORE, loaded_by), (ADD_ON, imported)], ids=["core", "add-on"])
def test_no_files_import_each_other_in_a_circle(root, of_file):
    """An import inside a function counts, too: it only hides the circle. In the add-on types count as well.

    `__init__` files count as themselves.
    """
    name_of = lambda path: ".".join(path.relative_to(root.parent).with_suffix("").parts).removesuffix(".__init__")
    paths = {name_of(path): path for path in root.rglob("*.py")}
    graph = {name: (of_file(path) & paths.keys()) - {root.name} for name, path in paths.items()}
    for name in paths:
        # `from package import module` names both; the package alone is meant where the name is no module.
        graph[name] -= {other for other in graph[name] if any(o.startswith(f"{other}.") for o in graph[name])}
    circles = set()
    for start in graph:
        seen, todo = set(), list(graph[start])
        while todo:
            name = todo.pop()
            if name not in seen:
                seen.add(name)
                todo += graph[name]
        if start in seen:
            circles.add(start)
    assert not circles


@pytest.mark.parametrize("room", ["files", "exchange"])
def test_what_the_extension_ships_needs_numpy_and_the_standard_library_alone(room):
    for path in (CORE / room).glob("*.py"):
        outside = {name.split(".")[0] for name in imported(path)} - {"cloak_core", "numpy"}
        assert outside <= set(sys.stdlib_module_names), path
