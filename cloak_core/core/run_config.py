"""Whether a training is the one that a run folder recorded."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from cloak_core.core.settings import settings_from_record, settings_record
from cloak_core.files.columns import read_columns, write_columns
from cloak_core.files.errors import InputError
from cloak_core.files.identity import UNKNOWN
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_json

FILES = {"init": "start", "near": "near", "palette": "palette", "profile": "profile"}
"""Settings that name files, and where a configuration has their content (None: no file)."""
FREE_SETTINGS = (
    "checkpoint_every",
    "preview_every",
    "snapshot_every",
    "max_seconds",
    *FILES,
)
"""What a resumed run may change: nothing of it reaches the colours (of files, it is the content that counts)."""
DECISIVE = {
    "topology": (),
    "settings": (),
    "scene": ("sha256", "identity"),
    "logo": (),
    "detectors": ("sha256", "precision", "compiled", "source", "operating_point"),
    "backgrounds": ("identities",),
    "people": ("sha256", "identity"),
    **dict.fromkeys(FILES.values(), ()),
    "query_prior": ("sha256", "precision", "compiled", "source"),
    "techniques": ("spec", "sha256"),
}
"""The parts of a configuration that decide the result, and what of a part does (all where nothing is named)."""
AROUND = ("torch", "numpy", "device", "threads", "processes")
"""What of the environment may move the last bits of a result."""

MATERIAL = {
    "scene": ("poses", "pose_sha256", "pose_shapes", "pose_spreads"),
    "backgrounds": ("names", "identities", "files", "looks"),
    "people": ("photographs", "licences", "pixels", "looks"),
}
"""Lists that grow with the material: they lie beside config.json (`files.columns`)."""


def write_config(folder: Path, config: Mapping[str, object]) -> None:
    """Write a run's config.json, its lists of material into a file beside it."""
    write_json(folder / "config.json", write_columns(folder, config, MATERIAL))


def read_config(folder: Path) -> dict:
    """Read a run's config.json with its lists of material, which earlier versions kept in it. InputError: damaged."""
    return read_columns(folder, read_json(folder / "config.json"))


def decisive(config: Mapping[str, object], parts: Iterable[str] = tuple(DECISIVE)) -> dict[str, object]:
    """Select what decides the result: trainings whose configurations are equal in this are the same training."""
    return {part: _decisive(part, config[part]) for part in parts if part in config}


def _decisive(part: str, value: object) -> object:
    if part == "settings" and isinstance(value, dict):
        return {name: setting for name, setting in value.items() if name not in FREE_SETTINGS}
    return _only(DECISIVE[part], value)


def check_same(recorded: dict, config: dict, path: Path) -> None:
    """Check that `config` is what the run at `path` recorded, in all that decides the result.

    InputError names the first difference.

    What versions before this one did not record is not compared.
    """
    for part in DECISIVE:
        old = recorded.get(part)
        new = config.get(part)
        if part == "settings" and isinstance(old, dict):
            # What a run of an earlier version had not heard of, it did as the default has it.
            try:
                old = settings_record(settings_from_record(old))
            except InputError as error:
                raise InputError(f"{path / 'config.json'}: {error}") from None
        if part == "backgrounds" and isinstance(old, dict) and "files" not in old:
            # Earlier versions knew an image by its file alone.
            new = {"identities": [file or own for file, own in zip(new["files"], new["identities"], strict=True)]}
        name, before, now = _difference(part, _decisive(part, old), _decisive(part, new))
        if name:
            longer = " (--extend N makes a run longer)" if name in ("settings.steps", "settings.epochs") else ""
            raise InputError(
                f"{path}: was started with {name} = {before}, not {now}; resume with the same settings{longer}"
            )


def changes_around(recorded: dict, config: dict) -> list[str]:
    """List differences from the recorded run that move the last bits of the result at most."""
    changes = []
    if recorded.get("code") != config["code"]:
        changes.append(f"other code (of Cloak {recorded.get('cloak', 'unknown')})")
    pairs = [(recorded.get("environment"), {name: config["environment"][name] for name in AROUND})]
    old = recorded.get("detectors")
    pairs += [(o.get("packages"), n["packages"]) for o, n in zip(old or [], config["detectors"], strict=True)]
    for before, now in pairs:
        before = before if isinstance(before, dict) else {}
        changes += [f"{k} {before[k]} instead of {now[k]}" for k in now if k in before and before[k] != now[k]]
    return list(dict.fromkeys(changes))


def _only(keys: Sequence[str], value: object) -> object:
    if isinstance(value, list):
        return [_only(keys, item) for item in value]
    return {k: v for k, v in value.items() if k in keys} if keys and isinstance(value, dict) else value


def _difference(name: str, old: object, new: object) -> tuple[str, object, object]:
    """Name and both values of the first difference; "" as the name where there is none."""
    pairs = []
    if isinstance(old, dict) and isinstance(new, dict):
        pairs = [(f"{name}.{key}", old[key], new.get(key)) for key in sorted(old)]
    elif isinstance(old, list) and isinstance(new, list):
        if len(old) != len(new):
            return f"the number of {name}", len(old), len(new)
        pairs = [(f"{name}[{i}]", *both) for i, both in enumerate(zip(old, new, strict=True))]
    elif old != new and not all(str(value).startswith(UNKNOWN) for value in (old, new)):
        return name, old, new
    return next((difference for pair in pairs if (difference := _difference(*pair))[0]), ("", None, None))
