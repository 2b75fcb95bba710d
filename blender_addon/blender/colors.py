# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours on the model: trained colours as a face-corner colour attribute, the material that shows it, and what the
body's faces look like without a cloak.

Files and detectors speak display-referred sRGB in [0, 1]; Blender's colour attributes are scene-linear. The conversion
happens here and nowhere else.
"""

import bpy
import numpy as np

from ..session import session
from ..ui.window import areas
from . import mesh_arrays as arrays
from .marks import (
    CLOTH,
    COLORS,
    HEATMAP,
    MATERIAL,
    OUTFIT,
    OWN_MATERIAL,
    PREFIX,
    SHOWN_BEFORE,
    lay_uv,
    layer_name,
    make_layer,
    remove_layer,
)
from .mesh_arrays import corner_counts, current_mesh, read, write_attribute
from .pictures import Cloth, cloth_of, image_pixels, pixels_at, show_on

SEEN, LOOKDEV = "SEEN", "LOOKDEV"
LOOKS = {SEEN: "Cloak as Detectors Saw", LOOKDEV: "Cloak Lookdev"}
"""The materials that show it: unlit, so that every colour is the trained one, or lit as cloth."""
SLOTS = "material_index"  # Blender's own face attribute: the material slot of each face
GREY = 0.5


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, elementwise; float32 in, float32 out."""
    values = np.asarray(values, np.float32)
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(values: np.ndarray) -> np.ndarray:
    """Inverse of `srgb_to_linear`."""
    values = np.asarray(values, np.float32)
    return np.where(values <= 0.0031308, values * 12.92, 1.055 * np.maximum(values, 0) ** (1 / 2.4) - 0.055)


def write_face_colors(obj: bpy.types.Object, role: str, colors: np.ndarray) -> None:
    """Write one sRGB colour per face, [F, 3], into our colour attribute in a role, made where there is none."""
    mesh = obj.data
    arrays.require_object_mode(obj, "Leave {mode} to see the colours on the model")
    rgba = np.ones((len(mesh.polygons), 4), np.float32)
    rgba[:, :3] = srgb_to_linear(colors)
    make_layer(obj, role).data.foreach_set("color", np.repeat(rgba, corner_counts(mesh), axis=0).ravel())
    mesh.update_tag()


def read_face_colors(obj: bpy.types.Object, name: str) -> np.ndarray:
    """[F, 3] sRGB: the mean over each face's corners of any colour attribute."""
    with current_mesh(obj) as mesh:
        attribute = mesh.color_attributes[name]
        values = read(attribute.data, "color", 4)[:, :3]
        values = values[arrays.corner_vertices(mesh)] if attribute.domain == "POINT" else values
        return linear_to_srgb(arrays.mean_of_corners(corner_counts(mesh), values))


def written_colors(obj: bpy.types.Object, role: str = COLORS) -> np.ndarray:
    """[F, 3] sRGB of our colour attribute in a role, as `write_face_colors` wrote it."""
    return read_face_colors(obj, layer_name(obj.data, role))


def show_attribute(obj: bpy.types.Object, role: str = "") -> None:
    """Let Solid viewports show our colour attribute in a role; "" gives mesh and viewports back what they showed."""
    role = role or (OUTFIT if layer_name(obj.data, OUTFIT) else "")
    activate(obj, role)
    for _, area in areas("VIEW_3D"):
        space = area.spaces.active
        if role and space.shading.color_type != "VERTEX":
            session.viewports[space.as_pointer()] = space.shading.color_type
            space.shading.color_type = "VERTEX"
        elif not role and space.shading.color_type == "VERTEX":
            space.shading.color_type = session.viewports.pop(space.as_pointer(), "VERTEX")


