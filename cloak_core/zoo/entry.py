"""One entry of the zoo: two small files, NAME.npz (colours, faces, the run's configuration) and NAME.json for people.

Colours are rounded to 1/255, as in any texture; faces are a bit each. Read back, an entry is a run folder like any
other, without what only resuming needs.
"""

from __future__ import annotations

import json
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
from cloak_core.core.pictures import read_picture, save_picture
from cloak_core.core.run_config import read_config, write_config
from cloak_core.exchange.cloth import CLOTH_FILE
from cloak_core.exchange.face_lists import read_colors, read_face_list, write_colors, write_face_list
from cloak_core.files.caching import cache_folder
from cloak_core.files.errors import InputError, suggestion
from cloak_core.files.identity import sha256_arrays, sha256_record
from cloak_core.files.reading import parse_json, read_json, read_npz
from cloak_core.files.specs import without_folders
from cloak_core.files.writing import new_folder, remove_leftovers, require_new, write_json, write_npz

FORMAT = "cloak zoo 1"
_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")
_SHOWN = ("success", "success_own", "ci95", "ci95_own", "ap50", "n")
"""Of an evaluation's rates."""


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
    if not _NAME.fullmatch(name) or not (folder / f"{name}.json").exists():
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


def write_entry(
    folder: Path, name: str, run: Path, *, about: str, licence: str, command: str = "", logo: str | None = None
) -> dict:
    """Make an entry of a finished and evaluated run; returns its record.

    logo: what the logo is called; None: as its file or regions were.

    InputError: a bad name, an unfinished run, or one without an evaluation (`cloak evaluate RUN` leaves it there).
    """
    if not _NAME.fullmatch(name):
        raise InputError(f"--name {name}: small letters, digits, dots and dashes")
    config, faces = read_config(run), read_face_list(run / "logo.npy")
    colors = np.round(255 * read_colors(run / "colors.npy", len(faces.ids))).astype(np.uint8)
    if not (run / "evaluation" / "summary.json").exists():
        raise InputError(f"{run}: has no evaluation yet (cloak evaluate {run})")
    mask = np.zeros(config["scene"]["faces"], bool)
    mask[faces.ids] = True
    config = _kept(config)
    summary = read_json(run / "evaluation" / "summary.json")
    called = logo or Path(config["inputs"].get("logo", "logo")).stem
    record = {
        "format": FORMAT,
        "name": name,
        "about": about,
        "licence": licence,
        "command": without_folders(command),
        "seed": config["settings"]["seed"],
        "detectors": [detector["spec"] for detector in config["detectors"]],
        "logo": called,
        "cover": config.get("cover") or called,
        "faces": len(faces.ids),
        "face_count": len(mask),
        "colors": sha256_arrays(colors),
        "topology": config["topology"],
        "cloak": config["cloak"],
        "evaluation": _judged(summary, "unseen", "settings")
        | {"inputs": {key: summary["inputs"][key] for key in ("bodies", "scene", "backgrounds")}},
        **_photographs(run, config),
    }
    for end in ("npz", "json"):
        remove_leftovers(folder / f"{name}.{end}")
    config_bytes = np.frombuffer(json.dumps(config, separators=(",", ":"), allow_nan=False).encode(), np.uint8)
    cloth = {"cloth": read_picture(run / CLOTH_FILE)} if (run / CLOTH_FILE).exists() else {}
    write_npz(
        folder / f"{name}.npz", compressed=True, colors=colors, faces=np.packbits(mask), config=config_bytes, **cloth
    )
    write_json(folder / f"{name}.json", record)
    return record


def _kept(config: dict) -> dict:
    """Strip a run's configuration of folders and of what only resuming asks for."""
    kept = {key: value for key, value in config.items() if key not in ("environment", "held_out")}
    kept["inputs"] = {key: without_folders(value) for key, value in config["inputs"].items()}
    kept["detectors"] = []
    for detector in config["detectors"]:
        unplaced = detector | {"spec": without_folders(detector["spec"])}
        source = detector.get("source")
        if isinstance(source, dict) and isinstance(source.get("spec"), str):
            unplaced["source"] = source | {"spec": without_folders(source["spec"])}
        kept["detectors"].append(unplaced)
    pictures = config["backgrounds"]
    kept["backgrounds"] = {key: pictures[key] for key in ("count", "identities", "looks") if key in pictures}
    for part in ("backgrounds", "people"):
        material = kept.get(part)
        if isinstance(material, dict) and isinstance(material.get("looks"), list):
            # Without the small copies, which would ship somebody's photographs: of backgrounds and of people.
            kept[part] = material | {"looks": [str(look).partition(".")[0] for look in material["looks"]]}
    return kept


def _judged(summary: dict, *keys: str) -> dict:
    """Choose what the record keeps of an evaluation, made before the colours were rounded to 1/255.

    These keys as they are, and what is known by detector, without folders.
    """
    kept = {key: summary[key] for key in keys if key in summary}
    for key in ("false_alarms", "white_box", "operating_points"):
        kept[key] = {without_folders(spec): value for spec, value in summary.get(key, {}).items()}
    worn = ("logo", *summary["settings"]["controls"])
    kept["detectors"] = {
        without_folders(spec): {
            name: {key: figures[name].get(key) for key in _SHOWN} for name in worn if name in figures
        }
        for spec, figures in summary["detectors"].items()
    }
    return kept


def _photographs(run: Path, config: dict) -> dict:
    """Record the photographs that training saw, by name and licence, and an evaluation on others."""
    record: dict = {}
    if config.get("people"):
        seen = config["people"]
        record["trained_on"] = dict(zip(seen["photographs"], seen["licences"], strict=True))
    folder = run / "evaluation-people"
    if (folder / "summary.json").exists():
        record["people"] = _judged(read_json(folder / "summary.json"), "people", "photographs", "unseen")
    elif (folder / "wear.json").exists():
        # Earlier versions told white boxes and unseen photographs by names alone.
        raise InputError(f"{folder}: of an earlier version: evaluate on people again, or remove it")
    return record


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
