"""German and French: every text that Blender would translate has both."""

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


def test_every_reason_has_its_pattern():
    missing = [text for text in sentences() if text not in translations.words()]
    assert not missing, "\n".join(missing)
