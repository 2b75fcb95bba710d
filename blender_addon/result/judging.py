# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel lets the user set about judging a cloak: its evaluation, the detector's eye, films. On the scene."""

from __future__ import annotations

import math

import bpy

from ..blender.blend_paths import absolute
from ..poses.poses import PoseChoice
from ..trainer.command_lines import options
from ..ui import props

AROUND = 180
"""An evaluation all around goes this many degrees to either side."""

BARE = 256
"""Most empty backgrounds that are checked for false alarms."""


class CloakJudging(bpy.types.PropertyGroup):
    """How a cloak is judged."""

    bodies: props.choice(
        "Bodies",
        "What to evaluate on",
        (
            "KEPT",
            "Kept Back",
            "Bodies that training never saw, where it ran on Cloak's own people; else the bodies of the training",
        ),
        ("FRAMES", "Frames", "This body in the frames below: choose such as training did not see"),
    )
    frame_start: props.whole("Start", "First frame to evaluate on", 1)
    frame_end: props.whole("End", "Last frame to evaluate on", 12)
    frame_step: props.whole("Step", "Frames from one to the next", 1, min=1)
    backgrounds: props.path(
        "Backgrounds",
        "Folder of photographs without people that training did not see; empty for procedural scenes that "
        "training never sees",
        "DIR_PATH",
    )
    angle: props.whole("Angle Step (°)", "Degrees from one azimuth to the next, all around the body", 15, min=1, max=90)
    images: props.whole(
        "Images",
        "Images of each kind (the cloak, and each control), spread over bodies, angles and backgrounds. "
        "More of them take longer and make the intervals narrower",
        240,
        min=8,
        max=100_000,
    )
    ring: props.switch("Ring", "Draw success by azimuth as a ring around the body's feet", True)

    eye_from: props.choice(
        "From",
        "Where the detector looks from",
        ("VIEW", "View", "Where you look from, as you move around"),
        ("CAMERA", "Camera", "The scene's camera"),
    )
    eye_background: props.whole(
        "Background",
        "Which background stands behind the body: a photograph of the training's folder by its number, or "
        "a procedural scene where there is none",
        min=0,
        max=9999,
    )

    people: props.path(
        "People", "People in photographs to wear the cloak: a people.json as COCO has them, or the folder it lies in"
    )
    people_page: props.whole("Page", "Page of the pictures of people", min=0)

    film_format: props.choice(
        "Format",
        "What to write",
        ("gif", "GIF", "Plays everywhere, large"),
        ("mp4", "MP4", "Small; the trainer's Python needs the extra 'film' (PyAV)"),
        ("png", "Pictures", "A folder of PNGs"),
    )
    film_seconds: props.number("Turntable", "Seconds that a turntable takes", 6.0, min=0.5, max=120.0, subtype="TIME")

    @property
    def frames(self) -> PoseChoice | None:
        """This body's frames to evaluate on; None for the bodies that were kept back."""
        if self.bodies == "KEPT":
            return None
        return PoseChoice("RANGE", self.frame_start, self.frame_end, self.frame_step)


def evaluate_options(judging: CloakJudging, specs: tuple[str, ...], device: str) -> list[str]:
    """Options of `cloak evaluate`, but for the scene."""
    azimuths = len(range(-AROUND, AROUND, judging.angle))
    angles = f"{-AROUND}:{-AROUND + (azimuths - 1) * judging.angle}:{judging.angle}"
    words = options(specs, angles=angles, bare=min(BARE, judging.images), device=device)
    # One pose must do for all the images; of more poses some are drawn.
    words += [f"--images-per-view={math.ceil(judging.images / azimuths)}", f"--most-images={judging.images}"]
    return [*words, backgrounds_option(judging)]


def backgrounds_option(judging: CloakJudging) -> str:
    """Option of the trainer for the evaluation's backgrounds."""
    return f"--backgrounds={absolute(judging.backgrounds) or 'procedural:test'}"
