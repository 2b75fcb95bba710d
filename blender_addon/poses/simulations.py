# SPDX-License-Identifier: GPL-3.0-or-later
"""Cloth, soft bodies and simulations of Geometry Nodes: how they lie in a frame follows from the frames before, so that
Blender shows them as they were where a frame is jumped to that was never played."""

from __future__ import annotations

from collections.abc import Iterable

import bpy

from ..files.errors import InputError
from .poses import PoseChoice

_CACHED = ("CLOTH", "SOFT_BODY")


def require_own_animation(objects: Iterable[bpy.types.Object], choice: PoseChoice) -> None:
    """Raise `InputError` where poses are those of several actions: what is simulated has played one animation only."""
    if choice.source != "ACTIONS":
        return
    for obj in objects:
        for modifier in obj.modifiers:
            if _is_simulated(modifier):
                raise InputError(
                    f"'{obj.name}' is simulated ({modifier.name}), in the scene's own animation alone: "
                    "choose Frame Range instead of every action"
                )


def first_frame(scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]) -> int | None:
    """The frame from which on every frame has to be played; None where nothing is simulated, or all of it is baked."""
    frames = [
        modifier.point_cache.frame_start if modifier.type in _CACHED else scene.frame_start
        for obj in objects
        for modifier in obj.modifiers
        if _is_simulated(modifier) and not (modifier.type in _CACHED and modifier.point_cache.is_baked)
    ]
    return min(frames, default=None)


def _is_simulated(modifier: bpy.types.Modifier) -> bool:
    if not modifier.show_viewport:
        return False
    return modifier.type in _CACHED or (modifier.type == "NODES" and _has_simulation(modifier.node_group))


def _has_simulation(tree: bpy.types.NodeTree | None) -> bool:
    if tree is None:
        return False
    groups = (node.node_tree for node in tree.nodes if node.bl_idname == "GeometryNodeGroup")
    return any(node.bl_idname == "GeometryNodeSimulationOutput" for node in tree.nodes) or any(
        map(_has_simulation, groups)
    )
