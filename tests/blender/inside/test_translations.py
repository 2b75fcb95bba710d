"""German and French: every text that Blender would translate has both."""

import string

import pytest
from cloak import translations
from msgids import msgids


@pytest.mark.parametrize("words", translations.LANGUAGES.values(), ids=translations.LANGUAGES)
def test_every_text_is_translated_and_nothing_else(words):
    wanted = set(msgids())
    assert len(wanted) > 300
    assert not wanted - set(words), "not translated"
    assert not set(words) - wanted, "no longer in the add-on"
    assert all(said.strip() == said and said for said in words.values())


@pytest.mark.parametrize("words", translations.LANGUAGES.values(), ids=translations.LANGUAGES)
def test_tooltips_end_as_blender_wants_and_are_no_copies(words):
    assert not [said for said in words.values() if said.endswith(".") and not said.endswith("...")]
    same = [text for text, said in words.items() if text == said and len(text) > 12]
    assert not same, same
    letters = {c for said in words.values() for c in said} - set(string.printable)
    assert letters & set("äöüß") or letters & set("éèàç")


def test_blender_is_told_under_every_name_it_gives_the_languages():
    """What it shows is looked at in a window, by real/show_first_look.py: the bpy package knows no language."""
    words = translations.dictionaries()
    assert set(words) == {"de_DE", "de", "fr_FR", "fr"} and words["de"] == words["de_DE"]
    for context in ("Operator", "*"):
        assert words["de"][context, "Paint with a Brush"] == "Mit Pinsel malen"
        assert words["fr"][context, "Paint with a Brush"] == "Peindre à la brosse"
