"""Train the patch segmenter of the defence `segment:SPEC` anew: `python -m tools.pretrain.segmenter_training`.

It learns from renders alone: sample bodies before procedural scenes, half of them in cloaks. A cloak is one of those
that `cloak harden` draws (balls, slabs and regions; grey, noise, blocks, and colours attacked anew against the built-in
detector), so it knows neither the logos that results are judged on nor their colours. Rectangles of coloured noise lie
on some images, as patches do in SAC's and PAD's.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from safetensors.torch import save
from torch import Tensor

from cloak_core.detectors.defended.masking import SIDE, WEIGHTS, PatchSegmenter
from cloak_core.detectors.loading import load_detector
from cloak_core.files.writing import write_bytes
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.studies.hardening.pool import Pool
from cloak_core.studies.hardening.settings import HardenSettings

OnEvent = Callable[[dict], None]
SHOWN = 0.2
"""A pixel belongs to a cloak where white cloth would be so much brighter than black; light alone is 0.5."""
ATTACK_STEPS = 2
"""Of each cloak; a segmenter is to know them at any strength."""
_PATCHES, _OUTFITS = 11, 12
"""Streams of random numbers."""


@dataclass(frozen=True, kw_only=True)
class SegmenterSettings:
    """How to train the patch segmenter. The weights that come with Cloak are of 320 steps, on cloaks that lived ten."""

    steps: int = 600
    """Updates."""
    batch: int = 8
    """Images in cloaks an update; half as many in own clothes beside them."""
    learning_rate: float = 3e-3
    """Of AdamW, at its height; one cycle."""
    patched: float = 0.3
    """Share of the images with a rectangle of noise on them."""
    judged: int = 10
    """Batches, of bodies and backgrounds kept back, that judge the result."""
    seed: int = 0


class Shown:
    """Images and where in them something is to be masked."""

    def __init__(self, settings: SegmenterSettings, kept_back: bool = False) -> None:
        which, places = ("unseen", "procedural:test") if kept_back else ("train", "procedural:train")
        pool = HardenSettings(batch=settings.batch, cloths=0.0, attack_steps=ATTACK_STEPS, size=SIDE)
        self.settings, self.stream = replace(settings, seed=settings.seed + kept_back), int(kept_back)
        self.bodies = sample_bodies(which)
        pool = replace(pool, seed=self.settings.seed)
        self.pool = Pool(pool, self.bodies, load_backgrounds(places), load_detector("builtin"))

    def batch(self, turn: int) -> tuple[Float[Tensor, "N 3 S S"], Bool[Tensor, "N 1 S S"]]:
        """Images in cloaks, then half as many in own clothes, with their masks; a function of seed and turn."""
        met = self.pool.turn(turn)
        with torch.no_grad():
            cloak, batch = met.cloak, replace(met.batch, on_logo=None)
            colors = cloak.optimizer.colors()
            mask = batch.images(torch.ones_like(colors)).clone() - batch.images(torch.zeros_like(colors)) > SHOWN
            cloaked = batch.images(colors).clone()
            rng = np.random.default_rng([self.settings.seed, _OUTFITS, turn])
            outfit = self.bodies.face_colors[rng.integers(self.bodies.outfit_count)][cloak.logo.face_ids]
            own = batch.images(torch.from_numpy(outfit)).clone()[: self.settings.batch // 2]
        images = torch.cat([cloaked, own])
        masks = torch.cat([mask.any(1, keepdim=True), torch.zeros_like(mask[: len(own), :1])])
        return self._patched(images, masks, turn)

    def _patched(
        self, images: Float[Tensor, "N 3 S S"], masks: Bool[Tensor, "N 1 S S"], turn: int
    ) -> tuple[Float[Tensor, "N 3 S S"], Bool[Tensor, "N 1 S S"]]:
        rng = np.random.default_rng([self.settings.seed, _PATCHES, turn])
        for image, mask in zip(images, masks, strict=True):
            if rng.random() < self.settings.patched:
                height, width = rng.integers(12, 72, 2)
                top, left = rng.integers(0, SIDE - height), rng.integers(0, SIDE - width)
                cells = rng.random((1, 3, *rng.integers(2, 24, 2)), dtype=np.float32)
                mode = ("nearest", "bicubic")[rng.integers(2)]
                patch = F.interpolate(torch.from_numpy(cells), (height, width), mode=mode)[0].clamp(0, 1)
                image[:, top : top + height, left : left + width] = patch
                mask[:, top : top + height, left : left + width] = True
        return images, masks


def train_segmenter(out: str | Path = WEIGHTS, on_event: OnEvent = lambda event: None, **options: int | float) -> dict:
    """Train the segmenter and write its weights (safetensors) to the file `out`; returns what `judge` says of it.

    options: fields of `SegmenterSettings`. The same seed gives the same weights on the same machine.
    """
    settings = SegmenterSettings(**options)
    torch.manual_seed(settings.seed)
    network = PatchSegmenter().to(memory_format=torch.channels_last)
    optimizer = torch.optim.AdamW(network.parameters(), settings.learning_rate)
    rates = torch.optim.lr_scheduler.OneCycleLR(optimizer, settings.learning_rate, settings.steps + 1)
    shown = Shown(settings)
    for step in range(1, settings.steps + 1):
        images, masks = shown.batch(step - 1)
        value = loss(network(images.contiguous(memory_format=torch.channels_last)), masks)
        optimizer.zero_grad(set_to_none=True)
        value.backward()
        optimizer.step()
        rates.step()
        if step % 20 == 0:
            on_event({"type": "step", "step": step, "loss": float(value.detach())})
    write_bytes(Path(out), save({name: value.contiguous() for name, value in network.state_dict().items()}))
    return {"steps": settings.steps} | judge(network.eval(), settings)


def loss(logits: Float[Tensor, "N 1 h w"], masks: Bool[Tensor, "N 1 S S"]) -> Float[Tensor, ""]:
    """Cross-entropy, and Dice over the batch, for most of every image is no patch."""
    target = F.interpolate(masks.to(logits.dtype), logits.shape[2:], mode="area")
    found = torch.sigmoid(logits)
    overlap = 2 * (found * target).sum() / (found.sum() + target.sum()).clamp(min=1)
    return F.binary_cross_entropy_with_logits(logits, target) + 0.5 * (1 - overlap)


@torch.no_grad()
def judge(network: PatchSegmenter, settings: SegmenterSettings) -> dict[str, float]:
    """On bodies and backgrounds that it never saw: `found`, the share of cloaks' and patches' pixels that are masked,
    and `clean`, the share of all other pixels that are."""
    shown, counts = Shown(settings, kept_back=True), torch.zeros(4, dtype=torch.float64)
    for turn in range(settings.judged):
        with torch.enable_grad():
            images, masks = shown.batch(turn)
        seen = F.interpolate(network(images), masks.shape[2:], mode="bilinear", align_corners=False) > 0
        counts += torch.stack([(seen & masks).sum(), masks.sum(), (seen & ~masks).sum(), (~masks).sum()])
    return {"found": round(float(counts[0] / counts[1]), 4), "clean": round(float(counts[2] / counts[3]), 4)}


def main() -> None:
    """Train with the options of the command line; progress and figures go to standard output."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="new file of the weights, .safetensors")
    parser.add_argument("--steps", type=int, default=SegmenterSettings.steps, help="updates of the weights")
    parser.add_argument("--seed", type=int, default=0, help="every random draw derives from it")
    options = vars(parser.parse_args())
    out = options.pop("out")
    if out.exists():
        parser.error(f"{out}: exists already")
    if options["steps"] < 1:
        parser.error(f"--steps {options['steps']}: at least 1 is needed")
    print(train_segmenter(out, on_event=print, **options))


if __name__ == "__main__":
    main()
