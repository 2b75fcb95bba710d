"""The cloaks that a detector is hardened against, one for each turn, attacked on the images that the turn learns from.

Cloaks that lived for a hundred turns, and were attacked on other images, hid nobody after fifty: the detector knew each
of them by then, and any new one of the same length passed. Everything drawn is a function of (seed, turn), so that a
hardening that was stopped goes on as if it had not been.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int64
from torch import Tensor

from cloak_core.core.batches import Batch, Batcher
from cloak_core.core.cameras import Camera
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.geometry import face_areas, face_centres, face_normals
from cloak_core.core.images import dressed
from cloak_core.core.logo import Logo, make_logo, region_mask
from cloak_core.core.objective import Objective, StepFigures, gradient_step
from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.pattern import Pattern
from cloak_core.core.prints import PRINTS
from cloak_core.core.sampling import Sampler
from cloak_core.core.settings import TrainSettings, make_settings
from cloak_core.core.source import NOBODY, Cast
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.patterns.choosing import pattern_of
from cloak_core.patterns.cloth import ClothPattern
from cloak_core.patterns.controls import OwnClothing
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.bodies.people.samples import HEADWEAR
from cloak_core.sources.bodies.source import BodyPlan, BodySource
from cloak_core.studies.hardening.decoys import TEXTURE, FlatCloth, Texture, random_texture
from cloak_core.studies.hardening.settings import HardenSettings

DISTANCES, ELEVATIONS = (2.2, 1.6, 2.2, 3.2), (6.0, 6.0, 20.0, 0.0)
"""Metres and degrees, for one cloak after the other."""
AZIMUTHS, AROUND, SECTOR = 10, 6, 15
"""Azimuths of a cloak; how many of them go all around for every other cloak, and how far the rest stray, degrees: a
cloak that works from one side alone is the stronger attack there, and to withstand others does not answer it."""
VIEW_BYTES = 1 << 30
"""Of views that are kept: building one anew takes a hundredth of an update's time."""
SAMPLES = 4
"""Per pixel: what sampling misses in one view it finds in the next."""
SLOTS = 6
"""Turn k uses slot k % SLOTS. A slot has its own distance and angles, and keeps the last colours of every face."""
GOES_ON = 0.75
"""How many cloaks begin with the colours that earlier ones of their slot ended with on the same faces, so that some are
stronger than the steps of one turn make them."""
WHOLE_BODY = 2
"""One cloak in this many covers the whole body, the largest logo that an attacker has. Without this rule the largest of
200 drawn logos covered four fifths of a body, and the hardened detector fell to a cloak over all of it."""
KEPT = 32
"""Number of the last cloaks that decoys show."""
_LOGO, _VIEWS, _CLOTH = 1, 2, 6
"""Streams of random numbers; `pictures` and `hardening` have others."""


@dataclass(eq=False)
class Cloak:
    """One cloak, and what shows it."""

    pattern: Pattern
    batcher: Batcher
    objective: Objective
    optimizer: ColorOptimizer
    flat: FlatCloth

    @property
    def logo(self) -> Logo:
        """Where it is worn."""
        return self.pattern.cover

    def face_colors(self) -> Float[np.ndarray, "L 3"]:
        """Colours of the logo's faces as they are."""
        colors = self.optimizer.colors().detach().cpu().numpy()
        return self.pattern.on_faces(colors).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Turn:
    """The same images with a cloak and without."""

    cloaked: Float[Tensor, "B 3 H W"]
    clean: Float[Tensor, "B 3 H W"]
    attack: StepFigures | None
    """Of the last step of the cloak's attack; None without steps."""
    cloak: Cloak
    """As the attack left it."""
    batch: Batch
    """Shows it, in any colours."""


