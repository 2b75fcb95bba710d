"""What an optional technique of training is: its settings, and the hooks by which it acts. No technique is named here.

Each file of `cloak_core/techniques` is one and is found there: a dataclass of settings, which joins a group of
`cloak train`'s options, and a subclass of `Technique` with the hooks where it acts. A step calls them in this order:
`hidden` and `distortion` (while its batch is built); `free`, `mix`, `tone`, `choose`, `keep` (from free parameters to
colours); `around` (while a detector runs), `penalty`; `level`, `observe`; `move` (the update).

Whatever a technique draws at random is a function of (seed, step); an image's own seed is one. Off, it is not built.
This imports no torch: settings are read before it is needed.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import pkgutil
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from cloak_core.files.errors import InputError
from cloak_core.files.lazy import Lazy

if TYPE_CHECKING:
    from cloak_core.core.pattern import Pattern
    from cloak_core.core.settings import TrainSettings

torch = Lazy("torch")
ROOM = "cloak_core.techniques"
GROUPS = ("augmentation", "objective", "pattern", "surrogates", "optimization")
"""Components of `TrainSettings` that settings of techniques can join."""


@dataclasses.dataclass(frozen=True, eq=False)
class Setup:
    """What a technique may know when it is built."""

    settings: TrainSettings
    pattern: Pattern
    """What has colours."""
    detectors: Sequence
    device: torch.device


class Distortion:
    """What happens to B finished images; here nothing."""

    def __call__(self, images: Float[torch.Tensor, "B 3 H W"]) -> Float[torch.Tensor, "B 3 H W"]:
        return images

    def moved(self, boxes: Float[torch.Tensor, "B 4"]) -> Float[torch.Tensor, "B 4"]:
        """Move boxes with the images; units in which the image's edges are at -1 and 1."""
        return boxes


