"""Whether an evaluation's bodies and backgrounds were really kept from the training."""

from __future__ import annotations

from pathlib import Path

from cloak_core.exchange.bodies import Bodies
from cloak_core.files.identity import sha256_arrays
from cloak_core.files.reading import read_json
from cloak_core.scene.backdrops.backgrounds import Backgrounds


def training_record(run: Path) -> dict:
    """What a run was trained on: its config.json."""
    return read_json(run / "config.json")


def seen_in_training(config: dict | None, bodies: Bodies, backgrounds: Backgrounds) -> tuple[dict, list[str]]:
    """`unseen` of the summary ({"bodies": bool or None, "backgrounds": bool or None}) and one warning per overlap.

    `config` is a run's config.json. Poses are compared by their geometry, backgrounds by their content. None means
    that the configuration does not tell.
    """
    config = config or {}
    scene, pictures = _part(config, "scene"), _part(config, "backgrounds")
    shared_bodies = _shared_bodies(scene, bodies)
    trained = pictures.get("identities")
    shared_backgrounds = None
    if isinstance(trained, list):
        known = set(map(str, trained))
        pairs = zip(backgrounds.names, backgrounds.identities(), strict=True)
        shared_backgrounds = [name for name, identity in pairs if identity in known]
    warnings = []
    for kind, shared in (("bodies", shared_bodies), ("backgrounds", shared_backgrounds)):
        if shared:
            few = ", ".join(shared[:3]) + (" ..." if len(shared) > 3 else "")
            warnings.append(f"{len(shared)} of the {kind} were in the training set ({few}): success is not unseen")
        elif shared is None and config:
            warnings.append(f"the run does not record its training {kind}: whether these are unseen is not known")
    decide = lambda shared: None if shared is None else not shared
    return {"bodies": decide(shared_bodies), "backgrounds": decide(shared_backgrounds)}, warnings


def trained_against(config: dict | None, hashes: dict[str, str]) -> dict[str, bool | None]:
    """Of each detector, by its name and the hash of its state, whether the colours were trained against it.

    Weights count, not names: the same ones at another input size are no black box. None: `config` does not tell.
    """
    trained = (config or {}).get("detectors")
    if not isinstance(trained, list) or not all(isinstance(entry, dict) for entry in trained):
        return dict.fromkeys(hashes)
    known = {entry.get("sha256") for entry in trained}
    return {name: digest in known for name, digest in hashes.items()}


def pose_hashes(bodies: Bodies) -> list[str]:
    """SHA-256 of every pose's vertices."""
    return [sha256_arrays(vertices) for vertices in bodies.vertices]


def _shared_bodies(scene: dict, bodies: Bodies) -> list[str] | None:
    trained = scene.get("pose_sha256")
    if not isinstance(trained, list):
        return None
    known = set(map(str, trained))
    return [name for name, digest in zip(bodies.names, pose_hashes(bodies), strict=True) if digest in known]


def _part(config: dict, key: str) -> dict:
    part = config.get(key)
    return part if isinstance(part, dict) else {}