def activate(obj: bpy.types.Object, role: str) -> None:
    """Let viewports and renders show our colour attribute in a role; "" for what the mesh showed before ours."""
    mesh, shown = obj.data, shown_attribute(obj)
    if role and shown not in {layer_name(mesh, ours) for ours in (COLORS, HEATMAP, OUTFIT)}:
        mesh[PREFIX + SHOWN_BEFORE] = shown
    name = layer_name(mesh, role or OUTFIT) or mesh.get(PREFIX + SHOWN_BEFORE, "")
    if name in mesh.color_attributes:
        mesh.color_attributes.active_color = mesh.color_attributes[name]
        mesh.color_attributes.render_color_index = mesh.color_attributes.active_color_index


def shown_attribute(obj: bpy.types.Object) -> str:
    """The colour attribute that viewports show; "" for none."""
    name = obj.data.color_attributes.active_color_name
    return name if name in obj.data.color_attributes else ""  # Blender 5.2 goes on naming one that was removed


def shows(obj: bpy.types.Object, role: str) -> bool:
    """Whether our colour attribute in a role is what viewports show."""
    return bool(name := layer_name(obj.data, role)) and shown_attribute(obj) == name


# --- materials -------------------------------------------------------------------------------------------------------


def attribute_material(name: str, role: str, title: str, unlit: bool = False) -> bpy.types.Material:
    """Our material in a role that shows the colour attribute `name`, made where there is none: lit, or `unlit`."""
    for material in bpy.data.materials:
        if material.library is None and material.get(MATERIAL) == role and _shows_attribute(material, name):
            return material
    material, source = new_material(title, "ShaderNodeVertexColor", unlit)
    source.layer_name, material[MATERIAL] = name, role
    return material


def new_material(title: str, kind: str, unlit: bool = False) -> tuple[bpy.types.Material, bpy.types.Node]:
    """A new material, and its new node of this kind that gives it its colour."""
    material = bpy.data.materials.new(title)
    nodes, links = nodes_of(material)
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = 0.6
    source = nodes.new(kind)
    source.location = (shader.location.x - 320, shader.location.y)
    links.new(source.outputs["Color"], shader.inputs["Base Color"])
    if unlit:
        emission, output = nodes.new("ShaderNodeEmission"), next(n for n in nodes if n.type == "OUTPUT_MATERIAL")
        nodes.remove(shader)
        links.new(source.outputs["Color"], emission.inputs["Color"])
        links.new(emission.outputs[0], output.inputs["Surface"])
    return material, source


def cloak_material(mesh: bpy.types.Mesh, look: str, image: bpy.types.Image | None = None) -> bpy.types.Material:
    """The material of a look: the trained colours as they are, or on a matte cloth that light falls on.

    image: of a cloth that repeats, shown on our UV map; None: the colours of the faces.
    """
    if image is None:
        return attribute_material(layer_name(mesh, COLORS), look, LOOKS[look], unlit=look == SEEN)
    material, texture = new_material(LOOKS[look], "ShaderNodeTexImage", unlit=look == SEEN)
    show_on(material, texture, image, layer_name(mesh, CLOTH))
    texture.interpolation, texture.extension = "Closest", "REPEAT"
    material[MATERIAL] = look
    return material


def is_cloak(material: bpy.types.Material | None) -> bool:
    """Whether a material is one of the looks."""
    return material is not None and material.get(MATERIAL) in LOOKS


def set_look(obj: bpy.types.Object, look: str) -> None:
    """Show a cloak that the object wears through the material of a look."""
    slot = _cloak_slot(obj.data)
    if slot is not None:
        before = obj.data.materials[slot]
        obj.data.materials[slot] = cloak_material(obj.data, look, cloth_of(before))
        if cloth_of(before) and not before.users:
            bpy.data.materials.remove(before)


def worn_cloth(mesh: bpy.types.Mesh) -> tuple[bpy.types.Image | None, np.ndarray]:
    """The cloth that a mesh wears, None where it wears none, and a mask [F] of the faces that wear the cloak."""
    slot, slots = _cloak_slot(mesh), _read_slots(mesh)
    if slot is None:
        return None, np.zeros(len(slots), bool)
    return cloth_of(mesh.materials[slot]), slots == slot


def nodes_of(owner: bpy.types.Material | bpy.types.World) -> tuple:
    """The nodes of a new material or world, and their links."""
    if bpy.app.version < (5, 0, 0):
        owner.use_nodes = True
    return owner.node_tree.nodes, owner.node_tree.links


