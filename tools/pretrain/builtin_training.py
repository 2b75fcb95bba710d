"""Train the built-in detector anew, on renders of the sample bodies: `python -m tools.pretrain.builtin_training`."""

from __future__ import annotations

import argparse
import copy
import math
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.detector.scoring import box_iou
from cloak_core.detectors.darknet.cfg import read_cfg_text
from cloak_core.detectors.darknet.detector import BUILTIN_CFG
from cloak_core.detectors.darknet.network import Network, build_network
from cloak_core.detectors.darknet.weights import read_weights, write_darknet
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.people.samples import sample_bodies
from tools.pretrain.calibration import Calibration, apply_calibration, calibrate
from tools.pretrain.examples import Batch, ExampleMaker
from tools.pretrain.outfits import Wardrobe
from tools.pretrain.people import render_people
from tools.pretrain.region_loss import region_loss
from tools.pretrain.scenery import PHOTO_SIDE, Scenery

OnEvent = Callable[[dict], None]
HELD_BACK = 6
"""Every sixth photograph is kept for calibration and never trained on."""
HARD_SCORE = 0.2
"""A place without people that scores this much is shown again."""


@dataclass(frozen=True, kw_only=True)
class BuiltinSettings:
    """How to train the built-in detector.

    The weights that come with Cloak: 1,017 steps of a run of 3,600 (views 1,000, scenes 1,200) that was cut short, then
    900 from there (seed 1, learning rate 1.2e-3, views and scenes 800). A batch of 16 takes about 0.25 s on two free
    cores, so the default is some ten minutes.
    """

    steps: int = 2000
    """Updates."""
    batch: int = 16
    """Images an update, `hard` of them mined."""
    hard: int = 2
    """Of each batch, places without people that the network mistook before."""
    learning_rate: float = 2e-3
    """Of AdamW, at its height; warm-up, then a cosine down to 0."""
    views: int = 1000
    """Rendered views, dressed anew at every use."""
    scenes: int = 1000
    """Procedural places."""
    average: float = 0.998
    """Decay of the running average of the weights, which is what gets stored."""
    checkpoint_seconds: float = 180.0
    """Between two stores of the weights."""
    judged: int = 384
    """Images with and as many without a person that calibrate each stored state."""
    seed: int = 0


def train_builtin(
    out_dir: str | Path,
    backgrounds: str | Path | None = None,
    steps: int = BuiltinSettings.steps,
    seed: int = 0,
    on_event: OnEvent = lambda event: None,
    start_from: str | Path | None = None,
    **options: int | float,
) -> dict:
    """Train the detector; write `builtin.cfg` and `builtin.weights` into `out_dir`, every few minutes and at the end.

    backgrounds: a folder of photographs without people, used beside the procedural scenes (from six on, one in six
    calibrates the scores instead). start_from: .weights to go on from (say, of a run that was cut short) instead of
    random ones; steps and learning rate begin anew. `options` are further fields of `BuiltinSettings`. Returns, and
    gives `on_event`, figures of the last stored state: recall and false_alarms at 0.6 on held-back images. The same
    seed gives the same weights on the same machine.
    """
    try:
        settings = BuiltinSettings(steps=steps, seed=seed, **options)
    except TypeError as error:
        raise InputError(f"BuiltinSettings: {error}") from None
    out = Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    cfg = read_cfg_text(BUILTIN_CFG)
    network = build_network(cfg, seed=settings.seed)
    if start_from is not None:
        read_weights(network, Path(start_from))
    network = network.to(memory_format=torch.channels_last)
    training, judging = make_data(settings, backgrounds, network.input_size[0], on_event)
    trainer = Trainer(network, training, settings)
    try:
        return _run(trainer, judging, cfg, out, on_event)
    finally:
        trainer.pool.shutdown(cancel_futures=True)


