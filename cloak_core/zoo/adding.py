"""Make an entry of the zoo from a finished and evaluated run."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from cloak_core.core.pictures import read_picture
from cloak_core.core.run_config import read_config
from cloak_core.exchange.cloth import CLOTH_FILE
from cloak_core.exchange.face_lists import read_colors, read_face_list
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays
from cloak_core.files.reading import read_json
from cloak_core.files.specs import without_folders
from cloak_core.files.writing import remove_leftovers, write_json, write_npz
from cloak_core.zoo.entry import FORMAT, NAME

_SHOWN = ("success", "success_own", "ci95", "ci95_own", "ap50", "n")
"""Of an evaluation's rates."""


def write_entry(
    folder: Path, name: str, run: Path, *, about: str, licence: str, command: str = "", logo: str | None = None
) -> dict:
    """Make an entry of a finished and evaluated run; returns its record.

    logo: what the logo is called; None: as its file or regions were.

    InputError: a bad name, an unfinished run, or one without an evaluation (`cloak evaluate RUN` leaves it there).
    """
    if not NAME.fullmatch(name):
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
