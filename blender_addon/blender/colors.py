# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours on the model: trained colours as a face-corner colour attribute, the material that shows it, and what the
body's faces look like without a cloak.

Files and detectors speak display-referred sRGB in [0, 1]; Blender's colour attributes are scene-linear. The conversion
happens here and nowhere else.
"""

import bpy
import numpy as np

from ..ui.window import areas
from . import mesh_arrays as arrays
from .mesh_arrays import corner_counts, current_mesh, read, write_attribute

CLOAK = "Cloak"  # name of the colour attribute that holds the trained colours
SEEN, LOOKDEV = "SEEN", "LOOKDEV"
LOOKS = {SEEN: "Cloak as Detectors Saw", LOOKDEV: "Cloak Lookdev"}
"""The materials that show it: unlit, so that every colour is the trained one, or lit as cloth."""
OUTFIT = "Outfit"  # name of the colour attribute that holds the plain clothing of bodies from a scene package
HEATMAP = "Cloak Heatmap"
HEAT = "cloak_heat"  # float face attribute: the last heat map
SLOTS = "material_index"  # Blender's own face attribute: the material slot of each face
OWN_MATERIAL = "cloak_own_material"  # integer face attribute: the material slot each face had before it was dressed
GREY = 0.5
HEAT_STOPS = ((0.05, 0.03, 0.20), (0.42, 0.07, 0.43), (0.83, 0.27, 0.30), (0.98, 0.60, 0.15), (0.99, 1.0, 0.75))
"""sRGB from no heat to the most."""


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, elementwise; float32 in, float32 out."""
    values = np.asarray(values, np.float32)
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(values: np.ndarray) -> np.ndarray:
    """Inverse of `srgb_to_linear`."""
    values = np.asarray(values, np.float32)
    return np.where(values <= 0.0031308, values * 12.92, 1.055 * np.maximum(values, 0) ** (1 / 2.4) - 0.055)


def write_face_colors(obj: bpy.types.Object, name: str, colors: np.ndarray) -> None:
    """Write one sRGB colour per face, [F, 3], into the corner colour attribute `name`, made where there is none."""
    mesh = obj.data
    arrays.require_object_mode(obj, "Leave Edit Mode (Tab) to see the colours on the model")
    attribute = mesh.color_attributes.get(name)
    if attribute is None or attribute.domain != "CORNER" or attribute.data_type != "FLOAT_COLOR":
        if mesh.attributes.get(name) is not None:
            mesh.attributes.remove(mesh.attributes[name])
        attribute = mesh.color_attributes.new(name, "FLOAT_COLOR", "CORNER")
    rgba = np.ones((len(mesh.polygons), 4), np.float32)
    rgba[:, :3] = srgb_to_linear(colors)
    attribute.data.foreach_set("color", np.repeat(rgba, corner_counts(mesh), axis=0).ravel())
    mesh.update_tag()


def read_face_colors(obj: bpy.types.Object, name: str) -> np.ndarray:
    """[F, 3] sRGB: the mean over each face's corners of a colour attribute, as written by `write_face_colors`."""
    with current_mesh(obj) as mesh:
        attribute = mesh.color_attributes[name]
        values = read(attribute.data, "color", 4)[:, :3]
        values = values[arrays.corner_vertices(mesh)] if attribute.domain == "POINT" else values
        return linear_to_srgb(arrays.mean_of_corners(corner_counts(mesh), values))


def show_attribute(context: bpy.types.Context, obj: bpy.types.Object, name: str | None) -> None:
    """Let Solid shading show the colour attribute `name`; None returns the viewports to the body's own colours."""
    if name is None and OUTFIT in obj.data.color_attributes:
        name = OUTFIT
    if name is not None:
        activate(obj, name)
    for _, area in areas("VIEW_3D"):
        area.spaces.active.shading.color_type = "VERTEX" if name else "MATERIAL"


def activate(obj: bpy.types.Object, name: str) -> None:
    """Make a colour attribute the one that viewports and renders show."""
    attributes = obj.data.color_attributes
    attributes.active_color = attributes[name]
    attributes.render_color_index = attributes.active_color_index