def _shows_attribute(material: bpy.types.Material, name: str) -> bool:
    nodes = material.node_tree.nodes if material.node_tree else ()
    return any(node.bl_idname == "ShaderNodeVertexColor" and node.layer_name == name for node in nodes)


def dress(obj: bpy.types.Object, face_ids: np.ndarray, cloth: Cloth | None = None) -> None:
    """Give the logo's faces the cloak material, which shows a cloth if there is one; remember each face's slot."""
    undress(obj)
    mesh, look = obj.data, bpy.context.scene.cloak.look
    if not mesh.materials:
        mesh.materials.append(None)  # faces without a material use slot 0, which must stay plain
    if _cloak_slot(mesh) is None:
        mesh.materials.append(None)
    slot = len(mesh.materials) - 1 if _cloak_slot(mesh) is None else _cloak_slot(mesh)
    image = None
    if cloth is not None:
        image, uv = cloth
        image.name = PREFIX + CLOTH
        lay_uv(obj, CLOTH, uv)
    mesh.materials[slot] = cloak_material(mesh, look, image)
    slots = _read_slots(mesh)
    make_layer(obj, OWN_MATERIAL).data.foreach_set("value", slots)
    slots[face_ids] = slot
    write_attribute(mesh, SLOTS, "INT", slots)


def undress(obj: bpy.types.Object) -> None:
    """Give faces that wear the cloak material their own material back; of a cloth nothing stays in the file."""
    mesh, slot = obj.data, _cloak_slot(obj.data)
    if slot is not None and layer_name(mesh, OWN_MATERIAL):
        write_attribute(mesh, SLOTS, "INT", own_material_slots(obj))
    if slot is not None and (image := cloth_of(worn := mesh.materials[slot])):
        mesh.materials[slot] = cloak_material(mesh, worn[MATERIAL])
        remove_layer(mesh, CLOTH)
        for thing, kept in ((worn, bpy.data.materials), (image, bpy.data.images)):
            if not thing.users:
                kept.remove(thing)


def is_dressed(obj: bpy.types.Object) -> bool:
    """Whether some faces wear the cloak material."""
    return bool(worn_cloth(obj.data)[1].any())


def own_material_slots(obj: bpy.types.Object, mesh: bpy.types.Mesh | None = None) -> np.ndarray:
    """[F] int32: each face's material slot, without the cloak; read from a copy of the object's mesh, where given."""
    mesh = mesh or obj.data
    slots = _read_slots(mesh)
    slot, own = _cloak_slot(obj.data), mesh.attributes.get(layer_name(obj.data, OWN_MATERIAL))
    if slot is not None and own is not None and len(own.data) == len(slots):
        slots = np.where(slots == slot, read(own.data, "value", dtype=np.int32), slots)
    return slots


def _read_slots(mesh: bpy.types.Mesh) -> np.ndarray:
    """[F] int32: material slot of each face; from the attribute, which is ten times as fast as from the polygons."""
    attribute = mesh.attributes.get(SLOTS)
    return read(attribute.data, "value", dtype=np.int32) if attribute else np.zeros(len(mesh.polygons), np.int32)


def _cloak_slot(mesh: bpy.types.Mesh) -> int | None:
    return next((index for index, material in enumerate(mesh.materials) if is_cloak(material)), None)


# --- what the body looks like without a cloak ------------------------------------------------------------------------


def own_outfits(obj: bpy.types.Object) -> np.ndarray:
    """[K, F, 3] float32 sRGB: the body's own colours, and as it would look in its other outfits where it has them."""
    with current_mesh(obj) as mesh:
        own, slots = own_face_colors(obj), own_material_slots(obj, mesh)
    first, outfits = layer_name(obj.data, OUTFIT), [own]
    outfit_slots = [i for i, s in enumerate(obj.material_slots) if s.material and _shows_attribute(s.material, first)]
    while outfit_slots and (name := layer_name(obj.data, f"{OUTFIT}.{len(outfits) + 1}")):
        other = own.copy()
        worn = np.isin(slots, outfit_slots)
        other[worn] = np.clip(read_face_colors(obj, name)[worn], 0, 1)
        outfits.append(other)
    return np.stack(outfits)


