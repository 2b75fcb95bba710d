# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel of step 1: the mesh that wears the logo."""

import bpy

from ..blender.faces import logo_names
from ..trainer.program import trainer_reason
from ..translations import said
from ..ui.panel_parts import CloakPanel, wrapped
from .garments import wearable
from .objects import active_body, body_reason

UNSEEN = (
    "The camera does not see {}: it sees meshes alone (Object > Convert > Mesh; of an instance, Object > Apply > Make "
    "Instances Real)"
)
MOST_WORN = 8  # most worn objects to list


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
        splits.operator("cloak.subdivide", text="Subdivide")
        splits.prop(context.scene.cloak, "triangulate", toggle=True)
        row = self.layout.row(align=True)
        row.operator("cloak.add_sample_body", text="Sample Body", icon="ADD").people = "BARE"
        row.operator("cloak.add_sample_body", text="Clothed", icon="ADD").people = "CLOTHED"
        self.outcome(context, "Sample body")
        self.outcome(context, "Test")
