"""Files that strangers might send, each with the command line that reads it. Made by hand, and by seeded damage."""

import random
from collections.abc import Callable
from pathlib import Path

from tests.commands.malformed.geometry import face_lists, meshes, scenes
from tests.commands.malformed.inputs import detectors, pictures, settings, special_files
from tests.commands.malformed.making import CHECK, RESUME, TRAIN, Case, sound
from tests.commands.malformed.run_folders import runs
from tests.commands.malformed.tables import tables

__all__ = ["Case", "cases", "sound"]

TARGETS = {
    "logo.npy": TRAIN,
    "logo.json": TRAIN,
    "whole.npz": "scene info whole.npz",
    "scene/scene.json": "scene info scene",
    "triangle.obj": "scene import triangle.obj --out new",
    "triangle.ply": "scene import triangle.ply --out new",
    "triangle.gltf": "scene import triangle.gltf --out new",
    "net.cfg": CHECK + " photo.png",
    "net.weights": CHECK + " photo.png",
    "photo.png": CHECK + " photo.png",
    "settings.toml": TRAIN + "--config settings.toml",
    "palette.txt": TRAIN + "--palette palette.txt",
    "run/config.json": RESUME.replace("--steps 1", "--steps 2"),
    "run/events.jsonl": "report run",
    "run/colors.npy": "print run --out new",
}


def damage(name: str, seed: int) -> Callable[[Path], None]:
    """Bytes flipped, cut, doubled or replaced, as the seed has it."""

    def make(folder: Path) -> None:
        draw = random.Random(f"{name} {seed}")
        data = bytearray((folder / name).read_bytes())
        for _ in range(draw.randint(1, 4)):
            at = draw.randrange(len(data) + 1)
            how = draw.randrange(5)
            if how == 0 and at < len(data):
                data[at] ^= 1 << draw.randrange(8)
            elif how == 1:
                del data[at:]
            elif how == 2:
                data[at:at] = draw.randbytes(draw.randint(1, 20))
            elif how == 3:
                data[at : at + 9] = draw.choice([b"-1", b"99999999999999999999", b"nan", b"\xff" * 9, b"[" * 300, b""])
            else:
                data[at:at] = data[at : at + draw.randint(1, 40)]
        (folder / name).write_bytes(data)

    return make


def cases(damaged: int) -> list[Case]:
    """All by hand, and `damaged` of each target."""
    by_hand = [*face_lists(), *scenes(), *meshes(), *detectors(), *pictures(), *settings(), *runs(), *special_files()]
    by_hand += tables()
    seeded = [
        Case(f"{name}, damaged by seed {seed}", damage(name, seed), line, True)
        for name, line in TARGETS.items()
        for seed in range(damaged)
    ]
    return by_hand + seeded
