"""A mouse that clicks on words in Blender's window, and a picture of each click."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import until_done, view_area
from words import places, screen

PATIENCE = 180
"""Seconds until words must be there, and a click must have had its effect; a busy machine draws slowly."""
WIDTH = 1200
"""Of the pictures."""


def xdo(*words: object) -> None:
    subprocess.run(["xdotool", *map(str, words)], check=True)


def region(kind: str):
    return next(r for r in view_area().regions if r.type == kind)


def middle_of(kind: str) -> tuple[int, int]:
    """Of a region of the viewport, in pixels of the screen."""
    found, window = region(kind), bpy.context.window_manager.windows[0]
    return found.x + found.width // 2, window.height - (found.y + found.height // 2)


def at(x: float, y: float) -> tuple[int, int]:
    """A share of the viewport from its lower left, as pixels of the screen from the upper left."""
    found, window = region("WINDOW"), bpy.context.window_manager.windows[0]
    return int(found.x + x * found.width), int(window.height - (found.y + y * found.height))


def move(x: float, y: float, steps: int = 1, start: tuple[float, float] | None = None) -> Iterator[float]:
    """Yields between the moves, so that Blender sees each."""
    first = start or (x, y)
    for step in range(1, steps + 1):
        share = step / steps
        xdo("mousemove", *at(first[0] + (x - first[0]) * share, first[1] + (y - first[1]) * share))
        yield 0.1


def sidebar() -> tuple[np.ndarray, int, int]:
    """[h, w] what the sidebar shows, and its left and upper edge on the screen."""
    found, window = region("UI"), bpy.context.window_manager.windows[0]
    top = max(0, window.height - found.y - found.height)
    return screen()[top : window.height - found.y, found.x : found.x + found.width], found.x, top


def in_sidebar(text: str, turned: bool = False) -> list[tuple[int, int]]:
    """Where a text stands in the sidebar."""
    image, left, top = sidebar()
    return [(x + left, y + top) for x, y in places(text, image, turned)]


def busy_with(label: str) -> Callable[[], bool]:
    """Whether the job of this label is the current one."""
    from cloak.session import session

    return lambda: session.job is not None and session.job.label == label


class Mouse:
    """Clicks where words stand on the screen: what is clipped, covered or missing is an error.

    folder: of the pictures, NN-NAME.jpg, just before each click and with a ring around it; emptied first. most: clicks
    and keys that are allowed; scrolling does not count.
    """

    def __init__(self, folder: Path, most: int) -> None:
        self.folder, self.most = folder, most
        self.clicks: list[str] = []
        self.seconds: dict[str, dict[str, float]] = {}  # by the clock, and of processor, of each job waited for
        self._sidebar = np.zeros(0)  # as it was seen last
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob("*.jpg"):
            old.unlink()

    def until(self, condition: Callable[[], object], what: str, patience: float = PATIENCE) -> Iterator[float]:
        """Steps until a condition holds."""
        end = time.monotonic() + patience
        while not condition():
            if time.monotonic() > end:
                self.photograph("failed")
                raise AssertionError(what)
            yield 0.2

    def photograph(self, name: str, ring: tuple[int, int] | None = None) -> None:
        """The screen, with a ring around where the mouse clicks."""
        number = len(list(self.folder.glob("*.jpg"))) + 1
        command = ["convert", "x:root"]
        if ring is not None:
            x, y = ring
            command += ["-fill", "none", "-stroke", "#ffb000", "-strokewidth", "4"]
            command += ["-draw", f"circle {x},{y} {x + 26},{y}"]
        picture = str(self.folder / f"{number:02}-{name}.jpg")
        subprocess.run([*command, "-resize", str(WIDTH), "-quality", "82", picture], check=True)

    def scroll_to(self, text: str, turned: bool = False) -> list[tuple[int, int]]:
        """Where a text stands in the sidebar, once that stands still, as Blender scrolls smoothly; where there is none
        the sidebar is scrolled down a little."""
        moving, self._sidebar = self._sidebar, sidebar()[0]
        if not np.array_equal(moving, self._sidebar):
            return []
        found = in_sidebar(text, turned)
        if not found:
            xdo("mousemove", *middle_of("UI"), *["click", 5] * 6)
        return found

    def count(self, what: str) -> None:
        """One more click or key."""
        self.clicks.append(what)
        print(f"click {len(self.clicks)}: {what}", flush=True)
        assert len(self.clicks) <= self.most, f"more than {self.most} clicks"

    def press(self, key: str) -> None:
        """A key over the 3D viewport."""
        xdo("mousemove", *middle_of("WINDOW"), "key", key)
        self.count(key.upper())

    def point(self, text: str, find: Callable[[str], list[tuple[int, int]]]) -> Iterator[float]:
        """Move onto a text that `find` finds."""
        found: list[tuple[int, int]] = []

        def is_found() -> bool:
            found[:] = find(text)
            return bool(found)

        yield from self.until(is_found, f"'{text}' is not to be read")
        self.at = found[0]
        xdo("mousemove", *self.at)
        yield 0.5

    def click(self, text: str, name: str, effect: Callable[[], object], **how: bool) -> Iterator[float]:
        """Find a text in the sidebar, scrolling down to it if need be; click on it and see that it had its effect.

        turned: the text stands upright. anywhere: it is looked for in the whole window. times: 2 for a double click.
        """
        turned, times = how.get("turned", False), how.get("times", 1)
        anywhere = lambda words: places(words, screen())
        yield from self.point(text, anywhere if how.get("anywhere") else lambda words: self.scroll_to(words, turned))
        self.photograph(name, self.at)
        self.count(text)
        xdo("click", "--repeat", times, "--delay", 60, 1)
        yield 0.5  # Blender drags a panel whose header the mouse leaves at once
        yield from self.until(effect, f"'{text}' had no effect")

    def finished(self, label: str, half_way: Callable[[], None] = lambda: None) -> Iterator[float]:
        """Wait for the job that a click started."""
        from cloak.session import session

        start, before = time.monotonic(), os.times()
        while session.job.running and session.job.fraction < 0.5:
            yield 0.5
        half_way()
        yield from until_done()
        after = os.times()
        spent = after.children_user + after.children_system - before.children_user - before.children_system
        self.seconds[label] = {"clock": round(time.monotonic() - start, 1), "processor": round(spent, 1)}
        print(session.job.message, self.seconds[label], flush=True)
