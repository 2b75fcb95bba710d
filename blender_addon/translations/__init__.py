# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on in German and French: labels and tooltips through Blender's own mechanism, sentences by their pattern.

Everything is said in English where it happens, so logs, tests and programs without a window read one language. What is
shown passes `said`, which knows a sentence again by the pattern in `words.toml` that it was made from.
"""

import functools
import re
import tomllib
from pathlib import Path

import bpy

LANGUAGES = {"de_DE": "de", "fr_FR": "fr"}
CONTEXTS = ("*", "Operator")  # Blender has a separate context for the text on operator buttons


@functools.cache
def words() -> dict[str, dict[str, str]]:
    """Every text, and how it is said in "de" and "fr"."""
    return tomllib.loads(Path(__file__).with_name("words.toml").read_text("utf-8"))


def said(sentence: str) -> str:
    """Translate a sentence into the language of Blender's interface, if a translation exists."""
    language = bpy.app.translations.locale[:2]
    view = bpy.context.preferences.view
    if language not in LANGUAGES.values() or not view.use_translate_interface:
        return sentence
    return translate(sentence, language)


@functools.lru_cache(2048)
def translate(sentence: str, language: str) -> str:
    """Translate a sentence into "de" or "fr", with its names and numbers in that language's order."""
    if sentence in words():
        return words()[sentence][language]
    for pattern, text in _patterns():
        if match := pattern.fullmatch(sentence):
            quoted = [before.endswith("'") for before in text.split("{}")]  # names of the user's stay as they are
            parts = [p if q else translate(p, language) for p, q in zip(match.groups(), quoted, strict=False)]
            return words()[text][language].format(*parts)
    return sentence


@functools.cache
def _patterns() -> list[tuple[re.Pattern, str]]:
    """Texts with gaps, as patterns: first the ones that begin with a word, and of these the longest."""
    gaps = [text for text in words() if "{}" in text]
    gaps.sort(key=lambda text: (text != "{}, after {}", text.startswith("{}"), -len(text.replace("{}", ""))))
    return [(re.compile("(.+?)".join(map(re.escape, text.split("{}"))), re.DOTALL), text) for text in gaps]


def register() -> None:
    """Tell Blender what is shown for each context and text, by the languages' names; Blender 5 has short names."""
    told = {}
    for language, short in LANGUAGES.items():
        shown = {(context, text): of[short] for text, of in words().items() for context in CONTEXTS}
        told |= {language: shown, short: shown}
    bpy.app.translations.register(__package__, told)


def unregister() -> None:
    bpy.app.translations.unregister(__package__)
