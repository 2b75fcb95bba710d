# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on in other languages, through Blender's own mechanism: labels, tooltips, menus.

What the add-on says in sentences with names and numbers in them (messages, reasons) stays English.
"""

from __future__ import annotations

import bpy

from .french import WORDS as FRENCH
from .german import WORDS as GERMAN

LANGUAGES = {"de_DE": GERMAN, "fr_FR": FRENCH}
CONTEXTS = ("*", "Operator")
"""Blender looks up what stands on an operator's button apart from everything else."""


def dictionaries() -> dict[str, dict[tuple[str, str], str]]:
    """What Blender is told: for each language's name, (context, text) and what is shown; Blender 5 has short names."""
    return {
        name: {(context, text): said for text, said in words.items() for context in CONTEXTS}
        for language, words in LANGUAGES.items()
        for name in (language, language[:2])
    }


def register() -> None:
    bpy.app.translations.register(__package__, dictionaries())


def unregister() -> None:
    bpy.app.translations.unregister(__package__)
