# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a viewport or a camera of Blender looks from, in the trainer's words.

The trainer's cameras stand upright: azimuth, elevation, distance from a point they look at, a vertical field of view.
Whatever looks in perspective and is not rolled can be said so exactly.
"""

import math
from dataclasses import dataclass, replace

import bpy
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Matrix

from ..blender.mesh_arrays import box_of
from ..body.objects import scene_axes
from ..files.errors import InputError

ROLL = 2e-3  # largest roll of a level camera, as a sine
NEAREST = 0.05  # smallest distance of camera and pivot, in metres


@dataclass(frozen=True)
class Viewpoint:
    """A camera; degrees, metres, the trainer's axes."""

    azimuth: float
    elevation: float
    distance: float
    field_of_view: float
    pivot: tuple[float, float, float]
    width: int
    height: int

    def sized(self, longest: int) -> "Viewpoint":
        """Scale the picture to this many pixels along its longer side."""
        scale = longest / max(self.width, self.height)
        return replace(self, width=max(1, round(self.width * scale)), height=max(1, round(self.height * scale)))

    def is_like(self, other: "Viewpoint") -> bool:
        """Whether both viewpoints show the same picture."""
        own, others = (np.array([v.azimuth, v.elevation, v.field_of_view, *v.place()]) for v in (self, other))
        turn = abs((own[0] - others[0] + 180) % 360 - 180)
        aspect = abs(self.width / self.height - other.width / other.height)
        return bool(turn < 0.02 and np.abs(own[1:] - others[1:]).max() < 0.02 and aspect < 0.02)

    def place(self) -> np.ndarray:
        """Return the camera's position [3]."""
        a, e = math.radians(self.azimuth), math.radians(self.elevation)
        back = np.array([math.cos(e) * math.sin(a), math.sin(e), math.cos(e) * math.cos(a)])
        return np.array(self.pivot) + self.distance * back


def viewpoint(
    matrix: Matrix, field_of_view: float, width: int, height: int, middle: np.ndarray, metre: float = 1.0
) -> Viewpoint:
    """The viewpoint of a camera's world matrix that looks at what is as far away as `middle` (Blender's units).

    field_of_view: vertical, degrees. metre: Blender's units in a metre. Raises `InputError` for a camera that is
    rolled, or has the body behind it.
    """
    axes = np.array(matrix.to_3x3().normalized()).T  # rows: right, up, back
    right, up, back = scene_axes(axes).astype(float)
    if abs(right[1]) > ROLL or up[1] < -ROLL:
        raise InputError("The view is rolled, and the trainer's cameras stand upright: level it (Numpad 1, 3 or 7)")
    place = scene_axes(np.array(matrix.translation, float)) / metre
    ahead = float(np.dot(place - scene_axes(np.array(middle, float)) / metre, back))
    if ahead <= 0:
        raise InputError("The body is behind the camera")
    distance = max(ahead, NEAREST)
    return Viewpoint(
        azimuth=math.degrees(math.atan2(-right[2], right[0])),
        elevation=math.degrees(math.asin(min(1.0, max(-1.0, back[1])))),
        distance=distance,
        field_of_view=field_of_view,
        pivot=tuple((place - distance * back).tolist()),
        width=width,
        height=height,
    )


def of_view(
    scene: bpy.types.Scene, region: bpy.types.Region, view: bpy.types.RegionView3D, obj: bpy.types.Object
) -> Viewpoint:
    """That of a viewport: the camera's where it is looked through, else of the view that looks in freely."""
    if view.view_perspective == "CAMERA":
        return of_camera(scene, obj)
    if view.view_perspective != "PERSP":
        raise InputError("This view has no perspective: press Numpad 5, or let the detector look through the camera")
    field = 2 * math.degrees(math.atan(1 / view.window_matrix[1][1]))
    size, metre = (region.width, region.height), 1 / scene.unit_settings.scale_length
    return viewpoint(view.view_matrix.inverted(), field, *size, box_of(obj).mean(0), metre)


def of_camera(scene: bpy.types.Scene, obj: bpy.types.Object) -> Viewpoint:
    """That of the scene's camera, which looks at a body."""
    holder = scene.camera
    if holder is None or holder.type != "CAMERA":
        raise InputError("The scene has no camera: add one (Shift A), or let the detector look from the view")
    camera, render = holder.data, scene.render
    if camera.type != "PERSP":
        raise InputError(f"'{holder.name}' has no perspective: set its Type to Perspective")
    if abs(camera.shift_x) > 1e-6 or abs(camera.shift_y) > 1e-6:
        raise InputError(f"'{holder.name}' has a lens shift, which the trainer's cameras have not: set it to 0")
    width = render.resolution_x * render.pixel_aspect_x
    height = render.resolution_y * render.pixel_aspect_y
    top, _, low, _ = camera.view_frame(scene=scene)[:4]
    field = 2 * math.degrees(math.atan(abs(top.y - low.y) / 2 / abs(top.z)))
    metre = 1 / scene.unit_settings.scale_length
    return viewpoint(holder.matrix_world, field, round(width), round(height), box_of(obj).mean(0), metre)


def camera_frame(context: bpy.types.Context) -> tuple[float, float, float, float] | None:
    """Where the camera's picture lies in a viewport: left, bottom, right, top in pixels; None where another view is."""
    view, holder = context.region_data, context.scene.camera
    if view is None or view.view_perspective != "CAMERA" or holder is None or holder.type != "CAMERA":
        return None
    matrix = holder.matrix_world.normalized()
    corners = [matrix @ corner for corner in holder.data.view_frame(scene=context.scene)]
    places = [location_3d_to_region_2d(context.region, view, corner) for corner in corners]
    return None if None in places else (*np.min(places, 0).tolist(), *np.max(places, 0).tolist())
