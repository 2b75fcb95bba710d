# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel lets the user set about judging a cloak: its evaluation, the detector's eye, films. On the scene."""

from __future__ import annotations

import math

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ..blender.blend_paths import RELATIVE, absolute
from ..trainer.command_lines import detector_options

AROUND = 180
"""An evaluation all around goes this many degrees to either side."""

BARE = 256
"""At most so many bare backgrounds are looked at for false alarms."""


class CloakJudging(bpy.types.PropertyGroup):
    """How a cloak is judged."""

    bodies: EnumProperty(
        name="Bodies",
        description="What to evaluate on",
        items=(
            (
                "KEPT",
                "Kept Back",
                "Bodies that training never saw, where it ran on Cloak's own people; else the bodies of the training",
            ),
            ("FRAMES", "Frames", "This body in the frames below: choose such as training did not see"),
        ),
    )
    frame_start: IntProperty(name="Start", description="First frame to evaluate on", default=1)
    frame_end: IntProperty(name="End", description="Last frame to evaluate on", default=12)
    frame_step: IntProperty(name="Step", description="Frames from one to the next", default=1, min=1)
    backgrounds: StringProperty(
        name="Backgrounds",
        description="Folder of photographs without people that training did not see; empty for procedural scenes that "
        "training never sees",
        subtype="DIR_PATH",
        options={"ANIMATABLE"} | RELATIVE,
    )
    angle: IntProperty(
        name="Angle Step (°)",
        description="Degrees from one azimuth to the next, all around the body",
        default=15,
        min=1,
        max=90,
    )
    images: IntProperty(
        name="Images",
        description="Images of each kind (the cloak, and each control), spread over bodies, angles and backgrounds. "
        "More of them take longer and make the intervals narrower",
        default=240,
        min=8,
        max=100_000,
    )
    ring: BoolProperty(
        name="Ring", description="Draw success by azimuth as a ring around the body's feet", default=True
    )

    eye_from: EnumProperty(
        name="From",
        description="Where the detector looks from",
        items=(("VIEW", "View", "Where you look from, as you move around"), ("CAMERA", "Camera", "The scene's camera")),
    )
    eye_background: IntProperty(
        name="Background",
        description="Which background stands behind the body: a photograph of the training's folder by its number, or "
        "a procedural scene where there is none",
        min=0,
        max=9999,
    )

    people: StringProperty(
        name="People",
        description="People in photographs to wear the cloak: a people.json as COCO has them, or the folder it lies in",
        subtype="FILE_PATH",
        options={"ANIMATABLE"} | RELATIVE,
    )
    people_page: IntProperty(name="Page", description="Page of the pictures of people", min=0)

    film_format: EnumProperty(
        name="Format",
        description="What to write",
        items=(
            ("gif", "GIF", "Plays everywhere, large"),
            ("mp4", "MP4", "Small; the trainer's Python needs the extra 'film' (PyAV)"),
            ("png", "Pictures", "A folder of PNGs"),
        ),
    )
    film_seconds: FloatProperty(
        name="Turntable", description="Seconds that a turntable takes", default=6.0, min=0.5, max=120.0, subtype="TIME"
    )


def evaluate_options(judging: CloakJudging, specs: tuple[str, ...], device: str) -> list[str]:
    """Options of `cloak evaluate`, but for the scene."""
    azimuths = len(range(-AROUND, AROUND, judging.angle))
    words = [f"--angles={-AROUND}:{-AROUND + (azimuths - 1) * judging.angle}:{judging.angle}"]
    # One pose must do for all the images; of more poses some are drawn.
    words += [f"--images-per-view={math.ceil(judging.images / azimuths)}", f"--most-images={judging.images}"]
    words.append(f"--bare={min(BARE, judging.images)}")
    return [*words, *detector_options(specs), backgrounds_option(judging), f"--device={device}"]


def backgrounds_option(judging: CloakJudging) -> str:
    """What stands behind the body when it is judged."""
    return f"--backgrounds={absolute(judging.backgrounds) or 'procedural:test'}"
