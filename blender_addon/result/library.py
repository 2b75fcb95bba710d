# SPDX-License-Identifier: GPL-3.0-or-later
"""Ready cloths as assets: a library of materials that comes with the extension, and the UV map they lie on."""

from pathlib import Path

import bpy

from ..blender.cloth import METRES, cloth_of, lay_uv
from ..blender.marks import READY_CLOTH, layer_name
from ..blender.mesh_arrays import mode_reason
from ..body.objects import of_the_body
from ..body.samples import ASSETS
from ..exchange.cloth import corner_uv
from ..training.cloths import first_pose
from ..ui.operator import BodyOperator

LIBRARY = ASSETS / "library"  # of the built extension


@of_the_body
def lay_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why no ready cloth can be laid onto the body."""
    if ready_cloth(obj) is None:
        return "Give the body a cloth first: drag one from the Asset Browser, library Cloak, onto it"
    return mode_reason(obj, "Leave {mode} to lay the cloth")


def ready_cloth(obj: bpy.types.Object) -> bpy.types.Material | None:
    """A material of the library that an object shows, the active one first."""
    shown = (obj.active_material, *obj.data.materials)
    return next((material for material in shown if material and METRES in material and cloth_of(material)), None)


class CLOAK_OT_lay_cloth(BodyOperator, label="Lay Cloth at True Size", needs=lay_reason):
    """Make the UV map of the ready cloths, on which they are as large as they are printed: front, back \
and sides are projected, as the trainer lays a cloth"""

    def change(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        material = ready_cloth(obj)
        image, metres = cloth_of(material), material[METRES]
        bodies = first_pose(obj, None)
        lay_uv(obj, READY_CLOTH, corner_uv(bodies, metres, metres * image.size[1] / image.size[0]))
        for node in material.node_tree.nodes:
            if node.bl_idname == "ShaderNodeUVMap":
                node.uv_map = layer_name(obj.data, READY_CLOTH)  # numbered where the user has one of its name
        return f"'{material.name}' repeats every {metres:g} m on '{obj.name}'"


def _ours() -> list[bpy.types.UserAssetLibrary]:
    return [found for found in bpy.context.preferences.filepaths.asset_libraries if Path(found.path) == LIBRARY]


def register() -> None:
    """The preferences list the library as long as the extension is enabled."""
    if LIBRARY.is_dir() and not _ours():
        bpy.context.preferences.filepaths.asset_libraries.new(name="Cloak", directory=str(LIBRARY))


def unregister() -> None:
    for library in _ours():
        bpy.context.preferences.filepaths.asset_libraries.remove(library)
