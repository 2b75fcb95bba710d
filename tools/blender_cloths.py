"""Blender's file of ready cloths: `python tools/blender_cloths.py ADD_ON PICTURES OUT.blend`, where Python has bpy.

ADD_ON is the staged add-on, PICTURES a folder of PNGs and `cloths.json` (`tools/blender_assets.py` writes it). Each
picture becomes a material that is an asset, on the UV map `cloak.ready_cloth`.
"""

import importlib
import json
import os
import sys
from pathlib import Path

import bpy

PREVIEW = 128  # pixels along each side


def main(add_on: Path, pictures: Path, out: Path) -> None:
    sys.path.insert(0, str(add_on.parent))
    colors = importlib.import_module(f"{add_on.name}.blender.colors")
    marks = importlib.import_module(f"{add_on.name}.blender.marks")
    images = importlib.import_module(f"{add_on.name}.blender.pictures")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    made = set()
    for name, told in json.loads((pictures / "cloths.json").read_text("utf-8")).items():
        image = images.load_cloth(pictures / f"{name}.png")
        image.name = name
        # It is packed: where it lay on the machine that builds is nobody's business.
        image.filepath_raw = image.packed_files[0].filepath = f"//{name}.png"
        material, texture = colors.new_material(name, "ShaderNodeTexImage")
        images.show_on(material, texture, image, marks.PREFIX + marks.READY_CLOTH)
        texture.interpolation = "Closest"
        material[images.METRES] = told["metres"]
        material.asset_mark()
        data = material.asset_data
        data.description, data.license, data.author = told["about"], "CC0-1.0", "The Cloak authors"
        images.show_preview(material, images.read_picture(pictures / f"{name}.png", cover=(PREVIEW, PREVIEW)))
        made.add(material)
    out.parent.mkdir(parents=True, exist_ok=True)
    bpy.data.libraries.write(str(out), made, fake_user=True)  # the extension's zip compresses it


if __name__ == "__main__":
    main(*map(Path, sys.argv[-3:]))
    sys.stdout.flush()
    os._exit(0)  # the bpy package may wait for ever in its own destructors
