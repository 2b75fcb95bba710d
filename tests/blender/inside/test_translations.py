"""German and French: every text that Blender would translate has both."""

import pytest
from cloak import translations
from msgids import msgids, sentences

LANGUAGES = ("de", "fr")


def test_every_text_is_translated():
    wanted = set(msgids())
    assert {"Paint with a Brush", "Start", "Backgrounds", "Make a logo of the selected faces"} <= wanted
    missing = sorted(wanted - set(translations.words()))
    assert not missing, "\n".join(missing)
    assert all(set(told) == set(LANGUAGES) for told in translations.words().values())
    assert all(told[x].strip() == told[x] and told[x] for told in translations.words().values() for x in LANGUAGES)


@pytest.mark.parametrize(
    ("sentence", "german"),
    [
        ("Shirt covers 83% of the logo", "Shirt verdeckt 83% des Logos"),
        ("Waits for Training", "Wartet auf Training"),
        ("Evaluating Body chest, after Training", "Body chest wird ausgewertet, nach Training"),
        (
            "'Body' is not a mesh (armature): click 'Shirt' instead",
            "'Body' ist kein Netz (armature): stattdessen 'Shirt' anklicken",
        ),
        ("Nobody ever wrote this", "Nobody ever wrote this"),
    ],
)
def test_sentences_are_known_by_their_pattern(sentence, german):
    assert translations.translate(sentence, "de") == german
    assert translations.said(sentence) == sentence, "the tests run in English"


def test_every_reason_has_its_pattern():
    missing = [text for text in sentences() if text not in translations.words()]
    assert not missing, "\n".join(missing)