class Pool:
    """Makes a turn's cloak, on its logo, seen from the distance and angles of its slot."""

    def __init__(
        self,
        settings: HardenSettings,
        bodies: Bodies,
        backgrounds: Backgrounds,
        detector: Detector,
        people: Cast = NOBODY,
    ) -> None:
        self.settings, self.bodies, self.backgrounds, self.detector = settings, bodies, backgrounds, detector
        self.people = people
        people.require_topology(bodies.topology)
        self.device = torch.device(detector.device)
        room = VIEW_BYTES // 2 if settings.cloths else VIEW_BYTES
        rendering = RenderSettings(device=self.device, samples=SAMPLES, memory_bytes=room)
        self.source = BodySource(bodies, rendering, Camera(width=settings.size, height=settings.size))
        self.centres, self.normals = face_centres(bodies), face_normals(bodies)
        self.skins: dict[int, Float[Tensor, "F 3"]] = {}
        """By slot, the last colours that any of its cloaks had on each face."""
        self.recent: list[Texture] = []
        """Of the last turns' cloaks, the oldest first."""

    def turn(self, turn: int) -> Turn:
        """Make images of a new cloak, and move its colours against the detector as it stands, on these images.

        Clean ones show the body in its clothes, without changes of colour, and a photograph as it is.
        """
        slot, generation = turn % SLOTS, turn // SLOTS
        cloak = self.cloak(slot, generation)
        batch, figures = cloak.batcher.batch(generation), None
        for _ in range(self.settings.attack_steps):
            figures = gradient_step(cloak.objective, cloak.optimizer, batch).figures
            cloak.optimizer.update(self.settings.attack_lr)
        with torch.no_grad():
            # What is composed next draws into the same memory.
            cloaked = batch.images(cloak.optimizer.colors()).clone()
            clean = self._clean(cloak, generation, turn)
            colors, faces = cloak.face_colors(), torch.from_numpy(cloak.logo.face_ids).to(self.device)
            skin = self.skins.setdefault(slot, torch.full((self.bodies.face_count, 3), 0.5, device=self.device))
            skin[faces] = torch.from_numpy(colors).to(self.device)
            self.recent = [*self.recent, cloak.flat.texture(colors)][-KEPT:]
        return Turn(cloaked, clean, figures, cloak, batch)

    def _clean(self, cloak: Cloak, generation: int, turn: int) -> Float[Tensor, "B 3 H W"]:
        """Show a turn's images without the cloak: bodies in an outfit on its faces, photographs as they are."""
        outfit = self.bodies.face_colors[turn % self.bodies.outfit_count]
        clothing = torch.from_numpy(outfit[cloak.logo.face_ids]).to(self.device)
        own, batcher = OwnClothing(cloak.logo), cloak.batcher
        draws = batcher.sampler.draw(generation)
        views = batcher.images.make_views(draws.views(), own)
        images = []
        for view, background, shift in zip(views, draws.background, torch.from_numpy(draws.shift), strict=True):
            rows = batcher.images.backdrop([view], [int(background)])
            moved = shift[None].to(self.device) * view.subject.is_alone
            images.append(dressed([view], own, rows, moved).paint(clothing[: len(view.own)])[0])
        return torch.stack(images)

    def state(self) -> dict[str, Tensor]:
        """For a checkpoint."""
        kept = {f"skin.{slot}": skin for slot, skin in self.skins.items()}
        return kept | {f"recent.{k:03d}": torch.from_numpy(texture) for k, texture in enumerate(self.recent)}

    def load(self, tensors: dict[str, Tensor]) -> None:
        """Go on from `state()`."""

        def of(kind: str) -> dict[str, Tensor]:
            mark = f"{kind}."
            return {name.removeprefix(mark): tensors[name] for name in sorted(tensors) if name.startswith(mark)}

        self.skins = {int(slot): skin.to(self.device) for slot, skin in of("skin").items()}
        self.recent = [texture.cpu().numpy() for texture in of("recent").values()]

    def cloak(self, slot: int, generation: int) -> Cloak:
        """Make a slot's next cloak."""
        rng = np.random.default_rng([self.settings.seed, _LOGO, slot, generation])
        cloth = np.random.default_rng([self.settings.seed, _CLOTH, slot, generation])
        pattern: dict[str, str | float] = {}
        whole = (slot + generation) % WHOLE_BODY == WHOLE_BODY - 1  # one slot after the other
        logo = make_logo(self.bodies, np.arange(self.bodies.face_count) if whole else draw_logo(self.bodies, rng))
        colors = draw_colors(self.centres[logo.face_ids].astype(np.float32), rng)
        if slot in self.skins and rng.random() < GOES_ON:
            colors = self.skins[slot].cpu().numpy()[logo.face_ids]
        if cloth.random() < self.settings.cloths:
            pattern = {"pattern": "tile", "tile_cm": float(cloth.uniform(*WIDTHS)), "feature_cm": SQUARE}
        settings = self._train_settings(slot, **pattern)
        worn = pattern_of(settings.pattern, self.bodies, logo)
        colors = first_cloth(worn, cloth) if pattern else colors
        return Cloak(
            worn,
            self._batcher(settings, worn),
            Objective(settings, worn, [self.detector], self.device),
            ColorOptimizer(settings.optimization, torch.from_numpy(np.array(colors, np.float32)).to(self.device)),
            FlatCloth(self.centres[logo.face_ids], self.normals[logo.face_ids]),
        )

    def _batcher(self, settings: TrainSettings, pattern: Pattern) -> Batcher:
        """Make what builds images of bodies, and of people where there are some, in what is worn."""
        plan = BodyPlan(settings.views, self.bodies.pose_count, self.bodies.outfit_count)
        bodies = self.source.planned(plan, settings.views.camera(0.0, 0.0, 1.0))
        source = self.people.beside(bodies, settings, self.device)
        sampler = Sampler(settings, source, len(self.backgrounds))
        return Batcher(settings, sampler, self.backgrounds, pattern, self.device)

    def _train_settings(self, slot: int, **pattern: str | float) -> TrainSettings:
        rng = np.random.default_rng([self.settings.seed, _VIEWS, slot])
        whole, turn = AROUND if slot % 2 else 0, rng.integers(360)
        middle = turn if slot % 4 == 2 else 0  # every second of the one-sided ones is seen from the front
        near = middle + rng.integers(-SECTOR, SECTOR + 1, AZIMUTHS - whole)
        around = turn + np.arange(whole) * 360 // AROUND
        angles = sorted({float(angle) for angle in (*near % 360, *around % 360)})
        return make_settings(
            "best",
            steps=10_000_000,
            batch=self.settings.batch,
            seed=self.settings.seed + slot,
            hide=self.settings.hide,
            size=self.settings.size,
            translation=self.settings.size // 8,
            people_share=self.settings.people_share,
            angles=",".join(f"{angle:g}" for angle in angles),
            distance=f"{DISTANCES[slot % len(DISTANCES)]}",
            elevation=f"{ELEVATIONS[slot % len(ELEVATIONS)]}",
            **pattern,
        )