def own_face_colors(obj: bpy.types.Object) -> np.ndarray:
    """[F, 3] float32 sRGB: each face's base colour, from its material, image texture or colour attribute."""
    with current_mesh(obj) as mesh:
        slots = own_material_slots(obj, mesh)
        colors = np.full((len(slots), 3), GREY, np.float32)
        for index, slot in enumerate(obj.material_slots):
            faces = slots == index
            if slot.material is not None and faces.any():
                colors[faces] = _material_colors(obj, mesh, slot.material, faces)
    return np.clip(np.nan_to_num(colors, nan=GREY), 0, 1)


def _material_colors(
    obj: bpy.types.Object, mesh: bpy.types.Mesh, material: bpy.types.Material, faces: np.ndarray
) -> np.ndarray:
    """sRGB [n, 3] or [3] for the faces of a mask: of its shader's colour, else of the material's in viewports."""
    uses = bpy.app.version >= (5, 0, 0) or material.use_nodes  # from then on all materials do
    nodes = material.node_tree.nodes if material.node_tree and uses else ()
    shader = next((node for node in nodes if node.type in ("BSDF_PRINCIPLED", "BSDF_DIFFUSE", "EMISSION")), None)
    source = shader and (shader.inputs.get("Base Color") or shader.inputs.get("Color"))
    if source and not source.is_linked:
        return linear_to_srgb(source.default_value[:3])
    node = source.links[0].from_node if source else None
    image = node.image if node and node.bl_idname == "ShaderNodeTexImage" else None
    if image is not None and image.size[0] and mesh.uv_layers.active:
        # The texel under the middle of each face's texture coordinates.
        places = arrays.mean_of_corners(corner_counts(mesh), read(mesh.uv_layers.active.uv, "vector", 2))[faces]
        texels = pixels_at(image_pixels(image), np.nan_to_num(places))
        texels = texels[:, :3] if image.channels >= 3 else np.repeat(texels[:, :1], 3, -1)
        return linear_to_srgb(texels) if image.is_float else texels
    name = getattr(node, "layer_name", "") or getattr(node, "attribute_name", "")
    if name and mesh.color_attributes.get(name):
        return read_face_colors(obj, name)[faces]
    if node and node.bl_idname == "ShaderNodeRGB":
        return linear_to_srgb(node.outputs[0].default_value[:3])
    return linear_to_srgb(material.diffuse_color[:3])


def view_transform_reason(scene: bpy.types.Scene) -> str:
    """Why the scene's colour management will not show the trained colours as the detector saw them; "" when it will."""
    view, device = scene.view_settings, scene.display_settings.display_device
    if device != "sRGB":
        return f"Display device '{device}' does not show the trained colours"
    if view.view_transform != "Standard":
        return f"View transform '{view.view_transform}' does not show the trained colours"
    changed = view.look not in ("None", "") or abs(view.exposure) > 1e-6 or abs(view.gamma - 1) > 1e-6
    if changed or view.use_curve_mapping:
        return "Look, exposure, gamma or curves change the trained colours"
    return ""


def light_reason(space: bpy.types.Space | None) -> str:
    """Why a viewport's light changes the trained colours, by up to 76/255; "" where it does not."""
    shading = space.shading if space is not None and space.type == "VIEW_3D" else None
    if shading is None or shading.type != "SOLID" or shading.light == "FLAT":
        return ""
    return "Studio light in Solid view changes the trained colours"


def use_standard_view(scene: bpy.types.Scene) -> None:
    """Colour management that shows sRGB colours as they are."""
    scene.display_settings.display_device = "sRGB"
    view = scene.view_settings
    view.view_transform = "Standard"
    view.look = "None"
    view.exposure, view.gamma, view.use_curve_mapping = 0.0, 1.0, False
