# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel of step 1: the mesh that wears the logo, and the program that trains."""

import bpy

from ..trainer.preferences import PACKAGE, preferences, trainer_reason
from ..translations import said
from ..ui.panel_parts import CloakPanel, figure, wrapped
from .garments import unseen_on, wearable
from .objects import active_body, body_reason

UNSEEN = (
    "The camera does not see {}: it sees meshes alone (Object > Convert > Mesh; of an instance, Object > Apply > Make "
    "Instances Real)"
)
MOST_WORN = 8  # most worn objects to list
TRAINER = "The program that trains, outside of Blender; the add-on's preferences choose and test it"


class CLOAK_PT_body(CloakPanel, label="1. Body", unfinished=body_reason):
    """Step 1: the mesh that wears the logo"""

    def draw(self, context: bpy.types.Context) -> None:
        reason = body_reason(context)
        if reason:
            wrapped(self.layout, context, reason)
            if not trainer_reason():
                self.layout.operator("cloak.try_it", icon="PLAY")
        else:
            self._body(context, active_body(context))
        row = self.layout.row(align=True)
        splits = row.row(align=True)
        splits.enabled = not reason
        splits.operator("cloak.subdivide", text="Subdivide")
        splits.prop(context.scene.cloak, "triangulate", toggle=True)
        row = self.layout.row(align=True)
        row.operator("cloak.add_sample_body", text="Sample Body", icon="ADD").people = "BARE"
        row.operator("cloak.add_sample_body", text="Clothed", icon="ADD").people = "CLOTHED"
        self.progress(context, "Sample body")
        self._trainer(context)

    def _body(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        """Draw the body and what it wears, each piece with its visibility switch."""
        count = f"{len(obj.data.polygons):,} faces" if obj.mode != "EDIT" else "In Edit Mode"
        self.layout.label(text=f"{obj.name}: {said(count)}", icon="MESH_DATA")
        for worn in wearable(obj)[:MOST_WORN]:
            row = self.layout.row(align=True)
            row.label(text=worn.name, icon="MATCLOTH")
            icon = "HIDE_ON" if worn.cloak.left_out else "HIDE_OFF"
            row.prop(worn.cloak, "left_out", text="", icon=icon, toggle=True)
        if unseen := ", ".join(f"'{o.name}'" for o in unseen_on(obj)[:MOST_WORN]):
            wrapped(self.layout, context, UNSEEN.format(unseen), icon="ERROR")

    def _trainer(self, context: bpy.types.Context) -> None:
        """Draw which trainer is used, or how to get one."""
        if reason := trainer_reason():
            wrapped(self.layout, context, reason)
            row = self.layout.row(align=True)
            row.operator("cloak.copy_install_line", icon="COPYDOWN")
            row.operator("preferences.addon_show", text="", icon="PREFERENCES").module = PACKAGE
        else:
            figure(self.layout, preferences().answer or "Trainer found", TRAINER, "CONSOLE")
        self.progress(context, "Test")
