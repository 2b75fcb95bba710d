# SPDX-License-Identifier: GPL-3.0-or-later
"""What is drawn over viewports, or watches them: the logo's tint, the ring of an evaluation, the detector's eye."""

from __future__ import annotations

from . import eye, eye_drawing, overlay, ring

ROOMS = (overlay, ring, eye, eye_drawing)


def register() -> None:
    for room in ROOMS:
        room.register()


def unregister() -> None:
    for room in reversed(ROOMS):
        room.unregister()
