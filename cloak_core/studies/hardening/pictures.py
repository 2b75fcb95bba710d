"""Pictures of which a detector that is hardened is to say what it said: places, photographs, and cloth on nobody."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.cameras import Camera
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.detector.scoring import max_person_score, person_boxes
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.studies.hardening.decoys import Texture, draw_decoy, random_texture
from cloak_core.studies.hardening.pool import DISTANCES, Pool

FINER, LEAST_PART = 2, 0.4
"""Pictures are taken from photographs decoded this many times finer, of at least this share of their side: a detector
that learns whole photographs by heart reports more in the parts of others."""
UNTRAINED = 0.4
"""Probability that a decoy shows a pattern that nobody trained instead of one of the last cloaks. Otherwise the
detector could tell people by the colours of cloaks alone."""
MAYBE_PERSON = 0.3
"""A picture's boxes that the unhardened detector scores higher are kept clear of decoys."""
_PICTURES, _DECOYS = 3, 4
"""Streams of random numbers; the pool has others."""
MOST_WITH_PEOPLE = 0.1
"""Share of the backgrounds above which they are taken for a folder of people; below it may be the detector's errors."""
NAMED = 5
_log = logging.getLogger("cloak")


@dataclass(frozen=True, eq=False)
class Decoys:
    """The same pictures with patterned cloth that nobody wears, and without."""

    shown: Float[Tensor, "B 3 H W"]
    without: Float[Tensor, "B 3 H W"]


class Pictures:
    """Square parts of the pool's backgrounds and of photographs, where there are some, with decoys and without.

    teacher: the unhardened detector, which says where people may be. What is drawn is a function of (seed, turn).
    """

    def __init__(self, pool: Pool, photographs: Backgrounds | None, teacher: Detector) -> None:
        self.pool, self.photographs, self.teacher = pool, photographs, teacher
        self.settings, self.size = pool.settings, pool.settings.size

    def plain(self, turn: int) -> Float[Tensor, "P 3 H W"]:
        """Draw backgrounds and photographs, half of each where there are some, mirrored at random."""
        rng = np.random.default_rng([self.settings.seed, _PICTURES, turn])
        images = torch.zeros(self.settings.pictures, 3, self.size, self.size)
        for k, image in enumerate(images):
            part = self._part(rng, photograph=bool(k % 2))
            image.copy_(part.flip(2) if rng.random() < 0.5 else part)
        return images.to(self.pool.device)

    @torch.no_grad()
    def decoys(self, turn: int) -> Decoys:
        """Draw pictures with cloth that nobody wears: the last cloaks, and random patterns."""
        rng = np.random.default_rng([self.settings.seed, _DECOYS, turn])
        without, shown = (torch.zeros(self.settings.decoys, 3, self.size, self.size) for _ in range(2))
        for k in range(len(shown)):
            without[k] = self._part(rng, photograph=bool(k % 2))
            clear = []
            if k % 2 and self.photographs is not None:
                boxes = person_boxes(self.teacher(without[k][None].to(self.pool.device)), MAYBE_PERSON)[0]
                clear = boxes[:, :4].tolist()
            shown[k] = draw_decoy(without[k], self.textures(rng), rng, self._silhouette(rng), clear)
        return Decoys(shown.to(self.pool.device), without.to(self.pool.device))

    def textures(self, rng: np.random.Generator) -> Iterator[Texture]:
        """Draw what decoys show: the last cloaks, and patterns that nobody trained."""
        recent = self.pool.recent
        while True:
            if rng.random() < UNTRAINED or not recent:
                yield random_texture(rng, lambda: self._part(rng, photograph=False))
            else:
                yield recent[rng.integers(len(recent))]

    def _part(self, rng: np.random.Generator, photograph: bool) -> Float[Tensor, "3 H W"]:
        """Draw a part of a photograph, where there are some, or of a background."""
        source = self.photographs if photograph and self.photographs is not None else self.pool.backgrounds
        side = FINER * self.size
        whole = source.image(int(rng.integers(len(source))), (side, side)).float() / 255
        shown = int(self.size * rng.uniform(LEAST_PART, 1) * FINER)
        y, x = (int(rng.integers(side - shown + 1)) for _ in range(2))
        part = whole[None, :, y : y + shown, x : x + shown]
        return F.interpolate(part, (self.size, self.size), mode="bilinear", antialias=True)[0].clamp(0, 1)

    def _silhouette(self, rng: np.random.Generator) -> Float[Tensor, "H W"]:
        """Draw a body's coverage of the picture, from anywhere."""
        size, distance = self.size, DISTANCES[rng.integers(len(DISTANCES))]
        camera = Camera(azimuth=float(30 * rng.integers(12)), distance=distance, width=size, height=size)
        view = self.pool.source.views_for(False).view(int(rng.integers(self.pool.bodies.pose_count)), camera)
        covered = torch.zeros(size * size, device=view.coverage.device)
        covered[view.pixels] = view.coverage
        return covered.view(size, size).roll(int(rng.integers(-size // 3, size // 3)), 1).cpu()


@torch.no_grad()
def check_places(backgrounds: Backgrounds, detector: Detector, size: int, source: str) -> None:
    """Ask the detector, as it is used, whether somebody is in any background, before anything is trained.

    size: side of the images, pixels; source: where they come from. A warning names those in which it reports a person.
    InputError: it does in more than a tenth of them.
    """
    problems = []
    for number, name in enumerate(backgrounds.names):
        image = backgrounds.image(number, (size, size))[None].to(detector.device).float() / 255
        if float(max_person_score(detector(image))[0]) > detector.operating_point:
            problems.append(name)
    if not problems:
        return
    shown = ", ".join(problems[:NAMED]) + (", ..." if len(problems) > NAMED else "")
    words = f"{source}: somebody is in {len(problems)} of {len(backgrounds)} backgrounds ({shown})"
    if len(problems) > MOST_WITH_PEOPLE * len(backgrounds):
        raise InputError(f"{words}; backgrounds show nobody, photographs of people go to --photos or --people")
    _log.warning("%s, the detector says; remove the pictures that show people", words)