def shown_attribute(obj: bpy.types.Object) -> str:
    """The colour attribute that viewports show; "" for none."""
    name = obj.data.color_attributes.active_color_name
    return name if name in obj.data.color_attributes else ""  # Blender 5.2 goes on naming one that was removed


def shows_heat(obj: bpy.types.Object) -> bool:
    """Whether the heat map is what viewports show."""
    return shown_attribute(obj) == HEATMAP


# --- materials -------------------------------------------------------------------------------------------------------


def attribute_material(name: str, title: str, unlit: bool = False) -> bpy.types.Material:
    """The material of this title that shows the colour attribute `name`: as matte cloth, or `unlit`."""
    material = bpy.data.materials.get(title)
    if material is None or material.library is not None or not _shows_attribute(material, name):
        material, source = new_material(title, "ShaderNodeVertexColor", unlit)
        source.layer_name = name
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


def cloak_material(look: str) -> bpy.types.Material:
    """The material of a look: the trained colours as they are, or on a matte cloth that light falls on."""
    return attribute_material(CLOAK, LOOKS[look], unlit=look == SEEN)


def set_look(obj: bpy.types.Object, look: str) -> None:
    """Show a cloak that the object wears through the material of a look."""
    slot = _cloak_slot(obj.data)
    if slot is not None:
        obj.data.materials[slot] = cloak_material(look)


def nodes_of(owner: bpy.types.Material | bpy.types.World) -> tuple:
    """The nodes of a new material or world, and their links."""
    if bpy.app.version < (5, 0, 0):
        owner.use_nodes = True
    return owner.node_tree.nodes, owner.node_tree.links


def _shows_attribute(material: bpy.types.Material, name: str) -> bool:
    nodes = material.node_tree.nodes if material.node_tree else ()
    return any(node.bl_idname == "ShaderNodeVertexColor" and node.layer_name == name for node in nodes)


def dress(obj: bpy.types.Object, face_ids: np.ndarray) -> None:
    """Give the logo's faces the cloak material and remember the slot each face had before."""
    undress(obj)
    mesh = obj.data
    if not mesh.materials:
        mesh.materials.append(None)  # faces without a material use slot 0, which must stay plain
    if _cloak_slot(mesh) is None:
        mesh.materials.append(cloak_material(bpy.context.scene.cloak.look))
    set_look(obj, bpy.context.scene.cloak.look)
    slots, slot = _read_slots(mesh), _cloak_slot(mesh)
    write_attribute(mesh, OWN_MATERIAL, "INT", slots)
    slots[face_ids] = slot
    write_attribute(mesh, SLOTS, "INT", slots)


def undress(obj: bpy.types.Object) -> None:
    """Give faces that wear the cloak material their own material back."""
    if _cloak_slot(obj.data) is not None and OWN_MATERIAL in obj.data.attributes:
        write_attribute(obj.data, SLOTS, "INT", own_material_slots(obj))


def is_dressed(obj: bpy.types.Object) -> bool:
    """Whether some faces wear the cloak material."""
    slot = _cloak_slot(obj.data)
    return slot is not None and bool((_read_slots(obj.data) == slot).any())


def lost_its_cloak(obj: bpy.types.Object) -> bool:
    """Whether an object that was dressed misses material or attributes: undo takes them, Show Original does not."""
    mesh = obj.data
    return _cloak_slot(mesh) is None or OWN_MATERIAL not in mesh.attributes or CLOAK not in mesh.color_attributes


def own_material_slots(obj: bpy.types.Object, mesh: bpy.types.Mesh | None = None) -> np.ndarray:
    """[F] int32: each face's material slot, without the cloak; read from a copy of the object's mesh, where given."""
    mesh = mesh or obj.data
    slots = _read_slots(mesh)
    slot, own = _cloak_slot(obj.data), mesh.attributes.get(OWN_MATERIAL)
    if slot is not None and own is not None and len(own.data) == len(slots):
        slots = np.where(slots == slot, read(own.data, "value", dtype=np.int32), slots)
    return slots


def _read_slots(mesh: bpy.types.Mesh) -> np.ndarray:
    """[F] int32: material slot of each face; from the attribute, which is ten times as fast as from the polygons."""
    attribute = mesh.attributes.get(SLOTS)
    return read(attribute.data, "value", dtype=np.int32) if attribute else np.zeros(len(mesh.polygons), np.int32)


