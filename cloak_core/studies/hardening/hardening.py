"""Hardening: the detector learns to say of people in cloaks what it said of them without.

The folder: config.json  events.jsonl  checkpoint/  hardened.* (files of the detector's family)  hardened.licence.txt

A turn: a new cloak is attacked against the detector as it stands (never against a copy that is out of date), then the
detector learns from the same images in it and without it, from pictures, and from pictures with cloth that nobody
wears (`decoys`), all by distillation from what it was (`answers`). So no labels are needed, and what nobody
attacked is to stay as it was.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from cloak_core import __version__
from cloak_core.core.detector.protocol import detector_record
from cloak_core.core.events import OnEvent
from cloak_core.core.loop import Loop, LoopFolder, StopRequest, TrainingError, stop_request
from cloak_core.core.settings.values import option
from cloak_core.core.source import NOBODY, Cast
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_json
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.studies.hardening.answers import Surer
from cloak_core.studies.hardening.pictures import Decoys, Pictures
from cloak_core.studies.hardening.pool import Pool
from cloak_core.studies.hardening.settings import HardenSettings
from cloak_core.studies.hardening.student import Student
from cloak_core.studies.trainings.run_record import environment

FORMAT, EARLIER = "cloak hardening 4", ("cloak hardening 1", "cloak hardening 2", "cloak hardening 3")
"""EARLIER drew other cloaks, with which their checkpoints do not go on."""
FREE = ("max_seconds", "checkpoint_every")
"""Settings that a hardening may be resumed with otherwise."""
WARM_UP = 0.05
"""Share of the steps over which the learning rate rises."""
LAST = 0.8
"""Share of the steps after which cloaks count more (`cloaked_weight`) and the learning rate begins anew, at half its
height: a detector whose cloaks counted more from the start took cloth for people more often than before."""
CLIP = 5.0
"""Longest gradient, over all parameters."""
_NOISE = 5
"""Stream of random numbers; `pool` and `pictures` have others."""


@dataclasses.dataclass(frozen=True, eq=False)
class HardenMaterial:
    """What a detector is hardened on."""

    bodies: Bodies
    backgrounds: Backgrounds
    photographs: Backgrounds | None = None
    """Pictures of which the detector is to report what it reported; no labels."""
    people: Cast = NOBODY
    """Those who can be dressed; in cloaks they are to be reported as in their own clothes."""


class HardenFolder(LoopFolder):
    """Paths of a hardening."""

    work = "hardening"


@dataclasses.dataclass(frozen=True)
class HardenResult:
    """How a hardening ended."""

    out: Path
    spec: str
    """Of the hardened detector."""
    step: int
    steps: int
    seconds: float
    stopped: str
    """Why it was ended early; "" when it is complete."""


def harden(
    settings: HardenSettings,
    student: Student,
    material: HardenMaterial,
    out: Path,
    *,
    resume: bool = False,
    on_event: OnEvent | None = None,
) -> HardenResult:
    """Harden the student into the folder `out`: a file of its family, hardened.*, and its licence, beside config.json,
    events.jsonl and checkpoint/ as a training's run has them.

    SIGINT, SIGTERM, a file `cancel` in `out` or the time budget end it after the current step; `resume` goes on from
    there.
    InputError: `out` exists without `resume`, or was begun with something else.
    """
    if settings.lr is None:
        settings = dataclasses.replace(settings, lr=student.lr)
    if settings.precision == "auto":
        tiles = student.detector.device.type == "cpu" and torch.cpu.get_capabilities().get("amx_bf16", False)
        settings = dataclasses.replace(settings, precision="bfloat16" if tiles else "float32")
    pool = Pool(settings, material.bodies, material.backgrounds, student.detector, material.people)
    pictures = Pictures(pool, material.photographs, student.teacher)
    config = _config(settings, student, material)
    folder = HardenFolder(Path(out))
    start = lambda new: write_json(new / "config.json", config)
    check = lambda: _check(read_json(folder.config), config, folder.path)
    with folder.opened(resume, start, check), stop_request(folder.cancel, settings.max_seconds) as stop:
        return Hardening(settings, student, pool, pictures, folder, on_event).run_to_end(stop)


def _config(settings: HardenSettings, student: Student, material: HardenMaterial) -> dict:
    """Make config.json: what decides the result, and where it ran."""
    bodies, photographs = material.bodies, material.photographs
    return {
        "format": FORMAT,
        "cloak": __version__,
        "settings": dataclasses.asdict(settings),
        "detector": {"spec": student.spec} | detector_record(student.teacher),
        "scene": {"name": bodies.name, "poses": list(bodies.names), "identity": bodies.identity},
        "backgrounds": sha256_record(material.backgrounds.identities()),
        "photographs": None if photographs is None else sha256_record(photographs.identities()),
        "people": material.people.identity,
        "environment": environment(),
    }


def _check(recorded: dict, config: dict, path: Path) -> None:
    """Check that a folder was begun with the same. InputError names what is other."""
    if recorded.get("format") in EARLIER:
        raise InputError(f"{path}: was begun by an earlier version, which drew other cloaks; begin in another --out")
    if recorded.get("format") != FORMAT:
        raise InputError(f"{path}: not a folder of cloak harden")
    for name, value in config["settings"].items():
        before = recorded["settings"].get(name)
        if name not in FREE and before != value:
            words = f"{option(name)} = {before}, not {value}"
            raise InputError(f"{path}: was begun with other {words}; resume with the same")
    material = {"bodies (--scene)": ("scene", "identity"), "weights of the detector": ("detector", "sha256")}
    for words, (part, key) in material.items():
        if recorded[part].get(key) != config[part][key]:
            raise InputError(f"{path}: was begun with other {words}; resume with the same")
    for name in ("backgrounds", "photographs", "people"):
        before = recorded.get(name)
        # Earlier records list what later ones hash.
        if (sha256_record(before) if isinstance(before, list) else before) != config[name]:
            raise InputError(f"{path}: was begun with other {name}; resume with the same")


class Hardening(Loop):
    """One hardening as a loop."""

    def __init__(
        self,
        settings: HardenSettings,
        student: Student,
        pool: Pool,
        pictures: Pictures,
        folder: HardenFolder,
        on_event: OnEvent | None = None,
    ) -> None:
        self.settings, self.student, self.pool, self.pictures = settings, student, pool, pictures
        student.detector.precision = settings.precision
        self.parameters = list(student.network.parameters())
        self.optimizer = torch.optim.AdamW(self.parameters, settings.lr, weight_decay=0.0)
        self.averaged = {name: value.clone() for name, value in student.network.state_dict().items()}
        super().__init__(folder, settings.steps, settings.checkpoint_every, on_event, device=pool.device)

    def run_to_end(self, stop: StopRequest) -> HardenResult:
        """Steps until done or told to stop; a checkpoint and the detector are written either way."""
        try:
            reason = self.run(stop)
            learned = self.settings.batch + min(self.settings.clean, self.settings.batch)
            shown = learned + self.settings.pictures + self.settings.decoys
            spec = self.student.write(self.averaged, self.folder.path, self.step * shown)
            self.tell("end", outcome="stopped" if reason else "done", reason=reason, spec=spec)
        finally:
            self.close()
        return HardenResult(self.folder.path, spec, self.step, self.steps, self.seconds, reason)

    def one_step(self) -> None:
        """See `Loop`."""
        self.student.detector.requires_grad_(False)
        turn, pictures = self.pool.turn(self.step), self.pictures.plain(self.step)
        parts = self._learn(turn.cloaked, turn.clean, pictures, self.pictures.decoys(self.step))
        self.step += 1
        self._average()
        attack = turn.attack
        figures = {} if attack is None else {"success": attack.success, "disappearance": attack.disappearance}
        self.tell("step", **parts, **figures)

    def _learn(self, cloaked: Tensor, clean: Tensor, pictures: Tensor, decoys: Decoys) -> dict[str, float]:
        """Learn from a turn's images; returns the loss and its parts, each a mean over its own images.

        With a perturbation there are several updates. The backward pass of each also gives the slope of the images in
        cloaks, along which the next one sees them moved ("free" adversarial training, Shafahi et al., NeurIPS 2019;
        beside cloaks: PBCAT, ICCV 2025).
        """
        count, kept = len(cloaked), min(self.settings.clean, len(cloaked))
        sources = torch.cat([clean, pictures, decoys.without])
        rows = torch.arange(len(sources), device=clean.device)
        wanted = self.student.wanted(sources, torch.cat([rows[:count], rows[:kept], rows[count:]]))
        others = torch.cat([clean[:kept], pictures, decoys.shown])
        bound = self.settings.perturbation
        if not bound:
            each = self._update(torch.cat([cloaked, others]), wanted, count, kept)
        else:
            rng = np.random.default_rng([self.settings.seed, _NOISE, self.step])
            start = rng.uniform(-bound, bound, cloaked.shape).astype(np.float32)
            noise = torch.from_numpy(start).to(cloaked.device)
            for _ in range(self.settings.replays):
                moved = (cloaked + noise).clamp(0, 1).requires_grad_()
                each = self._update(torch.cat([moved, others]), wanted, count, kept)
                noise = (noise + bound * moved.grad.sign()).clamp(-bound, bound)
        parts = each.split([count, kept, len(pictures), len(decoys.shown)])
        names = ("cloaked", "clean", "pictures", "decoys")
        means = {name: float(part.mean()) for name, part in zip(names, parts, strict=True) if len(part)}
        weights = self._weights(each, count)
        return {"loss": float((weights * each).sum() / weights.sum())} | means

    def _weights(self, each: Tensor, count: int) -> Tensor:
        """How much each image counts, the `count` in cloaks first."""
        weights = torch.ones_like(each)
        weights[:count] = self.settings.cloaked_weight if self.step >= LAST * self.settings.steps else 1.0
        return weights

    def _update(self, images: Tensor, wanted: object, count: int, kept: int) -> Tensor:
        """Update the detector once; returns each image's loss. Images that require a gradient get one.

        count: images in cloaks, which come first; kept: the same in their own clothes, which come next.
        """
        student = self.student
        surer = None
        if self.settings.sure:
            surer = Surer(torch.arange(len(images), device=images.device) < count + kept, self.settings.sure)
        student.detector.requires_grad_(True)
        each = student.distance(images, wanted, surer)
        weights = self._weights(each, count)
        loss = (weights * each).sum() / weights.sum()
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        length = torch.nn.utils.clip_grad_norm_(self.parameters, CLIP)
        if not math.isfinite(float(loss.detach())) or not math.isfinite(float(length)):
            raise TrainingError(f"{self.folder.path}: the loss of step {self.step + 1} is not finite; try a lower --lr")
        for group in self.optimizer.param_groups:
            group["lr"] = self.settings.lr * rate(self.step, self.settings.steps)
        self.optimizer.step()
        return each.detach()

    @torch.no_grad()
    def _average(self) -> None:
        decay = min(self.settings.average, self.step / (self.step + 10))
        for name, value in self.student.network.state_dict().items():
            if value.is_floating_point():
                self.averaged[name].lerp_(value, 1 - decay)

    def state(self) -> dict[str, Tensor]:
        """See `Loop`."""
        # Copies: one parameter may stand under several names, which the file's format refuses.
        tensors = {f"network.{name}": value.clone() for name, value in self.student.network.state_dict().items()}
        tensors |= {f"averaged.{name}": value for name, value in self.averaged.items()}
        for number, state in self.optimizer.state_dict()["state"].items():
            tensors |= {f"adam.{number}.{name}": value for name, value in state.items()}
        return tensors | self.pool.state()

    def load(self, tensors: dict[str, Tensor]) -> None:
        """See `Loop`."""
        for mark, target in (("network.", self.student.network.state_dict()), ("averaged.", self.averaged)):
            for name, value in target.items():
                value.copy_(tensors[mark + name])
        states: dict[int, dict[str, Tensor]] = {}
        for name, value in tensors.items():
            if name.startswith("adam."):
                _, number, key = name.split(".")
                states.setdefault(int(number), {})[key] = value.to("cpu" if key == "step" else self.pool.device)
        self.optimizer.load_state_dict(self.optimizer.state_dict() | {"state": states})
        self.pool.load(tensors)


def rate(step: int, steps: int) -> float:
    """Share of the learning rate before update `step` (from 0): a rise, half a cosine down to 0, another from 0.5."""
    last = max(1, math.ceil(LAST * steps))
    if step >= last:
        return 0.25 + 0.25 * math.cos(math.pi * (step - last) / (steps - last))
    warm = max(1, round(WARM_UP * last))
    if step < warm:
        return (step + 1) / (warm + 1)
    return 0.5 + 0.5 * math.cos(math.pi * (step - warm) / max(1, last - warm))
