# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress for work that Blender has to wait for: the mouse pointer counts up."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import bpy


@contextmanager
def progress_cursor(context: bpy.types.Context) -> Iterator[Callable[[float], None]]:
    """Yields `show(fraction)`, 0 to 1, which the pointer shows in percent until the block ends."""
    manager = context.window_manager
    manager.progress_begin(0, 100)
    try:
        yield lambda fraction: manager.progress_update(round(100 * fraction))
    finally:
        manager.progress_end()
