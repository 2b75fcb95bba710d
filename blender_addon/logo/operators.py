# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of step 2, the logo."""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import bpy
import numpy as np
from bpy.props import EnumProperty

from ..blender import colors, faces
from ..blender.blend_paths import first_free
from ..blender.faces import read_selection
from ..blender.marks import COLORS, HEAT, HEATMAP, layer_name, layer_of, make_layer, our_names, remove_layer
from ..blender.mesh_arrays import current_mesh, face_count, mode_reason, object_mode, read, topology
from ..body.garments import is_dressed
from ..body.objects import active_body, body_reason, logo_reason, object_of, of_the_body, refusal, upright_reason
from ..exchange.face_lists import hottest_faces, write_face_list
from ..exchange.scenes import write_scene
from ..files.errors import InputError
from ..files.reading import read_npy
from ..poses.export import export_bodies
from ..properties import pose_choice, train_options
from ..trainer.jobs import Job, run_cloak
from ..trainer.program import user_folder
from ..ui import props
from ..ui.bases import operator, push_undo


def selected_faces(obj: bpy.types.Object) -> np.ndarray:
    """Mask of the selected faces; `InputError` when there are none."""
    mask = read_selection(obj)
    if not mask.any():
        raise InputError("No faces selected: select some in Edit Mode (hidden faces do not count)")
    return mask


def take(
    obj: bpy.types.Object, mask: np.ndarray, name: str, add: bool = False, worn: Sequence[bpy.types.Object] = ()
) -> str:
    """Make a logo of a mask's faces, or with `add` put them into the active one; returns the logo's name.

    worn: pieces that wear it too, with faces of the mask behind the body's.
    """
    mask, *others = np.split(mask, np.cumsum([face_count(one) for one in (obj, *worn)])[:-1])
    wearing = [(piece, its) for piece, its in zip(worn, others, strict=True) if its.any()]
    if add:
        name = faces.active_logo(obj)
        faces.write_faces(obj, name, mask, where=mask)
    else:
        name = faces.new_logo(obj, name, mask, [piece for piece, _ in wearing])
    for piece, its in wearing:
        faces.write_faces(piece, name, its, where=its if name in faces.logo_names(piece.data) else None)
    obj.cloak.logo = name
    return name


@operator("New from Selection", name=props.text("Name", "Name of the new logo", "Logo"))
def logo_new(context: bpy.types.Context, obj: bpy.types.Object, name: str) -> str:
    """Make a logo of the selected faces"""
    mask = selected_faces(obj)
    return f"Logo '{take(obj, mask, name)}': {int(mask.sum()):,} faces"


