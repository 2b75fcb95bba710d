"""What each setting may be: bounds of numbers, choices of words."""

import math

_INF = math.inf
BOUNDS: dict[str, tuple[float, float, str]] = {
    "epochs": (0, _INF, "()"),
    "steps": (1, 10_000_000, "[]"),
    "batch": (1, 4096, "[]"),
    "max_seconds": (0, _INF, "()"),
    "held_out": (0, 0.5, "[]"),
    "held_out_every": (1, 10_000_000, "[]"),
    "patience": (0, 10_000_000, "[]"),
    "angle_jitter": (0, 180, "[]"),
    "hard_views": (0, 1, "[]"),
    "elevation_jitter": (0, 22.5, "[]"),
    "field_of_view": (0, 180, "()"),
    "size": (16, 4096, "[]"),
    "translation": (0, 4096, "[]"),
    "noise": (0, 1, "[]"),
    "occluders": (0, 16, "[]"),
    "blur": (0, 2, "[]"),
    "tv_weight": (0, _INF, "[)"),
    "nps_weight": (0, _INF, "[)"),
    "rpn_weight": (0, _INF, "[)"),
    "detectors_per_step": (1, 4096, "[]"),
    "lr": (0, _INF, "()"),
    "momentum": (0, 1, "[)"),
    "lr_epochs": (0, _INF, "()"),
    "seed": (0, 2**63 - 1, "[]"),
    "threads": (1, 4096, "[]"),
    "microbatch": (1, 4096, "[]"),
    "threshold": (0, 1, "()"),
    "checkpoint_every": (0, _INF, "[)"),
    "preview_every": (0, _INF, "[)"),
}
"""By name: low, high, which ends belong to the range."""
CHOICES: dict[str, tuple] = {
    "preset": ("paper", "reference", "best"),
    "samples": (None, 1, 4, 16, 64),
    "outfits": ("random", "first"),
    "translation_per": ("image", "batch"),
    "photometric_on": ("logo", "render"),
    "loss": ("score", "objectness", "log"),
    "reduce": ("max", "topk", "logsumexp"),
    "ensemble": ("mean", "max", "weighted"),
    "optimizer": ("sgd", "adam"),
    "schedule": ("constant", "step", "cosine"),
    "gamut": ("projection", "sigmoid"),
    "initial": ("grey", "random", "clothing"),
}
"""The words (or numbers) that a setting takes."""
