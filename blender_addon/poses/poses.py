# SPDX-License-Identifier: GPL-3.0-or-later
"""Which poses are exported: the current one, a frame range, or every action that moves the body.

Stepping through poses changes the scene's frame, actions and unkeyed pose; `visit` puts all of it back.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import bpy
import numpy as np

from ..blender.mesh_arrays import box_of, vertex_points
from ..body.garments import armature_of
from ..files.errors import InputError

MAX_POSES = 1000
DISTANCE = 2.2  # metres from the middle of the body to the training cameras, unless a settings file says otherwise
SMALLEST, LARGEST = 0.2, 2 * DISTANCE
"""Metres: the largest extent of a body that is more than a few pixels, and that a camera does not stand inside of."""
_CACHED = ("CLOTH", "SOFT_BODY")
CHANNELS = ("location", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale")


@dataclass(frozen=True)
class PoseChoice:
    """What the user asked for; `start`, `end` and `step` are frames (ACTIONS uses `step` alone)."""

    source: str = "CURRENT"
    start: int = 1
    end: int = 1
    step: int = 1


@dataclass(frozen=True)
class Pose:
    """One pose to export: a frame, with an action put on `owner` where one is given."""

    name: str
    frame: int | None = None
    owner: bpy.types.ID | None = None
    action: bpy.types.Action | None = None


def list_poses(obj: bpy.types.Object, choice: PoseChoice) -> list[Pose]:
    """List the poses of a choice; raise `InputError` if there are none or too many."""
    if choice.source == "CURRENT":
        return [Pose("current pose")]
    if choice.step < 1:
        raise InputError(f"Frame step {choice.step}: it must be at least 1")
    if choice.source == "RANGE":
        if choice.end < choice.start:
            raise InputError(f"Frames {choice.start} to {choice.end}: the end lies before the start")
        poses = [Pose(f"frame {f}", f) for f in range(choice.start, choice.end + 1, choice.step)]
    else:
        poses = []
        for action in bpy.data.actions:
            owner = next((o for o in _owners(obj) if _fits(action, o)), None)
            first, last = map(round, action.frame_range)
            frames = range(first, last + 1, choice.step) if owner is not None else ()
            poses += [Pose(f"{action.name} {frame}", frame, owner, action) for frame in frames]
        if not poses:
            raise InputError(f"No action moves '{obj.name}': choose Current Pose or Frame Range, or add an action")
    if len(poses) > MAX_POSES:
        raise InputError(f"{len(poses)} poses are more than {MAX_POSES}: raise the frame step")
    return poses


def _owners(obj: bpy.types.Object) -> list[bpy.types.ID]:
    """List what an action may animate: the armature (else the object) and the shape keys."""
    return [owner for owner in (armature_of(obj) or obj, obj.data.shape_keys) if owner is not None]


def _fits(action: bpy.types.Action, owner: bpy.types.ID) -> bool:
    """Whether an action moves a property that the owner has."""
    if bpy.app.version < (4, 4, 0):
        bags = [action] if action.id_root in (owner.id_type, "UNSPECIFIED") else []
    else:
        slot, strips = _slot(action, owner), [strip for layer in action.layers for strip in layer.strips]
        bags = [strip.channelbag(slot) for strip in strips] if slot is not None else []
    for curve in (curve for bag in bags if bag is not None for curve in bag.fcurves):
        with suppress(ValueError):  # the owner has no such property
            owner.path_resolve(curve.data_path)
            return True
    return False


def _slot(action: bpy.types.Action, owner: bpy.types.ID) -> object | None:
    """The action's slot for this kind of owner (actions have slots from Blender 4.4)."""
    return next((s for s in action.slots if s.target_id_type in (owner.id_type, "UNSPECIFIED")), None)


def extent(obj: bpy.types.Object) -> tuple[float, float, float]:
    """Width, depth and height of the body as it stands now, in metres."""
    low, high = box_of(obj)
    return tuple(((high - low) * bpy.context.scene.unit_settings.scale_length).tolist())


def require_size(obj: bpy.types.Object) -> None:
    """Raise `InputError` for a body that is too small or too large for cameras at a person's distance."""
    largest = max(extent(obj))
    what = f"'{obj.name}' measures {_length(largest)}"
    how = "scale it to a person's size (S in the viewport), or set Unit Scale in the scene's properties"
    if largest < SMALLEST:
        raise InputError(f"{what}: {DISTANCE} m away it would be a few pixels; {how}")
    if largest > LARGEST:
        raise InputError(f"{what}: a camera {DISTANCE} m away would stand inside it; {how}")


def _length(metres: float) -> str:
    return f"{1000 * metres:.3g} mm" if metres < 1 else f"{metres:.3g} m"


def require_faces(obj: bpy.types.Object) -> None:
    """Raise `InputError` if a vertex has no finite position, or if the modifiers remove all faces."""
    points = vertex_points(obj.data) if obj.mode != "EDIT" else np.zeros(0)
    if not np.isfinite(points.sum()):
        count = int((~np.isfinite(points).all(1)).sum())
        raise InputError(f"'{obj.name}' has {count} vertices without a place (NaN): undo, or delete them")
    if obj.mode == "EDIT" or not obj.modifiers:
        return
    if not len(obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.polygons):
        names = ", ".join(f"'{m.name}'" for m in obj.modifiers if m.show_viewport)
        raise InputError(f"No face of '{obj.name}' is left by its modifiers ({names}): turn off the one that hides it")


