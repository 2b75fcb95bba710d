"""What the Blender extension ships beside its code: `python tools/blender_assets.py FOLDER CLOTHS`, with cloak_core.

FOLDER/sample is a scene package of some of the sample bodies; FOLDER/NAME a run folder for each cloak of the zoo that
was trained on them. CLOTHS gets a picture of each cloth of ours, and `cloths.json`: how wide it is, and what. All of it
is CC0.
"""

import shutil
import sys
from pathlib import Path

from PIL import Image

from cloak_core.core.prints import PRINT_METRES, PRINTS, print_picture
from cloak_core.exchange.cloth import CLOTH_FILE, cloth_metres
from cloak_core.exchange.scenes import write_scene
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_json
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.zoo.entry import entry, shelved

POSES = 4


def main(folder: Path, cloths: Path) -> None:
    bodies = sample_bodies("train")
    write_scene(folder / "sample", bodies.select_poses(range(POSES)))
    for name in shelved():
        cloak = entry(name)
        if cloak.config["topology"] == bodies.topology:
            cloak.write_run(folder / name)
    write_cloths(folder, cloths)


def write_cloths(runs: Path, folder: Path) -> None:
    """Write the cloths among the runs, and the plain prints."""
    told = {}
    folder.mkdir(parents=True)
    for picture in sorted(runs.glob(f"*/{CLOTH_FILE}")):
        run = picture.parent
        shutil.copyfile(picture, folder / f"{run.name}.png")
        told[run.name] = {"metres": cloth_metres(run), "about": read_json(run / "zoo.json")["about"]}
    for name in PRINTS:
        Image.fromarray(print_picture(name)).save(folder / f"print-{name}.png")
        about = f"A plain print that nobody trained, to compare with: {name}; repeats every {PRINT_METRES} m"
        told[f"print-{name}"] = {"metres": PRINT_METRES, "about": about}
    write_json(folder / "cloths.json", told)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
