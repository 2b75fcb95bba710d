"""Small detectors for tests: seeded Darknet pairs written to disk."""

from collections.abc import Callable
from pathlib import Path

import torch

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.detectors.darknet.network import build_network
from cloak_core.detectors.darknet.weights import write_darknet

TINY_CFG = """\
[net]
width=64
height=64
channels=3

[convolutional]
batch_normalize=1
filters=8
size=3
stride=2
pad=1
activation=leaky

[maxpool]
size=2
stride=2

[convolutional]
batch_normalize=1
filters=16
size=3
stride=2
pad=1
activation=leaky

[convolutional]
filters=12
size=1
stride=1
pad=1
activation=linear

[region]
anchors=1,2, 2,4
classes=1
num=2
softmax=1
"""


def write_tiny(folder: Path, cfg: str = TINY_CFG, seed: int = 0, names: tuple[str, ...] | None = ("person",)) -> str:
    """A seeded pair in `folder`, batch-norm statistics and all; returns its spec."""
    network = build_network(cfg, seed=seed)
    generator = torch.Generator().manual_seed(seed + 1)
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            for values, low in ((module.running_var, 0.5), (module.weight.data, 0.5), (module.running_mean, -0.2)):
                values.copy_(torch.rand(values.shape, generator=generator) + low)
    write_darknet(cfg, network, folder / "tiny")
    if names is not None:
        (folder / "tiny.names").write_text("\n".join(names))
    return f"darknet:{folder / 'tiny.cfg'}:{folder / 'tiny.weights'}"


def images(count: int = 2, height: int = 64, width: int = 64, seed: int = 3) -> torch.Tensor:
    """Seeded noise images, smooth enough that resizing keeps them recognisable."""
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.rand(count, 3, 8, 8, generator=generator)
    return torch.nn.functional.interpolate(coarse, size=(height, width), mode="bilinear", align_corners=True)


def others_are_the_rest(load: Callable[[int], Detector], count: int, person: int, batch: torch.Tensor) -> None:
    """What a detector tells beside class `person` is the best of its other classes, each asked for by itself."""
    detector = load(person)
    with torch.no_grad():
        rest = {number: max_person_score(load(number)(batch)) for number in range(count) if number != person}
    found = detector(batch.clone().requires_grad_())
    best, row = found.other.max(dim=1)
    torch.testing.assert_close(best.detach(), torch.stack(list(rest.values())).amax(dim=0), rtol=1e-4, atol=1e-6)
    named = found.other_class.gather(1, row[:, None])[:, 0].tolist()
    for image, number in enumerate(named):
        torch.testing.assert_close(rest[number][image], best[image].detach(), rtol=1e-4, atol=1e-6)
    assert found.other.requires_grad and found.other_class.dtype == torch.int64


def lowers_score(detector: Detector, batch: torch.Tensor, step: float = 0.02) -> tuple[torch.Tensor, torch.Tensor]:
    """Scores before and after one small step of every image against its gradient."""
    batch = batch.clone().requires_grad_()
    before = max_person_score(detector(batch))
    (gradient,) = torch.autograd.grad(before.sum(), batch)
    assert bool(gradient.isfinite().all()) and bool((gradient.abs().amax(dim=(1, 2, 3)) > 0).all())
    norm = gradient.flatten(1).norm(dim=1)[:, None, None, None]
    for _ in range(8):  # halve until the linear model holds
        with torch.no_grad():
            after = max_person_score(detector(batch - step * gradient / norm))
        if bool((after < before).all()):
            break
        step /= 2
    return before.detach(), after
