"""From patches sent and seen to a profile: a table that is smooth where nothing was measured, and its file."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import solve

from cloak_core.exchange.profiles import Profile, write_profile
from cloak_core.files.errors import InputError
from cloak_core.output.calibration.chart import patch_colors
from cloak_core.output.calibration.measured import read_icc, read_patches
from cloak_core.output.calibration.photograph import read_photograph
from cloak_core.scene.color_difference import mean_difference

STEPS = 9
"""Of the table, along each channel."""
LEAST = 24
"""Patches a fit needs."""
WEIGHTS = (1e-4, 1e-3, 1e-2, 1e-1)
"""Of smoothness, tried in turn."""
FOLDS = 5


def fit_profile(sent: Float[np.ndarray, "n 3"], seen: Float[np.ndarray, "n 3"]) -> Profile:
    """Fit the profile that these patches, sRGB in [0, 1], were seen through.

    A table of STEPS^3 colours whose trilinear values come near to what was seen and whose second differences are small
    (least squares). How much smoothness counts is chosen by patches left out in turn, and their mean CIEDE2000 is the
    profile's error. InputError: too few patches, or all of nearly one colour.
    """
    if len(sent) < LEAST:
        raise InputError(f"{len(sent)} patches were measured, and a profile takes at least {LEAST}")
    if np.linalg.matrix_rank(sent - sent.mean(axis=0), tol=0.1) < 3:
        raise InputError("the patches that were measured do not differ in red, green and blue")
    weights, bends = interpolation(sent), _bends()
    fold = np.random.default_rng(0).permutation(len(sent)) % FOLDS
    errors = {}
    for smooth in WEIGHTS:
        left_out = np.empty_like(seen, np.float64)
        for k in range(FOLDS):
            table = _solved(weights[fold != k], seen[fold != k], bends, smooth)
            left_out[fold == k] = weights[fold == k] @ table
        errors[smooth] = mean_difference(left_out.clip(0, 1), seen)
    best = min(errors, key=errors.get)
    table = _solved(weights, seen, bends, best).clip(0, 1).reshape(STEPS, STEPS, STEPS, 3)
    figures = {"de2000_before": mean_difference(sent, seen), "de2000_after": errors[best], "patches": float(len(sent))}
    return Profile(table.astype(np.float32), figures)


def interpolation(sent: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n entries"]:
    """Compute how much each of the table's entries counts for each colour, as `Profile` interpolates."""
    place = sent.clip(0, 1) * (STEPS - 1)
    low = np.minimum(place.astype(np.int64), STEPS - 2)
    weights = np.zeros((len(sent), STEPS**3))
    for corner in itertools.product((0, 1), repeat=3):
        share = np.where(corner, place - low, 1 - (place - low)).prod(axis=1)
        weights[np.arange(len(sent)), _entry(low + corner)] += share
    return weights


def _entry(index: Int[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    return np.ravel_multi_index(tuple(index.T), (STEPS, STEPS, STEPS))


def _bends() -> Float[np.ndarray, "entries entries"]:
    """Build the quadratic form of the table's second differences along each channel."""
    second = np.diff(np.eye(STEPS), n=2, axis=0)
    one, form = np.eye(STEPS), second.T @ second
    return np.kron(np.kron(form, one), one) + np.kron(np.kron(one, form), one) + np.kron(np.kron(one, one), form)


def _solved(weights: np.ndarray, seen: np.ndarray, bends: np.ndarray, smooth: float) -> Float[np.ndarray, "entries 3"]:
    # What is linear in the channels, and products of them, bends nothing: the least weight keeps the system regular
    # where few patches were measured.
    system = weights.T @ weights + smooth * bends
    system[np.diag_indices_from(system)] += 1e-9
    return solve(system, weights.T @ seen, assume_a="pos")


def profile_of(measured: Sequence[Path], out: Path) -> Profile:
    """Make the profile of photographs and CSVs of patches (all together), or of one ICC profile; write it to `out`.

    `figures` say what it is worth: mean CIEDE2000 between what was sent and seen, and between what the profile
    foretells and was seen of patches that its fit was not shown (none are needed for ICC: 0).
    """
    if out.suffix != ".npz":
        raise InputError(f"--out {out}: a profile is a .npz")
    printers = [path for path in measured if path.suffix.lower() in (".icc", ".icm")]
    if printers and len(measured) > 1:
        raise InputError(f"--measured {printers[0]}: an ICC profile stands alone")
    if printers:
        profile = read_icc(printers[0])
    else:
        tables = [read_patches(path) for path in measured if path.suffix.lower() == ".csv"]
        photographs = [read_photograph(path) for path in measured if path.suffix.lower() != ".csv"]
        if photographs:
            tables.append((patch_colors(), np.mean(photographs, axis=0)))
        profile = fit_profile(*(np.concatenate(column) for column in zip(*tables, strict=True)))
    write_profile(out, profile)
    return profile
