"""Files are read and written through `cloak_core.files`, pictures through `core.pictures`, never by hand."""

import ast
from pathlib import Path

CORE = Path(__file__).parents[2] / "cloak_core"
APART = (
    "files",
    "bench",
    "core/pictures.py",
    "sources/bodies/blender/inside.py",
    "jobs/ray_cluster.py",
    "jobs/processes.py",
    "commands/remote.py",
)
"""The rooms for it, what measures, a script that runs in Blender, the process table, pipes between our own processes,
and streams to another machine."""
OF_PATHS = {"read_bytes", "read_text", "write_bytes", "write_text"}
OF_MODULES = {
    "np": {"load", "save", "savez", "savez_compressed", "fromfile", "memmap", "genfromtxt"},
    "os": {"replace", "rename", "mkfifo"},
    "tempfile": {"mkstemp", "NamedTemporaryFile"},
    "Image": {"open"},
    "io": {"open"},
    "json": {"load", "loads"},
    "tomllib": {"load", "loads"},
    "pickle": {"load", "loads"},
}


def by_hand(call: ast.Call) -> bool:
    match call.func:
        case ast.Name(id="open"):
            return True
        case ast.Attribute(value=ast.Name(id=owner), attr=name) if owner in OF_MODULES:
            return name in OF_MODULES[owner]
        case ast.Attribute(attr="open", value=owner):
            modes = [a.value for a in call.args[:1] if isinstance(a, ast.Constant) and isinstance(a.value, str)]
            return not (isinstance(owner, ast.Name) and owner.id == "os") and (bool(modes) or not call.args)
        case ast.Attribute(attr=name):
            return name in OF_PATHS
    return False


def files() -> list[Path]:
    return [p for p in sorted(CORE.rglob("*.py")) if not p.relative_to(CORE).as_posix().startswith(APART)]


def test_nobody_opens_files_by_hand() -> None:
    """All files are read in one test: a test for each takes longer than reading it."""
    calls = [(p, n) for p in files() for n in ast.walk(ast.parse(p.read_text("utf-8"))) if isinstance(n, ast.Call)]
    assert calls
    assert not [f"{p.name}:{call.lineno}: {ast.unparse(call)[:80]}" for p, call in calls if by_hand(call)]
