# SPDX-License-Identifier: GPL-3.0-or-later
"""Step 1, the mesh that wears the logo: its operators, and its panel."""

import shutil
from pathlib import Path

import bpy

from ..blender.evaluated import applied_copy
from ..blender.faces import active_logo, logo_names, write_faces
from ..blender.mesh_arrays import require_object_mode
from ..exchange.scenes import read_scene
from ..files.errors import InputError
from ..trainer.jobs import run_cloak
from ..trainer.program import SAMPLES, sample_words, trainer_reason, user_folder
from ..translations import said
from ..ui import props
from ..ui.bases import CloakPanel, operator, push_undo, wrapped
from ..ui.window import areas, main_region
from . import objects
from .garments import faces_over, wearable
from .objects import ASSETS, CLOTHES, active_body, add_people, body_reason, logo_reason

UNSEEN = (
    "The camera does not see {}: it sees meshes alone (Object > Convert > Mesh; of an instance, Object > Apply > Make "
    "Instances Real)"
)
MOST_WORN = 8  # most worn objects to list


@operator("Subdivide Body", triangulate=props.switch("Triangulate", "Also split every face into triangles", True))
def subdivide(context: bpy.types.Context, obj: bpy.types.Object, triangulate: bool) -> str:
    """Split every face of the body in place (Simple, one level), so that the cloak has more and smaller faces. Shape \
keys, weights, materials, UVs and logos are kept"""
    before, after = objects.subdivide(obj, triangulate)
    return f"'{obj.name}': {before:,} faces became {after:,}"


@operator("Apply a Copy")
def apply_copy(context: bpy.types.Context, obj: bpy.types.Object) -> str:
    """Make a copy of the body with the modifiers applied that make new faces, and hide the original. Deforming \
modifiers stay; shape keys end in their present mix"""
    require_object_mode(obj, "Leave {mode} to apply modifiers")
    copy = applied_copy(context, obj)
    return f"'{copy.name}': {len(copy.data.polygons):,} faces; '{obj.name}' is hidden"


@operator(
    "Add Sample Body",
    told_by="people",
    people=props.choice(
        "People",
        "Whom to add",
        ("BARE", "Sample Body", "Standing people of varied shape, in clothing that is painted on"),
        ("CLOTHED", "Clothed", "People who walk, run and stand in shirt and trousers"),
    ),
)
def add_sample_body(context: bpy.types.Context, people: str) -> str:
    """Add Cloak's own people, one pose a frame, with named regions as logos: standing in clothing that is painted on, \
or walking and running in a shirt and trousers that are objects of their own"""
    if people == "BARE" and trainer_reason() and (ASSETS / "sample").is_dir():
        return _add(ASSETS / "sample", people)
    folder = user_folder("sample")
    scene = folder / "scene"
    shutil.rmtree(scene, ignore_errors=True)
    add = lambda job: _add(scene, people)
    waits = run_cloak("Sample body", sample_words(scene, people), folder, "sample", add)
    return f"Fetching the sample body from the trainer{waits}"


def _add(scene: Path, people: str) -> str:
    bodies, clothed = read_scene(scene), people == "CLOTHED"
    obj = add_people(bpy.context, bodies, clothed, "Sample Body")
    obj.cloak.made_from = f"{SAMPLES[people]}|{bodies.topology}"
    for window, area in areas("VIEW_3D") if not bpy.app.background else ():
        with bpy.context.temp_override(window=window, area=area, region=main_region(area)):
            bpy.ops.view3d.view_selected()
    settings = bpy.context.scene.cloak
    settings.pose_source, settings.frame_step = "RANGE", 1
    settings.frame_start, settings.frame_end = 1, bodies.pose_count
    logo = CLOTHES if clothed else "chest"
    if logo in logo_names(obj.data):
        obj.cloak.logo = logo
    push_undo("Add Sample Body")
    worn = [f"{o.name}: {len(o.data.polygons):,} faces" for o in (obj, *obj.children)]
    return f"Added {', '.join(worn)}"


@operator("Put the Logo on It", logo_reason, garment=props.text("Piece", "Name of what covers the logo"))
def logo_onto(context: bpy.types.Context, obj: bpy.types.Object, garment: str) -> str:
    """Let the logo go on over this piece: make a logo of the same name of the faces that lie over it"""
    worn = next((o for o in wearable(obj) if o.name == garment), None)
    if worn is None:
        raise InputError(f"'{garment}' is not worn by '{obj.name}' any more")
    logo = active_logo(obj)
    mask = faces_over(context, obj, worn, logo)
    if not mask.any():
        raise InputError(f"No face of '{worn.name}' lies over logo '{logo}'")
    write_faces(worn, logo, mask)
    return f"Logo '{logo}' goes on over {int(mask.sum()):,} faces of '{worn.name}'"


class CLOAK_PT_body(CloakPanel, label="1. Body", unfinished=body_reason):
    """Step 1: the mesh that wears the logo"""

    def draw(self, context: bpy.types.Context) -> None:
        reason = body_reason(context)
        if reason:
            wrapped(self.layout, context, reason)
        else:
            obj = active_body(context)
            count = f"{len(obj.data.polygons):,} faces" if obj.mode != "EDIT" else "In Edit Mode"
            self.layout.label(text=f"{obj.name}: {said(count)}", icon="MESH_DATA")
            for worn in wearable(obj)[:MOST_WORN]:
                row = self.layout.row(align=True)
                row.label(text=worn.name, icon="MATCLOTH")
                icon = "HIDE_ON" if worn.cloak.left_out else "HIDE_OFF"
                row.prop(worn.cloak, "left_out", text="", icon=icon, toggle=True)
            if unseen := ", ".join(f"'{o.name}'" for o in wearable(obj, meshes=False)[:MOST_WORN]):
                wrapped(self.layout, context, UNSEEN.format(unseen), icon="ERROR")
        # The cube of a new file is a body, too.
        if not trainer_reason() and (reason or not logo_names(active_body(context).data)):
            self.layout.operator("cloak.try_it", icon="PLAY")
        row = self.layout.row(align=True)
        splits = row.row(align=True)
        splits.enabled = not reason
        settings = context.scene.cloak
        splits.operator("cloak.subdivide", text="Subdivide").triangulate = settings.triangulate
        splits.prop(settings, "triangulate", toggle=True)
        row = self.layout.row(align=True)
        row.operator("cloak.add_sample_body", text="Sample Body", icon="ADD").people = "BARE"
        row.operator("cloak.add_sample_body", text="Clothed", icon="ADD").people = "CLOTHED"
        self.outcome(context, "Sample body")
        self.outcome(context, "Test")