def _run(trainer: Trainer, judging: ExampleMaker, cfg: str, out: Path, on_event: OnEvent) -> dict:
    settings, result, stored = trainer.settings, {}, time.monotonic()
    for step in range(1, settings.steps + 1):
        losses = trainer.step()
        if step % 50 == 0:
            on_event({"type": "step", "step": step, **losses, "hard": len(trainer.hard)})
        if step == settings.steps or time.monotonic() - stored > settings.checkpoint_seconds:
            figures = store(trainer.averaged, judging, cfg, out, step * settings.batch, settings.judged)
            result = {"step": step, **figures}
            on_event({"type": "stored", **result})
            stored = time.monotonic()
    return result


def make_data(
    settings: BuiltinSettings, backgrounds: str | Path | None, size: int, on_event: OnEvent
) -> tuple[ExampleMaker, ExampleMaker]:
    """Examples to train on, and others, over places never trained on, to calibrate with."""
    photos = load_backgrounds(backgrounds, (PHOTO_SIDE, PHOTO_SIDE)) if backgrounds is not None else None
    kept = None
    if photos is not None and len(photos) >= HELD_BACK:
        kept = photos.split(HELD_BACK, HELD_BACK - 1)
        photos = photos.subset([i for i in range(len(photos)) if i % HELD_BACK != HELD_BACK - 1])
    bodies = sample_bodies("train")
    rng = np.random.default_rng([settings.seed, 1])
    views = render_people(
        bodies, settings.views, rng, lambda n: on_event({"type": "views", "done": n}) if n % 100 == 0 else None
    )
    wardrobe = Wardrobe(bodies)
    fresh = load_backgrounds(f"procedural:train:{settings.scenes}:{settings.seed}")
    other = load_backgrounds(f"procedural:train:{max(20, settings.scenes // 5)}:{settings.seed + 1}")
    training = ExampleMaker(views, wardrobe, Scenery(fresh, photos), size)
    return training, ExampleMaker(views, wardrobe, Scenery(other, kept), size)


class Trainer:
    """The network, its running average, and the places it mistook."""

    def __init__(self, network: Network, data: ExampleMaker, settings: BuiltinSettings) -> None:
        self.network, self.data, self.settings = network, data, settings
        self.averaged = copy.deepcopy(network).eval().requires_grad_(False)
        decayed = [p for p in network.parameters() if p.ndim > 1]
        rest = [p for p in network.parameters() if p.ndim <= 1]
        self.optimizer = torch.optim.AdamW(
            [{"params": decayed, "weight_decay": 0.02}, {"params": rest, "weight_decay": 0.0}], settings.learning_rate
        )
        self.schedule = torch.optim.lr_scheduler.LambdaLR(
            self.optimizer, lambda done: learning_curve(done, settings.steps)
        )
        self.mining_rng, self.data_rng = (np.random.default_rng([settings.seed, i]) for i in (2, 3))
        self.hard: deque[Tensor] = deque(maxlen=600)
        self.done = 0
        self.pool = ThreadPoolExecutor(1)  # composes the next batch beside the network's work
        self.next = self._order()

    def step(self) -> dict[str, float]:
        """One update; every tenth looks for new mistakes first."""
        if self.done % 10 == 0 and self.done >= self.settings.steps // 10:
            self._mine()
        batch = self.next.result()
        self.next = self._order()
        self.network.train()
        raw = self._forward(self.network, batch.images)
        losses = region_loss(raw, self.network.heads[0], batch.boxes, batch.present, batch.ignored)
        self.optimizer.zero_grad(set_to_none=True)
        losses.total.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 20.0)
        self.optimizer.step()
        self.schedule.step()
        self.done += 1
        self._average()
        return {"objectness": float(losses.objectness.detach()), "box": float(losses.box.detach())}

    def _order(self) -> Future[Batch]:
        count = min(self.settings.hard, len(self.hard))
        picked = [self.hard[i] for i in self.mining_rng.integers(len(self.hard), size=count)] if count else []
        return self.pool.submit(self.data.batch, self.data_rng, self.settings.batch, picked)

    def _forward(self, network: Network, images: Tensor) -> Tensor:
        with torch.autocast(images.device.type, torch.bfloat16, enabled=fast_bfloat16(images.device)):
            return network(images.to(memory_format=torch.channels_last))[0]

    @torch.no_grad()
    def _mine(self) -> None:
        places = [self.data.place(self.mining_rng) for _ in range(32)]
        scores = best_logits(self.network.eval(), torch.stack(places).float() / 255).sigmoid()
        self.hard.extend(place for place, score in zip(places, scores.tolist(), strict=True) if score > HARD_SCORE)

    @torch.no_grad()
    def _average(self) -> None:
        """The running average begins as a plain mean, so that it forgets its random start."""
        decay = min(self.settings.average, self.done / (self.done + 10))
        ours, theirs = self.averaged.state_dict(), self.network.state_dict()
        for name, value in ours.items():
            if value.is_floating_point():
                value.lerp_(theirs[name], 1 - decay)
            else:
                value.copy_(theirs[name])


