"""One entry of the zoo: two small files, NAME.npz (colours, faces, the run's configuration) and NAME.json for people.

Colours are rounded to 1/255, as in any texture; faces are a bit each. Read back, an entry is a run folder like any
other, without what only resuming needs.
"""

from __future__ import annotations

import logging
import os
import re
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float32
from PIL import Image

from cloak_core.core.logo import Logo
from cloak_core.core.pictures import save_picture
from cloak_core.core.run_config import write_config
from cloak_core.exchange.cloth import CLOTH_FILE
from cloak_core.exchange.face_lists import read_colors, read_face_list, write_colors, write_face_list
from cloak_core.files.caching import cache_folder
from cloak_core.files.errors import InputError, suggestion
from cloak_core.files.identity import sha256_arrays, sha256_record
from cloak_core.files.reading import parse_json, read_json, read_npz
from cloak_core.files.writing import new_folder, require_new, write_json

FORMAT = "cloak zoo 1"
NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")


@dataclass(frozen=True, eq=False)
class Entry:
    """Colours [L, 3] float32 of the faces `ids` [L] int64, and their record."""

    record: dict
    config: dict
    """The run's config.json, as far as an evaluation asks for it."""
    colors: np.ndarray
    ids: np.ndarray
    cloth: np.ndarray | None = None
    """The cloth that repeats, uint8 [count, count, 3], where the colours are of one."""

    def write_run(self, folder: Path) -> Path:
        """Make a run folder of it. InputError: it exists and holds something."""
        require_new(folder)
        with new_folder(folder) as temporary:
            write_config(temporary, self.config)
            write_json(temporary / "zoo.json", self.record)
            write_face_list(temporary / "logo.npy", self.ids, self.config["topology"])
            write_colors(temporary / "colors.npy", self.colors)
            if self.cloth is not None:
                save_picture(temporary / CLOTH_FILE, Image.fromarray(self.cloth))
        return folder


def read_entry(folder: Path, name: str) -> Entry:
    """Read entry NAME of a folder. InputError: there is none, or its files are damaged or of another version."""
    if not NAME.fullmatch(name) or not (folder / f"{name}.json").exists():
        raise InputError(f"zoo:{name}: no such entry{suggestion(name, names(folder))} (cloak zoo list)")
    path = folder / f"{name}.npz"
    record, arrays = read_json(folder / f"{name}.json"), read_npz(path)
    if record.get("format") != FORMAT:
        raise InputError(f"{folder / name}.json: format {record.get('format')!r}, this version reads {FORMAT!r}")
    try:
        count, colors = int(record["face_count"]), arrays["colors"]
        config = parse_json(arrays["config"].tobytes(), str(path))
        config["cover"] = record.get("cover")
        ids = np.flatnonzero(np.unpackbits(arrays["faces"], count=count)).astype(np.int64)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: not a zoo entry ({error})") from None
    if colors.dtype != np.uint8 or colors.shape != (len(ids), 3) or sha256_arrays(colors) != record.get("colors"):
        raise InputError(f"{path}: damaged: its colours are not those of its record")
    return Entry(record, config, colors.astype(np.float32) / 255, ids, arrays.get("cloth"))


def names(folder: Path) -> list[str]:
    """List the entries of a folder, sorted."""
    return sorted(path.stem for path in folder.glob("*.json") if path.with_suffix(".npz").exists())


def mean_success(judged: dict) -> float | None:
    """Average success over the detectors that an evaluation in a record asked; None where there is none."""
    rates = [figures["logo"]["success"] for figures in judged.get("detectors", {}).values()]
    return round(float(np.mean(rates)), 4) if rates else None


SHELF = Path(__file__).parent / "entries"
MARK = "zoo:"
_log = logging.getLogger("cloak")
_TEMPORARY: list[tempfile.TemporaryDirectory] = []
"""Where nothing is cached: gone when the process ends."""


def shelved() -> list[str]:
    """List the names of all entries."""
    return names(SHELF)


def entry(name: str) -> Entry:
    """Read an entry by its name, with or without `zoo:`. InputError: there is none."""
    return read_entry(SHELF, name.removeprefix(MARK))


def run_path(named: str | os.PathLike) -> Path:
    """Give the path itself; for `zoo:NAME`, a run folder with that entry's colours, logo and record.

    The folder of a sweep stands for its run with the highest success in training.
    """
    text = os.fspath(named)
    return _run_of(text.removeprefix(MARK)) if text.startswith(MARK) else best_run(Path(text))


def best_run(folder: Path) -> Path:
    """Find the best run of a sweep's folder; any other path stays. InputError: none of its runs has ended."""
    if not (folder / "sweep.json").is_file():
        return folder
    rows = read_json(folder / "sweep.json").get("results")
    rows = [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    ended = [row for row in rows if isinstance(row.get("success"), (int, float)) and isinstance(row.get("out"), str)]
    if not ended:
        raise InputError(f"{folder}: a sweep of which no run has ended")
    best = folder / "runs" / Path(max(ended, key=lambda row: row["success"])["out"]).name
    _log.info("%s: its run with the highest success in training is %s", folder, best.name)
    return best


@cache
def _run_of(name: str) -> Path:
    record, folder = entry(name), cache_folder("zoo")
    # Named by content: another version's entry of the same name is another folder.
    place = f"{name}-{sha256_record(record.record)[:12]}"
    if folder is not None:
        run = folder / place
        try:
            return run if (run / "colors.npy").exists() else record.write_run(run)
        except InputError as error:
            if (run / "colors.npy").exists():  # another process was quicker
                return run
            _log.warning("%s: entries of the zoo are not kept (%s)", folder, error)
    _TEMPORARY.append(tempfile.TemporaryDirectory(prefix="cloak-zoo-"))
    return record.write_run(Path(_TEMPORARY[-1].name) / place)


def read_start(path: Path, logo: Logo, option: str = "--init") -> Float32[np.ndarray, "L 3"]:
    """Read colours [L, 3] to begin with: a file of them, or a run (or zoo:NAME) of the same logo. InputError."""
    path = run_path(path)
    if not path.is_dir():
        return read_colors(path, len(logo.face_ids))
    if not (path / "config.json").exists():
        raise InputError(f"{option} {path}: not a run folder (no config.json in it)")
    trained = read_face_list(path / "logo.npy")
    if trained.topology != logo.topology or not np.array_equal(trained.ids, logo.face_ids):
        raise InputError(f"{option} {path}: was trained on another logo (`cloak logo transfer` carries colours over)")
    return read_colors(path / "colors.npy", len(logo.face_ids))