# --- logos and first colours: as many kinds as one can think of, and none of those that results are judged on
#
# A draw that comes near a judged one (chest + thighs, shirt + trousers) is drawn again, so that what is learned must
# hold on logos that were never seen.

JUDGED = (("chest", "thighs"), ("shirt", "trousers"))
"""Regions of the logos that are kept for judging."""
TOO_ALIKE = 0.7
"""Area in common over area in either, from which a draw counts as one of them."""
LEAST, MOST = 0.05, 1.0
"""Shares of the body's area."""
CANDIDATES = 6
"""Logos of which the one nearest a share drawn evenly is taken; the shapes alone are small three times out of four,
and a detector that saw few large cloaks falls to them."""


def draw_logo(bodies: Bodies, rng: np.random.Generator) -> Int64[np.ndarray, " L"]:
    """Draw the faces of a logo: a few balls about points of the body, a slab of it, or named regions.

    Whole, or one side of it. Large ones are as likely as small ones.
    """
    areas = face_areas(bodies)
    areas = areas / areas.sum()
    wanted = rng.uniform(LEAST, MOST)
    drawn = [_fitting(bodies, areas, rng) for _ in range(CANDIDATES)]
    return np.flatnonzero(min(drawn, key=lambda chosen: abs(areas[chosen].sum() - wanted)))


