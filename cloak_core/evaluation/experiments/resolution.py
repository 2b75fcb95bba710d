"""Subdivision levels: success, time, and how many of the logo's faces any training view gives a gradient."""

from __future__ import annotations

import numpy as np
import torch
from matplotlib.figure import Figure

from cloak_core.evaluation.experiments.drawing import errors
from cloak_core.evaluation.experiments.lab import MULTI, Lab, times
from cloak_core.evaluation.experiments.logos import chest_thighs
from cloak_core.evaluation.experiments.numbers import Numbers, column
from cloak_core.evaluation.figures import CYCLE, legend_above, new_figure, percent_axis
from cloak_core.evaluation.report.words import percent, said
from cloak_core.exchange.bodies import Bodies
from cloak_core.render.views import ViewBank
from cloak_core.scene.cameras import Camera
from cloak_core.scene.meshes.subdivision import subdivide

TITLE = "Resolution of the mesh"


def measure(lab: Lab) -> Numbers:
    spec = lab.specs[0]
    bodies, unseen, faces = lab.materials.bodies, lab.materials.unseen, chest_thighs(lab.materials.bodies)
    rows = []
    for level in range(2 if lab.options.quick else 3):
        if level:
            bodies, parent = subdivide(bodies)
            unseen, _ = subdivide(unseen)
            faces = np.flatnonzero(np.isin(parent, faces)).astype(np.int64)
        trained = lab.repeat(faces, [spec], bodies=bodies, angles=MULTI)
        result = lab.evaluate(trained, lab.angles, [spec], bodies=unseen)
        label = {"level": level, "logo_faces": len(faces), "reach": gradient_reach(lab, bodies, faces)}
        rows.append(label | times(trained) | result.row(spec))
    return Numbers(rows)


def gradient_reach(lab: Lab, bodies: Bodies, faces: np.ndarray) -> float:
    """Share of the faces that get a gradient from the first body's training views."""
    bank = ViewBank(bodies.select_poses([0]), samples=lab.options.samples, device=lab.options.device)
    seen = torch.zeros(len(faces), dtype=torch.bool, device=bank.device)
    for azimuth in (-10.0, -5.0, 0.0, 5.0, 10.0):
        camera = Camera(azimuth=azimuth, width=lab.options.size, height=lab.options.size)
        seen[bank.dress(0, camera, faces).logo_face] = True
    return round(float(seen.float().mean()), 4)


def tell(numbers: Numbers) -> list[str]:
    words = [
        "The same logo on bodies subdivided 0, 1, ... times (each face in four). Reach is the share of its faces that "
        "at least one training view sees; processor time, all threads, includes building the views."
    ]
    for row in numbers.rows:
        time = "its time was not measured" if row["cpu_seconds"] is None else f"{row['cpu_seconds']:g} s"
        words.append(f"Level {row['level']}: {said(row)}; reach {percent(row['reach'])}, {time}.")
    return words


def draw(numbers: Numbers) -> dict[str, Figure]:
    rows = numbers.rows
    figure, axes = new_figure(columns=2)
    x, seconds = column(rows, "logo_faces"), column(rows, "cpu_seconds")
    axes[0].errorbar(x, column(rows), errors(rows), color=CYCLE[0], marker="o", capsize=2, label="success")
    reach = {"color": CYCLE[1], "marker": "s", "ls": "--", "label": "faces with a gradient"}
    axes[0].plot(x, column(rows, "reach"), mfc="white", zorder=3, **reach)
    percent_axis(axes[0], "")
    axes[1].plot(x, np.array(seconds, float), color=CYCLE[2], marker="D", clip_on=False)
    axes[1].set_ylim(0, 1.1 * max(value or 1.0 for value in seconds))
    axes[1].set_ylabel("processor time of the training (s)")
    for axis in axes:
        axis.set_xlabel("faces of the logo")
        axis.set_xscale("log")
        axis.set_xticks(x, [f"{faces:,}" for faces in x])
        axis.set_xticks([], minor=True)
    legend_above(figure)
    return {"resolution": figure}