def lying_warning(obj: bpy.types.Object) -> str:
    """Warn about a body that lies on the ground; "" for one that stands."""
    width, depth, height = extent(obj)
    if not 0 < height < 0.5 * max(width, depth):
        return ""
    return (
        f"'{obj.name}' lies: it is {_length(max(width, depth))} long and {_length(height)} high. Detectors know people "
        "who stand, so there may be nothing to hide: turn it upright (Z is up), or choose other poses"
    )


@contextmanager
def visit(context: bpy.types.Context, obj: bpy.types.Object, play_from: int | None = None) -> Iterator[object]:
    """Yields `go(pose)`, which puts the body into a pose; frame, actions and unkeyed poses return at the end.

    play_from: go through every frame from this one on, as simulations need it, in rising order.
    """
    scene, restore = context.scene, _state_of(context, obj)
    moved, ahead = False, play_from

    def go(pose: Pose) -> None:
        nonlocal moved, ahead
        if pose.action is not None:
            data = pose.owner.animation_data or pose.owner.animation_data_create()
            data.use_nla, data.action = False, pose.action
            if hasattr(data, "action_slot"):
                data.action_slot = _slot(pose.action, pose.owner)
        if pose.frame is not None:
            moved = True
            if ahead is not None:
                for between in range(ahead, pose.frame):
                    scene.frame_set(between)
                ahead = max(ahead, pose.frame + 1)
            scene.frame_set(pose.frame)
        else:
            context.view_layer.update()

    try:
        yield go
    finally:
        if moved:
            restore()


@contextmanager
def held(context: bpy.types.Context, obj: bpy.types.Object) -> Iterator[None]:
    """During the block the body has no animation: opening and rendering a file puts back a pose that has no keys."""
    restore = _state_of(context, obj)
    try:
        for owner in _owners(obj):
            if owner.animation_data is not None:
                owner.animation_data.action, owner.animation_data.use_nla = None, False
        yield
    finally:
        restore()


def _state_of(context: bpy.types.Context, obj: bpy.types.Object) -> Callable[[], None]:
    """Return a function that restores the frame, and the body's animation, place and pose, with keys or without."""
    scene, armature, keys = context.scene, armature_of(obj), obj.data.shape_keys
    frame, subframe = scene.frame_current, scene.frame_subframe
    movable = [obj, *([armature, *armature.pose.bones] if armature else ())]
    # Not by matrices, which forget whole turns and round what the user typed.
    places = [(one, {name: tuple(getattr(one, name)) for name in CHANNELS}) for one in movable]
    values = {key.name: key.value for key in keys.key_blocks} if keys else {}
    animations = []
    for owner in _owners(obj):
        data = owner.animation_data
        animations.append((owner, data and (data.use_nla, data.action, getattr(data, "action_slot", None))))

    def restore() -> None:
        for owner, before in animations:
            if before is None:
                owner.animation_data_clear()
                continue
            use_nla, action, slot = before
            now = owner.animation_data
            now.use_nla = use_nla
            if now.action != action:
                now.action = action
            if action is not None and slot is not None:
                now.action_slot = slot
        scene.frame_set(frame, subframe=subframe)
        for one, channels in places:
            for name, value in channels.items():
                setattr(one, name, value)
        for name, value in values.items():
            keys.key_blocks[name].value = value
        context.view_layer.update()

    return restore


def require_own_animation(objects: Iterable[bpy.types.Object], choice: PoseChoice) -> None:
    """Raise `InputError` for poses of several actions if an object is simulated: its cache holds one animation."""
    if choice.source != "ACTIONS":
        return
    for obj, modifier in simulations(objects):
        raise InputError(
            f"'{obj.name}' is simulated ({modifier.name}), in the scene's own animation alone: "
            "choose Frame Range instead of every action"
        )


def first_frame(scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]) -> int | None:
    """The frame from which on every frame has to be played; None where nothing is simulated, or all of it is baked."""
    caches = [getattr(modifier, "point_cache", None) for _, modifier in simulations(objects)]  # nodes have none
    frames = [cache.frame_start if cache else scene.frame_start for cache in caches if not (cache and cache.is_baked)]
    return min(frames, default=None)


def simulations(objects: Iterable[bpy.types.Object]) -> Iterator[tuple[bpy.types.Object, bpy.types.Modifier]]:
    """The simulated ones among objects, each with the modifier that does it."""
    for obj in objects:
        for modifier in (modifier for modifier in obj.modifiers if modifier.show_viewport):
            if modifier.type in _CACHED or (modifier.type == "NODES" and _has_simulation(modifier.node_group)):
                yield obj, modifier


def _has_simulation(tree: bpy.types.NodeTree | None) -> bool:
    if tree is None:
        return False
    groups = (node.node_tree for node in tree.nodes if node.bl_idname == "GeometryNodeGroup")
    simulates = any(node.bl_idname == "GeometryNodeSimulationOutput" for node in tree.nodes)
    return simulates or any(map(_has_simulation, groups))
