# SPDX-License-Identifier: GPL-3.0-or-later
"""What is Cloak's in a user's scene: names are reserved (`cloak.*`), and a mark says which layer or material is ours.

The mark of a mesh's attribute or UV map is a custom property `cloak.ROLE` of the mesh, which holds the layer's name:
where the reserved name is taken, the layer gets a number. The mark of a material is its custom property `cloak.role`.
No name that a user may have typed is ever taken for ours.
"""

import itertools

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..files.errors import InputError

PREFIX, MATERIAL = "cloak.", "cloak.role"
COLORS, OUTFIT, HEATMAP = "colors", "outfit", "heatmap"
"""Colour attributes: the trained colours; the plain clothing of bodies from a scene package; the heat map's colours."""
HEAT = "heat"  # the last heat map, a value per face
OWN_MATERIAL = "own_material"  # the material slot that each face had before it was dressed
ORIGINAL_FACE = "original_face"  # the face that each one came from when the body was first subdivided
CARRIED = "carried_face"  # for the time of an export: each own face's number, counted from 1
UV_MAP = "uv"  # a square of an image for each face
CLOTH = "cloth"  # the corners' places on a cloth that repeats
READY_CLOTH = "ready_cloth"  # the same, on the cloths of the asset library
SHOWN_BEFORE = "shown_before"  # no layer of ours: the colour attribute that the mesh showed before ours
KINDS = {
    **dict.fromkeys((COLORS, OUTFIT, HEATMAP), ("CORNER", "FLOAT_COLOR")),
    **dict.fromkeys((OWN_MATERIAL, ORIGINAL_FACE, CARRIED), ("FACE", "INT")),
    HEAT: ("FACE", "FLOAT"),
    **dict.fromkeys((UV_MAP, CLOTH, READY_CLOTH), ("CORNER", "FLOAT2")),
}
"""Domain and type of a layer by its role; "outfit.2" is a second outfit."""
FORMER = {
    COLORS: "Cloak",
    OWN_MATERIAL: "cloak_own_material",
    HEATMAP: "Cloak Heatmap",
    HEAT: "cloak_heat",
    ORIGINAL_FACE: "cloak_original_face",
    OUTFIT: "Outfit",
    f"{OUTFIT}.2": "Outfit 2",
}
"""What version 1.0 called its layers."""
FORMER_LOOKS = {"Cloak as Detectors Saw": "SEEN", "Cloak Lookdev": "LOOKDEV"}


def layer_name(mesh: bpy.types.Mesh, role: str) -> str:
    """The name of our layer in a role; "" where the mesh has none."""
    name = mesh.get(PREFIX + role, "")
    attribute = mesh.attributes.get(name) if name else None
    fits = attribute is not None and (attribute.domain, attribute.data_type) == KINDS[role.partition(".")[0]]
    return name if fits else ""


def layer_of(mesh: bpy.types.Mesh, role: str) -> bpy.types.Attribute | None:
    """Our attribute in a role; None where the mesh has none."""
    name = layer_name(mesh, role)
    return mesh.attributes[name] if name else None


def our_names(mesh: bpy.types.Mesh) -> set[str]:
    """The names of our layers on a mesh."""
    return {mesh[key] for key in mesh.keys() if key.startswith(PREFIX)}  # noqa: SIM118


def free_name(obj: bpy.types.Object, name: str) -> str:
    """The name, numbered where it is taken; attributes and vertex groups share their names."""
    taken = {*obj.data.attributes.keys(), *obj.vertex_groups.keys()}
    names = itertools.chain([name], (f"{name}.{number:03d}" for number in itertools.count(1)))
    return next(name for name in names if name not in taken)


def make_layer(obj: bpy.types.Object, role: str) -> bpy.types.Attribute:
    """Our attribute in a role, made and marked where the mesh has none."""
    mesh = obj.data
    if not layer_name(mesh, role):
        domain, kind = KINDS[role.partition(".")[0]]
        mark(mesh, role, mesh.attributes.new(free_name(obj, PREFIX + role), kind, domain).name)
    return layer_of(mesh, role)


def lay_uv(obj: bpy.types.Object, role: str, uv: np.ndarray) -> str:
    """Write our UV map in a role, [C, 2], made and marked where the mesh has none; returns its name.

    A map of the user's stays the active one.
    """
    mesh = obj.data
    if not layer_name(mesh, role):
        shown = mesh.uv_layers.active.name if mesh.uv_layers.active else ""
        layer = mesh.uv_layers.new(name=free_name(obj, PREFIX + role), do_init=False)
        if layer is None:
            raise InputError("The mesh has as many UV maps as Blender allows: delete one")
        mark(mesh, role, layer.name)
        if shown:
            mesh.uv_layers.active = mesh.uv_layers[shown]
    name = layer_name(mesh, role)
    mesh.uv_layers[name].uv.foreach_set("vector", np.ascontiguousarray(uv, np.float32).ravel())
    return name


def mark(mesh: bpy.types.Mesh, role: str, name: str) -> None:
    """Note that the layer of this name is ours."""
    mesh[PREFIX + role] = name


def remove_layer(mesh: bpy.types.Mesh, role: str) -> None:
    """Remove our attribute in a role, if the mesh has one, and its mark."""
    if (attribute := layer_of(mesh, role)) is not None:
        mesh.attributes.remove(attribute)
    mesh.pop(PREFIX + role, None)


# --- scenes of version 1.0, which had names and no marks --------------------------------------------------------------


@persistent
def mark_former(*_: object) -> None:
    """After loading: mark what version 1.0 made, where more than its name says that it did.

    Technical names of integer and float layers, and the record of a sample body, vouch for names that users may type.
    """
    for obj in bpy.data.objects:
        if obj.type != "MESH" or obj.data.library is not None or obj.library is not None or our_names(obj.data):
            continue
        mesh, names = obj.data, obj.data.attributes.keys()
        roles = [role for role in (OWN_MATERIAL, HEAT, ORIGINAL_FACE) if FORMER[role] in names]
        roles += [COLORS] if OWN_MATERIAL in roles else []
        roles += [HEATMAP] if HEAT in roles else []
        if obj.cloak.made_from or (obj.parent and obj.parent.cloak.made_from):
            roles += [OUTFIT, f"{OUTFIT}.2"]
        for role in roles:
            attribute = mesh.attributes.get(FORMER[role])
            if attribute is not None and (attribute.domain, attribute.data_type) == KINDS[role.partition(".")[0]]:
                mark(mesh, role, attribute.name)
        for material in filter(None, mesh.materials if layer_name(mesh, COLORS) else ()):
            look = FORMER_LOOKS.get(material.name.partition(".")[0])
            if look and material.library is None:
                material[MATERIAL] = look
