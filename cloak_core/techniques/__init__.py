"""The optional techniques of training, a file each. Their settings stand in `core.settings.components`."""

from cloak_core.core.technique import Setup, Technique, Techniques
from cloak_core.techniques.inks import Inks
from cloak_core.techniques.interpolate import Interpolate
from cloak_core.techniques.near import Near
from cloak_core.techniques.octaves import Octaves
from cloak_core.techniques.printability import Printability
from cloak_core.techniques.profile import Photographed
from cloak_core.techniques.shake import Shake
from cloak_core.techniques.smooth import Smoothing

ALL: tuple[type[Technique], ...] = (
    Interpolate,  # first: inks are chosen for what is written
    Inks,
    Near,
    Octaves,
    Printability,
    Photographed,
    Shake,
    Smoothing,
)
"""In the order of their hooks."""


def build_techniques(setup: Setup) -> Techniques:
    """Build the techniques that the settings have on. InputError: one does not go with something."""
    built = (technique.build(setup) for technique in ALL)
    return Techniques(technique for technique in built if technique is not None)
