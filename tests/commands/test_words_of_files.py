"""Every string of every file we read, replaced: nothing runs, nobody is asked, nothing outside changes, one line."""

import contextlib
import json
import shutil
import socket
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from cloak_core import cli
from tests.commands.malformed.making import DETECTOR, RESUME, TRAIN, sound

SMALL = "--size 32 --samples 1 --threads 1 --scene scene --backgrounds photos"
EVALUATE = f"evaluate run {SMALL} --angles 0 --bare 1 --most-images 1 --shift 0"
READERS = {
    "run/config.json": (
        EVALUATE,
        f"film run {SMALL} --fps 1 --seconds 1 --out new",
        RESUME,
    ),
    "run/evaluation/summary.json": ("report run",),
    "run/evaluation/pictures.json": ("report run",),
    "run/logo.json": (EVALUATE,),
    "scene/scene.json": ("scene info scene",),
    "grid.toml": ("sweep grid.toml --out new",),
    "settings.toml": (TRAIN + "--config settings.toml",),
}
MINUTES = {"run/config.json", "run/evaluation/summary.json", "run/evaluation/pictures.json"}
CODE = "from pathlib import Path\nPath(__file__).with_name('ran').touch()\n"
SPECS = ("jpeg=75:python:evil.py:make", "transformers:evil/model", "https://evil.example/a.onnx", "../outside/secret")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("words") / "sound"
    folder.mkdir()
    sound(folder)
    (folder / "evil.py").write_text(CODE)
    (folder / "settings.toml").write_text("preset = 'best'\noptimizer = 'adam'\n")
    (folder / "grid.toml").write_text(
        "[base]\nscene = 'scene'\nlogo = 'logo.npy'\nsteps = 1\nbackgrounds = 'photos'\n"
        f"[grid]\ndetector = ['{DETECTOR}']\n"
    )
    with contextlib.chdir(folder):
        assert run(EVALUATE) == 0
    return folder


def run(line: str) -> int:
    try:
        cli.main(line.split())
    except SystemExit as end:
        return end.code or 0
    return 0


def places(value: object, at: tuple = ()) -> Iterator[tuple]:
    """Where a record holds strings; of a list of equals the first."""
    if isinstance(value, str):
        yield at
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value if isinstance(value, list) else []):
        yield from places(inner, (*at, key))


def write(path: Path, record: dict) -> None:
    if path.suffix == ".json":
        path.write_text(json.dumps(record))
        return
    flat = {key: value for key, value in record.items() if not isinstance(value, dict)}
    tables = {None: flat} | {key: value for key, value in record.items() if isinstance(value, dict)}
    lines = (
        (f"[{name}]\n" if name else "") + "".join(f"{key} = {json.dumps(value)}\n" for key, value in table.items())
        for name, table in tables.items()
    )
    path.write_text("".join(lines))


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.long] * (n in MINUTES)) for n in READERS])
def test_no_string_of_a_file_runs_code_or_asks_anybody(name: str, made: Path, tmp_path: Path, monkeypatch, capsys):
    asked: list = []
    refuse = lambda *words, **options: asked.append(words) or (_ for _ in ()).throw(OSError("no network"))
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    monkeypatch.setattr(socket.socket, "connect", refuse)
    text = (made / name).read_text()
    record = json.loads(text) if name.endswith(".json") else tomllib.loads(text)
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "secret").write_text("mine")
    # Each place meets each spec (of a slow reader, one), and each place, like each spec, meets each command in turn.
    for k, at in enumerate(places(record)):
        for j, spec in enumerate([SPECS[k % len(SPECS)]] if READERS[name] == ("report run",) else SPECS):
            line = READERS[name][(k + j) % len(READERS[name])]
            changed = json.loads(json.dumps(record))
            holder = changed
            for key in at[:-1]:
                holder = holder[key]
            holder[at[-1]] = spec
            here = tmp_path / "case"
            shutil.copytree(made, here)
            write(here / name, changed)
            with contextlib.chdir(here):
                code = run(line)
            said, what = capsys.readouterr().err, f"{name}: {at} = {spec}: {line}"
            assert code in (0, 2) and "Traceback" not in said, f"{what}: {code} {said}"
            assert not (here / "ran").exists() and not asked, what
            assert [path.read_text() for path in outside.iterdir()] == ["mine"], what
            shutil.rmtree(here)