def fast_bfloat16(device: torch.device) -> bool:
    """Whether the device computes in bfloat16 faster than in float32 (elsewhere it would only be emulated)."""
    if device.type == "cpu":
        return torch.ops.mkldnn._is_mkldnn_bf16_supported() and torch.cpu._is_avx512_bf16_supported()
    return torch.cuda.is_bf16_supported()


def learning_curve(done: int, steps: int) -> float:
    """Share of the learning rate: up over 200 steps (a fifth of a short run), then half a cosine down."""
    warm = min(200, steps // 5)
    if done < warm:
        return (done + 1) / (warm + 1)
    return 0.5 + 0.5 * math.cos(math.pi * (done - warm) / max(1, steps - warm))


@torch.no_grad()
def best_logits(network: Network, images: Float[Tensor, "B 3 S S"]) -> Float[Tensor, " B"]:
    """The largest objectness logit of each image."""
    raw = network(images)[0]
    return network.heads[0].split(raw)[:, :, 4].float().flatten(1).amax(1)


@torch.no_grad()
def person_logits(network: Network, data: ExampleMaker, rng: np.random.Generator, count: int) -> Float[Tensor, " P"]:
    """For `count` plain images of one person, the largest objectness logit among boxes that lie on the person."""
    found: list[Tensor] = []
    while len(found) < count:
        examples = [data.example(rng, 1, plain=True) for _ in range(32)]
        raw = network(torch.stack([e.image for e in examples]))[0]
        head = network.heads[0]
        logits = head.split(raw)[:, :, 4].float().flatten(1)
        overlap = box_iou(
            head.decode(raw.float(), network.input_size).boxes, torch.stack([e.boxes[:1] for e in examples])
        )
        best = torch.where(overlap >= 0.5, logits, -20.0).amax(1)
        found += [value for value, e in zip(best, examples, strict=True) if e.present[0]]
    return torch.stack(found[:count])


def store(network: Network, judging: ExampleMaker, cfg: str, out: Path, seen: int, count: int) -> dict:
    """Calibrate a copy of the network on held-back images and write it to `out`; returns recall and false alarms."""
    calibrated = copy.deepcopy(network).eval()
    rng = np.random.default_rng(3)
    people = person_logits(calibrated, judging, rng, count)
    places = torch.cat(
        [
            best_logits(calibrated, torch.stack([judging.place(rng) for _ in range(32)]).float() / 255)
            for _ in range(count // 32)
        ]
    )
    calibration: Calibration = calibrate(people, places)
    apply_calibration(calibrated, calibration)
    write_darknet(cfg, calibrated, out / "builtin", seen)
    return calibration._asdict()


def main() -> None:
    """Train with the options of the command line; progress and figures go to standard output."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="new folder for builtin.cfg and builtin.weights")
    parser.add_argument("--backgrounds", type=Path, help="folder of photographs without people, beside the procedural")
    parser.add_argument("--steps", type=int, default=BuiltinSettings.steps, help="updates of the weights")
    parser.add_argument("--start-from", type=Path, help="weights to go on from (.weights of the same network)")
    parser.add_argument("--seed", type=int, default=0, help="every random draw derives from it")
    options = vars(parser.parse_args())
    out = options.pop("out")
    if out.exists():
        parser.error(f"{out}: exists already")
    if options["steps"] < 1:
        parser.error(f"--steps {options['steps']}: at least 1 is needed")
    print(train_builtin(out, on_event=print, **options))


if __name__ == "__main__":
    main()
