"""Whether pictures that are to show nobody do."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import torch

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import Backgrounds

MOST_WITH_PEOPLE = 0.1
"""Share of the pictures above which they are taken for a folder of people; below it may be the detector's errors."""
NAMED = 5
_log = logging.getLogger("cloak")


def check_places(backgrounds: Backgrounds, detector: Detector, size: int, source: str) -> None:
    """Ask the detector whether somebody is in any background, before anything is trained.

    size: side of the images, pixels; source: where they come from. A warning names those in which it reports a person.
    InputError: it does in more than a tenth of them.
    """
    found = people_among(backgrounds, detector, size)
    if not found:
        return
    shown = ", ".join(found[:NAMED]) + (", ..." if len(found) > NAMED else "")
    words = f"{source}: somebody is in {len(found)} of {len(backgrounds)} backgrounds ({shown})"
    if len(found) > MOST_WITH_PEOPLE * len(backgrounds):
        raise InputError(f"{words}; backgrounds show nobody, photographs of people go to --photos or --people")
    _log.warning("%s, says the detector; take out those that show people", words)


@torch.no_grad()
def people_among(backgrounds: Backgrounds, detector: Detector, size: int) -> Sequence[str]:
    """Name the backgrounds in which the detector, as it is used, reports a person."""
    found = []
    for number, name in enumerate(backgrounds.names):
        image = backgrounds.image(number, (size, size))[None].to(detector.device).float() / 255
        if float(max_person_score(detector(image))[0]) > detector.operating_point:
            found.append(name)
    return found