def _fitting(bodies: Bodies, areas: np.ndarray, rng: np.random.Generator) -> Bool[np.ndarray, " F"]:
    """Draw a random shape, neither too small nor too large nor near one that is judged."""
    judged = [
        np.any([region_mask(bodies, name) for name in names], axis=0)
        for names in JUDGED
        if all(name in bodies.regions for name in names)
    ]
    for _ in range(1000):
        chosen = _shape(bodies, rng)
        if rng.random() < 0.35:
            angle = rng.uniform(0, 2 * np.pi) if rng.random() < 0.5 else np.pi / 2
            chosen &= face_normals(bodies)[:, [0, 2]] @ np.array([np.cos(angle), np.sin(angle)]) > 0
        share = areas[chosen].sum()
        alike = any(areas[chosen & mask].sum() > TOO_ALIKE * areas[chosen | mask].sum() for mask in judged)
        if LEAST <= share <= MOST and not alike:
            return chosen
    raise RuntimeError(f"no random logo fits scene '{bodies.name}'")


def _shape(bodies: Bodies, rng: np.random.Generator) -> Bool[np.ndarray, " F"]:
    centres, kind = face_centres(bodies), rng.random()
    if kind < 0.4 or not bodies.regions:
        chosen = np.zeros(len(centres), bool)
        for _ in range(rng.integers(1, 6)):
            about = centres[rng.integers(len(centres))]
            chosen |= ((centres - about) ** 2).sum(1) < rng.uniform(0.1, 0.4) ** 2
        return chosen
    if kind < 0.75:
        low, high = np.sort(rng.uniform(centres[:, 1].min(), centres[:, 1].max(), 2))
        return (centres[:, 1] >= low) & (centres[:, 1] <= high)
    chosen = np.zeros(len(centres), bool)
    # Headwear lies on the head, which is a region already; what dressing it by itself teaches has not been measured.
    names = rng.permutation([name for name in bodies.regions if name not in HEADWEAR])[: rng.integers(1, 4)]
    for name in names:
        chosen |= bodies.regions[str(name)]
    return chosen


def draw_colors(centres: Float32[np.ndarray, "L 3"], rng: np.random.Generator) -> Float32[np.ndarray, "L 3"]:
    """Draw the first colours of a logo: grey, one colour, noise of each face, or blocks of a few centimetres."""
    kind = rng.random()
    if kind < 0.3:
        return np.full(centres.shape, 0.5, np.float32)
    if kind < 0.5:
        return np.tile(rng.random(3), (len(centres), 1)).astype(np.float32)
    if kind < 0.75:
        return rng.random(centres.shape).astype(np.float32)
    cells = np.floor(centres / rng.uniform(0.03, 0.15)).astype(np.int64)
    code = (cells * np.array([73856093, 19349663, 83492791])).sum(1) % 997
    return rng.random((997, 3)).astype(np.float32)[code]


# --- cloths that repeat

WIDTHS = (20.0, 55.0)
"""Centimetres of the piece that repeats; published textures are worn at 25 to 50."""
SQUARE = 1.0
"""Centimetres of what has one colour."""
PRINTED = 0.3
"""Share of the cloths that begin as a plain print; the others begin as a pattern that nobody trained."""


def first_cloth(cloth: ClothPattern, rng: np.random.Generator) -> Float32[np.ndarray, "S 3"]:
    """Draw the first colours of a cloth's squares, which lie row by row."""
    if rng.random() < PRINTED:
        return PRINTS[str(rng.choice(sorted(PRINTS)))].at(cloth.centres)
    texture = random_texture(rng)
    row, column = ((np.arange(count) + 0.5) * TEXTURE / count for count in (cloth.grid.rows, cloth.grid.columns))
    squares = texture[:, row.astype(int)][:, :, column.astype(int)]
    return np.ascontiguousarray(squares.reshape(3, -1).T, np.float32)