def _cloak_slot(mesh: bpy.types.Mesh) -> int | None:
    shown = (index for index, m in enumerate(mesh.materials) if m is not None and _shows_attribute(m, CLOAK))
    return next(shown, None)


# --- what the body looks like without a cloak ------------------------------------------------------------------------


def own_outfits(obj: bpy.types.Object) -> np.ndarray:
    """[K, F, 3] float32 sRGB: the body's own colours, and as it would look in its other outfits where it has them."""
    with current_mesh(obj) as mesh:
        own, slots = own_face_colors(obj), own_material_slots(obj, mesh)
    outfit_slots = [i for i, s in enumerate(obj.material_slots) if s.material and _shows_attribute(s.material, OUTFIT)]
    outfits, number = [own], 2
    while outfit_slots and obj.data.color_attributes.get(f"{OUTFIT} {number}"):
        other = own.copy()
        worn = np.isin(slots, outfit_slots)
        other[worn] = np.clip(read_face_colors(obj, f"{OUTFIT} {number}")[worn], 0, 1)
        outfits.append(other)
        number += 1
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
    """sRGB [n, 3] or [3] for the faces of a mask."""
    source = _base_color_input(material)
    if source is None:
        return linear_to_srgb(material.diffuse_color[:3])
    if not source.is_linked:
        return linear_to_srgb(source.default_value[:3])
    node = source.links[0].from_node
    if node.bl_idname == "ShaderNodeTexImage" and node.image is not None and mesh.uv_layers.active:
        sampled = _image_colors(mesh, node.image)
        if sampled is not None:
            return sampled[faces]
    name = getattr(node, "layer_name", "") or getattr(node, "attribute_name", "")
    if name and mesh.color_attributes.get(name):
        return read_face_colors(obj, name)[faces]
    if node.bl_idname == "ShaderNodeRGB":
        return linear_to_srgb(node.outputs[0].default_value[:3])
    return linear_to_srgb(material.diffuse_color[:3])


def _base_color_input(material: bpy.types.Material) -> bpy.types.NodeSocket | None:
    uses = bpy.app.version >= (5, 0, 0) or material.use_nodes  # from then on all materials do
    nodes = material.node_tree.nodes if material.node_tree and uses else ()
    for node in nodes:
        if node.type in ("BSDF_PRINCIPLED", "BSDF_DIFFUSE", "EMISSION"):
            return node.inputs.get("Base Color") or node.inputs.get("Color")
    return None


def _image_colors(mesh: bpy.types.Mesh, image: bpy.types.Image) -> np.ndarray | None:
    """[F, 3] sRGB: the texel under the middle of each face's texture coordinates."""
    width, height = image.size
    if not width or not height:
        return None
    pixels = arrays.image_pixels(image)
    pixels = pixels[..., :3] if image.channels >= 3 else np.repeat(pixels[..., :1], 3, -1)
    places = arrays.mean_of_corners(corner_counts(mesh), read(mesh.uv_layers.active.uv, "vector", 2))
    middle = np.nan_to_num(places) % 1.0
    x = np.minimum((middle[:, 0] * width).astype(int), width - 1)
    y = np.minimum((middle[:, 1] * height).astype(int), height - 1)
    texels = pixels[y, x]
    return linear_to_srgb(texels) if image.is_float else texels


def heat_colors(heat: np.ndarray) -> np.ndarray:
    """[F] heat to [F, 3] sRGB: dark blue through magenta and orange to pale yellow; the hottest 1 % saturate."""
    top = float(np.quantile(heat, 0.99)) if heat.size else 0.0
    level = np.clip(heat / top, 0, 1) if top > 0 else np.zeros(len(heat))
    places = np.linspace(0, 1, len(HEAT_STOPS))
    return np.stack([np.interp(level, places, channel) for channel in np.transpose(HEAT_STOPS)], -1)


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


def use_standard_view(scene: bpy.types.Scene) -> None:
    """Colour management that shows sRGB colours as they are."""
    scene.display_settings.display_device = "sRGB"
    view = scene.view_settings
    view.view_transform = "Standard"
    view.look = "None"
    view.exposure, view.gamma, view.use_curve_mapping = 0.0, 1.0, False
