"""What the Blender extension ships beside its code: `python tools/blender_assets.py FOLDER`, with cloak_core.

FOLDER/sample is a scene package of some of the sample bodies; FOLDER/NAME a run folder for each cloak of the zoo that
was trained on them. All of it is CC0.
"""

import sys
from pathlib import Path

from cloak_core.exchange.scenes import write_scene
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.zoo.entry import entry, shelved

POSES = 4


def main(folder: Path) -> None:
    bodies = sample_bodies("train")
    write_scene(folder / "sample", bodies.select_poses(range(POSES)))
    for name in shelved():
        cloak = entry(name)
        if cloak.config["topology"] == bodies.topology:
            cloak.write_run(folder / name)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