@operator("Assign", logo_reason)
def logo_assign(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Add the selected faces to the active logo"""
    return _write(obj, selected_faces(obj), True)


@operator("Remove", logo_reason)
def logo_unassign(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Take the selected faces out of the active logo"""
    return _write(obj, read_selection(obj), False)


def _write(obj: bpy.types.Object, chosen: np.ndarray, belong: bool) -> str:
    """Let the chosen faces belong to the active logo, or not; returns what to say."""
    name = faces.active_logo(obj)
    faces.write_faces(obj, name, np.full(len(chosen), belong), where=chosen)
    return f"Logo '{name}': {int(faces.read_faces(obj, name).sum()):,} faces"


@operator("Select", logo_reason)
def logo_select(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Select the faces of the active logo"""
    name = faces.active_logo(obj)
    with current_mesh(obj):
        mask = faces.require_logo(obj, name)
        hidden = faces.select_faces(obj, mask)
    note = f"; {hidden:,} are hidden and stay unselected: reveal them with Alt H" if hidden else ""
    return f"Selected {int(mask.sum()):,} faces{note}"


@operator("Delete Logo", logo_reason)
def logo_remove(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Delete the active logo; the faces themselves stay"""
    name = faces.active_logo(obj)
    with object_mode(obj):
        obj.data.attributes.remove(obj.data.attributes[name])
    obj.cloak.logo = next(iter(faces.logo_names(obj.data)), "")
    return f"Deleted logo '{name}'"


@operator("Export Face List", logo_reason, writes=".npy")
def logo_export(context: bpy.types.Context, filepath: str) -> str:
    """Write the active logo as a face list (.npy) with its sidecar (.json), for the command line"""
    obj = active_body(context)
    name = faces.active_logo(obj)
    with current_mesh(obj):
        ids = np.flatnonzero(faces.require_logo(obj, name))
        write_face_list(filepath, ids, topology(obj))
    return f"Wrote {filepath}: {len(ids):,} faces of '{obj.name}'"


@operator("Import Face List", reads=".npy;*.idx")
def logo_import(context: bpy.types.Context, obj: bpy.types.Object, filepath: str) -> str:
    """Make a logo from a face list (.npy) that was made for this mesh"""
    obj.cloak.logo = faces.import_face_list(obj, Path(filepath))
    return f"Logo '{obj.cloak.logo}': {int(faces.read_faces(obj, obj.cloak.logo).sum()):,} faces"


@of_the_body
def heat_reason(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Why a heat map can be neither shown nor hidden, nor faces taken from it."""
    if not layer_name(obj.data, HEAT):
        return f"'{obj.name}' has no heat map: press Heatmap first"
    return mode_reason(obj, "Leave {mode} to see the heat map")


@operator("Heatmap", upright_reason, lambda context: refusal(train_options, context.scene.cloak), trains=True)
def heatmap(context: bpy.types.Context) -> str:
    """Colour the body by how much each face moves the chosen detector's score: a logo pays where it is bright"""
    obj, settings = active_body(context), context.scene.cloak
    if obj.mode == "EDIT":
        bpy.ops.object.mode_set(mode="OBJECT")
    folder = first_free(user_folder("heatmap"), "heat")
    write_scene(folder / "scene", export_bodies(context, obj, pose_choice(settings))[0])
    words = heatmap_words(train_options(settings), folder)
    uid, expected = obj.session_uid, topology(obj)

    def show(job: Job) -> str:
        body = object_of(uid)
        if body is None or topology(body) != expected:
            raise InputError("The body changed while its heat map was made: press Heatmap again")
        show_heat(body, read_npy(folder / "heat.npy"))
        push_undo("Heatmap")
        shutil.rmtree(folder, ignore_errors=True)
        return "Heatmap: bright faces move the detector most"

    return "Measuring which faces move the detector" + run_cloak("Heatmap", words, folder, "heatmap", show, True)


HEAT_STOPS = ((0.05, 0.03, 0.20), (0.42, 0.07, 0.43), (0.83, 0.27, 0.30), (0.98, 0.60, 0.15), (0.99, 1.0, 0.75))
"""sRGB from no heat to the most: dark blue through magenta and orange to pale yellow."""


def heatmap_words(options: list[str], folder: Path) -> list[object]:
    """`cloak logo heatmap` of the first detector of a training, from `scene` to `heat.npy` in a folder."""
    known = [word for word in options if word.startswith(("--detector=", "--backgrounds=", "--angles=", "--device="))]
    words = {word.partition("=")[0]: word for word in reversed(known)}  # of several detectors the first
    return ["logo", "heatmap", "--scene", folder / "scene", *words.values(), "--out", folder / "heat.npy"]


def show_heat(obj: bpy.types.Object, heat: np.ndarray) -> None:
    """Keep heat [F] on the mesh and show it in the viewports; the hottest 1 % of the faces are the brightest."""
    heat = np.asarray(heat, np.float32)[: len(obj.data.polygons)]
    if heat.shape != (len(obj.data.polygons),):
        raise InputError(f"The heat map has {len(heat)} values for {len(obj.data.polygons)} faces: press Heatmap again")
    top = float(np.quantile(heat, 0.99)) if heat.size else 0.0
    level = np.clip(heat / top, 0, 1) if top > 0 else np.zeros(len(heat))
    places = np.linspace(0, 1, len(HEAT_STOPS))
    shades = np.stack([np.interp(level, places, channel) for channel in np.transpose(HEAT_STOPS)], -1)
    colors.write_face_colors(obj, HEATMAP, shades)
    make_layer(obj, HEAT).data.foreach_set("value", heat)
    colors.show_attribute(obj, HEATMAP)


@operator("Toggle Heatmap", heat_reason)
def heatmap_toggle(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Show the heat map, or give the body its own look, or its cloak, back; the heat stays for New from Heatmap"""
    if not colors.shows(obj, HEATMAP):
        show_heat(obj, read(layer_of(obj.data, HEAT).data, "value"))
        return f"'{obj.name}' shows its heat map"
    colors.show_attribute(obj, COLORS if is_dressed(obj) and layer_name(obj.data, COLORS) else "")
    if colors.shows(obj, HEATMAP):  # a body without colours of its own has nothing else to show
        remove_layer(obj.data, HEATMAP)
    return f"'{obj.name}' shows its heat map no more"


@operator("New from Heatmap", heat_reason)
def logo_from_heat(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Make a logo of the faces that move the detector most for their size"""
    heat = read(layer_of(obj.data, HEAT).data, "value")
    ids = hottest_faces(heat, faces.face_areas(obj), context.scene.cloak.heat_share)
    return f"Logo '{take(obj, np.isin(np.arange(len(heat)), ids), 'Heat')}': {len(ids):,} faces"


# --- what belongs together: a material, a face set -------------------------------------------------------------------

Items = list[tuple[str, str, str]]  # of a menu: value, name, description
MAX_SETS, TITLES = 64, {".sculpt_face_set": "Face Set"}


def _menu(find: Callable[[bpy.types.Object], Items]) -> Callable[[object, bpy.types.Context | None], Items]:
    """A menu of what is found on the active mesh."""
    kept: Items = []  # Blender keeps no copy of a menu's words: they must live on

    def items(_: object, context: bpy.types.Context | None) -> Items:
        obj = context.object if context else None
        kept[:] = find(obj) if obj and obj.type == "MESH" else []
        return kept

    return items


def materials(obj: bpy.types.Object) -> Items:
    """The object's material slots."""
    names = [slot.name or f"Slot {index + 1}" for index, slot in enumerate(obj.material_slots)]
    return [(str(index), name, f"Faces of {name}") for index, name in enumerate(names)]


def face_sets(obj: bpy.types.Object) -> Items:
    """Values of the mesh's integer face attributes, such as sculpting's face sets; the first MAX_SETS of each.

    They took the place of face maps, which Blender 4 no longer has.
    """
    items: Items = []
    with current_mesh(obj) as mesh:
        for name in face_set_names(obj):
            title = TITLES.get(name, name)
            values = np.unique(_integers(mesh, name))[:MAX_SETS].tolist()
            items += [(f"{value} {name}", f"{title} {value}", f"Faces whose '{name}' is {value}") for value in values]
    return items


ADD = props.switch("Add", "Add to the active logo instead of making a new one")


@operator(
    "From Material",
    body_reason,
    lambda context: "" if active_body(context).material_slots else "The body has no materials",
    slot=EnumProperty(name="Material", description="Whose faces to take", items=_menu(materials)),
    add=ADD,
)
def logo_from_material(context: bpy.types.Context, obj: bpy.types.Object, slot: str, add: bool) -> str:
    """Make a logo of all faces of a material"""
    with current_mesh(obj) as mesh:  # faces under the cloak count for the material they had before
        mask = colors.own_material_slots(obj, mesh) == int(slot)
        return _pick(obj, mask, materials(obj)[int(slot)][1], add)


@operator(
    "From Face Set",
    body_reason,
    lambda context: (
        "" if any(face_set_names(active_body(context))) else "The body has no face sets (integer face attributes)"
    ),
    face_set=EnumProperty(name="Face Set", description="Whose faces to take", items=_menu(face_sets)),
    add=ADD,
)
def logo_from_face_set(context: bpy.types.Context, obj: bpy.types.Object, face_set: str, add: bool) -> str:
    """Make a logo of a sculpting face set, or of the faces that share a value of an integer face attribute"""
    value, _, name = face_set.partition(" ")
    with current_mesh(obj) as mesh:
        return _pick(obj, _integers(mesh, name) == int(value), f"{TITLES.get(name, name)} {value}", add)


def _pick(obj: bpy.types.Object, mask: np.ndarray, name: str, add: bool) -> str:
    """Make a logo of this name, or add to the active one; returns what to say."""
    if not mask.any():
        raise InputError(f"'{name}' of '{obj.name}' has no faces: choose another (of {len(mask):,} faces)")
    return f"Logo '{take(obj, mask, name, add)}': {int(mask.sum()):,} faces taken"


def face_set_names(obj: bpy.types.Object) -> list[str]:
    """The attributes that sort an object's faces by whole numbers, and are not kept by Blender or Cloak themselves."""
    whole = [a.name for a in obj.data.attributes if a.data_type in ("INT", "INT8") and a.domain == "FACE"]
    return [name for name in whole if name not in {colors.SLOTS, *our_names(obj.data)}]


def _integers(mesh: bpy.types.Mesh, name: str) -> np.ndarray:
    return read(mesh.attributes[name].data, "value", dtype=np.int32)