class Technique:
    """Does nothing; each technique overrides the hooks where it acts."""

    group: ClassVar[str]
    """The component of `TrainSettings` that its settings join."""
    settings: ClassVar[type | None] = None
    """Dataclass of its settings: frozen, keywords only."""
    choice: ClassVar[tuple[str, str] | None] = None
    """A word that it adds to a setting of the core: the setting's name, the word."""
    files: ClassVar[tuple[tuple[str, str], ...]] = ()
    """Pairs: a setting that names a file, which may be moved, and the name under which config.json has its content."""
    order: ClassVar[int] = 0
    """Among techniques with the same hook; equal ones go by the name of their file."""
    is_exact: ClassVar[bool] = False
    """Colours are restricted, so that a mean of two may not be allowed."""
    bars_search: ClassVar[bool] = False
    """Cannot be combined with --black-box-queries."""

    @classmethod
    def build(cls, setup: Setup) -> Technique | None:
        """Build it; None where the settings have it off. InputError: it does not go with something."""
        raise NotImplementedError

    # --- on the sample and the image

    def hidden(self, seeds: Int[np.ndarray, " B"]) -> Bool[np.ndarray, "B C"]:
        """Choose the colours that are painted grey in each image."""

    def distortion(self, seeds: Int[np.ndarray, " B"], device: torch.device) -> Distortion:
        """Draw what happens to the finished images."""

    # --- on the detector, the loss, the ensemble

    def around(self, number: int, step: int) -> contextlib.AbstractContextManager:
        """Make the context in which detector `number` runs in `step` of a training."""

    def penalty(self, colors: Float[torch.Tensor, "C 3"]) -> tuple[float, Float[torch.Tensor, ""]]:
        """Compute what is added to the loss: its weight, and the figure that events have under `name`."""

    @property
    def name(self) -> str:
        """Say under what name events have its penalty: that of its file."""
        return type(self).__module__.rpartition(".")[2]

    def weights(self) -> Float[np.ndarray, " detectors"]:
        """Weigh the detectors; the weights sum to 1."""

    def level(self, scores: Float[torch.Tensor, " B"], operating_point: float) -> Float[torch.Tensor, " B"]:
        """Measure, for `observe`, how surely a detector found each person."""

    def observe(self, levels: dict[int, float]) -> None:
        """Hear the mean level of each detector that was asked, by its number; in every process for the whole batch."""

    # --- on the colours

    def first(self) -> Float[np.ndarray, "L 3"]:
        """Give the colours of faces that training begins with."""

    # N values that are free parameters become C colours

    rows: int = 0
    """Free parameters of its own, beside the N values."""

    def free(
        self, values: Float[torch.Tensor, "N 3"], own: Float[torch.Tensor, "rows 3"]
    ) -> Float[torch.Tensor, "N 3"]:
        """Change the values before they are brought into [0, 1]; its rows begin as zeros."""

    def mix(self, values: Float[torch.Tensor, "N 3"]) -> Float[torch.Tensor, "N 3"]:
        """Change values in [0, 1] by those of their neighbours."""

    def tone(self, values: Float[torch.Tensor, "N 3"]) -> Float[torch.Tensor, "N 3"]:
        """Change each value by itself."""

    def untone(self, colors: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Find values that `tone` makes these colours, or nearly."""

    def choose(
        self, values: Float[torch.Tensor, "N 3"], own: Float[torch.Tensor, "rows 3"], tone: Callable, is_final: bool
    ) -> Float[torch.Tensor, "N 3"]:
        """Change the values by its own rows, which are in [0, 1]; is_final: as if the run ended here.

        tone: what other techniques do to each value.
        """

    def first_rows(self, untone: Callable) -> Float[np.ndarray, "rows 3"]:
        """Give what the rows for `choose` begin with."""

    def reach(self, step: int, steps: int, values: Callable) -> Float[np.ndarray, "rows 3"] | None:
        """Hear that `step` of `steps` begins; give new rows for `choose`. `values()`: the mixed values, [N, 3]."""

    def keep(self, colors: Float[torch.Tensor, "C 3"]) -> Float[torch.Tensor, "C 3"]:
        """Project colours onto those that are allowed."""

    # --- on the update

    memory: ClassVar[frozenset[str]] = frozenset()
    """Names of the tensors that `move` keeps."""

    def move(self, parameter: torch.Tensor, gradient: torch.Tensor, state: dict[str, torch.Tensor], lr: float) -> None:
        """Move the parameter against the gradient, in place."""

    # --- on what is written

    def content(self) -> dict[str, object]:
        """Record the content of its `files`, by the name in config.json."""
        return {}

    def report(self, colors: Float[np.ndarray, "C 3"]) -> dict[str, float]:
        """Measure the colours that a run ends with, for its result."""
        return {}

    def state(self) -> dict[str, torch.Tensor]:
        """Give the state for a checkpoint."""
        return {}

    def load(self, tensors: dict[str, torch.Tensor]) -> None:
        """Continue from `state()`. KeyError or ValueError where the tensors belong to another run."""


class Techniques(tuple[Technique, ...]):
    """Those of a run that are on, in the order of their hooks."""

    @staticmethod
    def built(setup: Setup) -> Techniques:
        """Build those that the settings have on. InputError: one does not go with something."""
        built = (technique.build(setup) for technique in discovered())
        return Techniques(technique for technique in built if technique is not None)

    def at(self, hook: str) -> list[Technique]:
        """List those that act at a hook."""
        return [technique for technique in self if getattr(type(technique), hook) is not getattr(Technique, hook)]

    def hidden(self, seeds: Int[np.ndarray, " B"]) -> Bool[np.ndarray, "B C"] | None:
        """Choose the colours that are grey in each image; None: none in any."""
        masks = [technique.hidden(seeds) for technique in self.at("hidden")]
        return np.logical_or.reduce(masks) if masks else None

    def distortions(self, seeds: Int[np.ndarray, " B"], device: torch.device) -> Distortions:
        return Distortions(technique.distortion(seeds, device) for technique in self.at("distortion"))

    @contextlib.contextmanager
    def around(self, number: int, step: int | None) -> Iterable[None]:
        """Surround a detector's run in `step`; None, outside training, changes nothing."""
        with contextlib.ExitStack() as stack:
            for technique in [] if step is None else self.at("around"):
                stack.enter_context(technique.around(number, step))
            yield

    def content(self) -> dict[str, object]:
        """Record every technique's files; None of those that are off."""
        contents = dict.fromkeys(name for technique in discovered() for _, name in technique.files)
        for technique in self:
            contents |= technique.content()
        return contents

    def report(self, colors: Float[np.ndarray, "C 3"]) -> dict[str, float]:
        return {name: value for technique in self for name, value in technique.report(colors).items()}

    def state(self) -> dict[str, torch.Tensor]:
        return {name: tensor for technique in self for name, tensor in technique.state().items()}

    def load(self, tensors: dict[str, torch.Tensor]) -> None:
        for technique in self:
            technique.load(tensors)


NO_TECHNIQUES = Techniques()


class Distortions(tuple[Distortion, ...]):
    """What happens to B finished images, one after the other."""

    def __call__(self, images: Float[torch.Tensor, "B 3 H W"]) -> Float[torch.Tensor, "B 3 H W"]:
        for distortion in self:
            images = distortion(images)
        return images

    def boxes(self, boxes: Float[torch.Tensor, "B 4"], height: int, width: int) -> Float[torch.Tensor, "B 4"]:
        """Move boxes (xyxy, pixels) with the images of this size, and clip them to what is still shown."""
        size = boxes.new_tensor([width, height] * 2)
        moved = 2 * boxes / size - 1
        for distortion in self:
            moved = distortion.moved(moved)
        return torch.minimum(((moved + 1) * size / 2).clamp(min=0), size)


# --- which there are, and their settings


@cache
def discovered() -> tuple[type[Technique], ...]:
    """Find every technique: the class `TECHNIQUE` of each file of the room. InputError: its group does not exist."""
    room = importlib.import_module(ROOM)
    names = sorted(module.name for module in pkgutil.iter_modules(room.__path__))
    modules = [importlib.import_module(f"{ROOM}.{name}") for name in names]
    for module in modules:
        if (group := getattr(module.TECHNIQUE, "group", None)) not in GROUPS:
            raise InputError(f"{module.__file__}: its group, {group!r}, is none of {', '.join(GROUPS)}")
    return tuple(sorted((module.TECHNIQUE for module in modules), key=lambda technique: technique.order))


def choices(setting: str) -> tuple[str, ...]:
    """List the words that techniques add to a setting."""
    return tuple(
        technique.choice[1]
        for technique in discovered()
        if technique.choice is not None and technique.choice[0] == setting
    )


def with_techniques(group: str) -> Callable[[type], type]:
    """Join the settings of a group's techniques to the core's dataclass, after its own. ValueError: no such group."""
    GROUPS.index(group)

    def join(core: type) -> type:
        parts = [
            technique.settings
            for technique in discovered()
            if technique.group == group and technique.settings is not None
        ]
        # Dataclasses list the fields of the last base first.
        names = {name: getattr(core, name) for name in ("__doc__", "__module__", "__qualname__")}
        whole = type(core.__name__, (*reversed(parts), core), names)
        return dataclasses.dataclass(frozen=True, kw_only=True)(whole)

    return join
