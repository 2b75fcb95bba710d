"""The images of an evaluation, rendered by Blender's Cycles instead of our own renderer.

Blender runs in a process of its own (`blender_addon/cycles_frames.py`); what passes between the two is a folder of
arrays and PNG files. One frame is a body, a camera, a colouring and a light; putting it before backgrounds is done
here, as for our own images: in display colours, image = body * alpha + background * (1 - alpha).
"""

from __future__ import annotations

import itertools
import os
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from cloak_core.core.evaluate import Patterns
from cloak_core.core.evaluation import LOGO
from cloak_core.core.evaluation.measure import OnProgress
from cloak_core.core.images import ImageSet, Indices
from cloak_core.core.pattern import Pattern
from cloak_core.core.pictures import read_picture
from cloak_core.core.visibility.normals import NormalOperator
from cloak_core.files.identity import sha256_arrays, sha256_record, source_hash
from cloak_core.files.reading import MAX_TEXT_BYTES, read_json, read_text
from cloak_core.files.writing import open_to_append, write_json, write_npz
from cloak_core.sources.bodies.blender.outside import ROOT, blender_command, blender_version
from cloak_core.studies.imagery import before_grey, camera_of

SCRIPT = ROOT / "blender_addon" / "cycles_frames.py"
LIGHTS = ("matching", "studio", "sky")
"""Light set-ups of `blender_addon/cycles_frames.py`: our model's own, and two natural ones."""
SAMPLES = 32
"""Light paths per pixel, without denoising."""
OnFrame = Callable[[str], None]
"""Told a line for every frame."""


def cycles_command() -> list[str]:
    """Find a command that runs a script in Blender. NoBlender: there is none."""
    return blender_command("Cycles is a part of Blender")


def first_trials(trials: pd.DataFrame) -> dict[tuple[int, float], int]:
    """Find the first trial of every pose and angle (degrees), sorted."""
    places = list(zip(trials["pose"].tolist(), trials["angle"].tolist(), strict=True))
    return {place: places.index(place) for place in sorted(set(places))}


def in_cycles(
    images: ImageSet, patterns: Patterns, out: Path, light: str, on_progress: OnProgress | None
) -> CyclesImages:
    """Render the trials in one light of Cycles, in the first outfit; frames are kept in a folder in `out`."""
    # Every other outfit would need frames of its own.
    images = replace(images, trials=images.trials.assign(outfit=0))
    done, frames = itertools.count(1), len(first_trials(images.trials)) * len(patterns)
    on_frame = lambda _: on_progress and on_progress(next(done), frames)
    return CyclesImages.of(images, patterns, render_frames(images, patterns, out, SAMPLES, on_frame, (light,)), light)


def render_frames(
    images: ImageSet,
    patterns: Patterns,
    out: Path,
    samples: int,
    on_frame: OnFrame,
    lights: Sequence[str] = LIGHTS,
) -> Path:
    """Render every pose and angle of the trials in every pattern and light; return the frames' folder.

    The folder OUT/HASH is named by what decides the pixels, so frames are rendered once, and a job that was stopped
    goes on. The first outfit is worn throughout, and "random" has one draw.
    """
    command = cycles_command()
    bodies, camera = images.source.bodies, camera_of(images, 0)
    job = {
        "size": camera.height,
        "samples": samples,
        "near": camera.near_plane,
        "far": 100 * camera.distance,
        "frames": [
            {"file": file_name(light, *place, name), "colors": number, "light": light} | _view(images, trial)
            for light in lights
            for place, trial in first_trials(images.trials).items()
            for number, name in enumerate(patterns)
        ],
    }
    # The vertex normals that our renderer shades with.
    operator = NormalOperator(torch.from_numpy(bodies.triangles.T.astype(np.int64)), bodies.vertex_count)
    normals = [operator(torch.from_numpy(vertices.T.astype(np.float64))).T.numpy() for vertices in bodies.vertices]
    mesh = {
        "vertices": bodies.vertices,
        "normals": np.stack(normals),
        "triangles": bodies.triangles,
        "colors": np.stack([_triangle_colors(images, pattern) for pattern in patterns.values()]),
    }
    content = [sha256_arrays(*mesh.values()), job, source_hash(SCRIPT), blender_version(command)]
    folder = out / sha256_record(content)[:16]
    folder.mkdir(parents=True, exist_ok=True)
    if all((folder / frame["file"]).exists() for frame in job["frames"]):
        return folder
    write_npz(folder / "meshes.npz", **mesh)
    write_json(folder / "job.json", job)
    _run(command, folder, on_frame)
    return folder


def _run(command: Sequence[str], folder: Path, on_frame: OnFrame) -> None:
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}
    log = folder / "blender.log"
    command = [*command, str(SCRIPT), "--", str(folder.resolve())]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with open_to_append(log) as output:
        process = subprocess.Popen(command, env=environment, **pipes)
        try:
            for line in process.stdout:
                output.write(line.encode())
                if line.startswith("frame "):
                    on_frame(line.strip())
        finally:
            process.terminate()  # only where we leave early: it has closed its output otherwise
            code = process.wait()
    missing = [frame["file"] for frame in read_json(folder / "job.json")["frames"]]
    missing = [name for name in missing if not (folder / name).exists()]
    if missing:
        tail = "\n".join(read_text(log, MAX_TEXT_BYTES, errors="replace").splitlines()[-20:])
        raise RuntimeError(f"Blender ended with exit code {code} before {missing[0]} was rendered:\n{tail}")


def _view(images: ImageSet, trial: int) -> dict:
    camera = camera_of(images, trial)
    pose = int(images.trials.at[trial, "pose"])
    vertices = images.source.bodies.vertices[pose].astype(np.float64)
    pivot = camera.pivot or tuple((vertices.min(0) + vertices.max(0)) / 2)
    return {
        "pose": pose,
        "position": [float(x) for x in camera.position(pivot)],
        "axes": camera.axes,
        "field_of_view": camera.field_of_view,
    }


def file_name(light: str, pose: int, angle: float, control: str) -> str:
    """Name the PNG of a frame."""
    return f"{light}-{pose}-{angle:+g}-{control}.png"


def _triangle_colors(images: ImageSet, pattern: Pattern) -> Float32[np.ndarray, "T 3"]:
    """Look up the colours of all triangles, the first outfit's where the pattern is not worn."""
    bodies, ids = images.source.bodies, pattern.cover.face_ids
    faces = bodies.face_colors[0].copy()
    (view,) = images.views([0], pattern)
    faces[ids] = pattern.on_faces(pattern.colors_in(view, 0).cpu().numpy())
    return faces[bodies.triangle_face]


@dataclass(eq=False)
class CyclesImages(ImageSet):
    """Images of trials from frames of `render_frames` under one light."""

    folder: Path = Path()
    light: str = ""
    names: Mapping[str, str] = field(default_factory=dict)
    """Of the patterns, by their identity."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._frames: dict[tuple[int, float, str], Tensor] = {}

    @classmethod
    def of(cls, images: ImageSet, patterns: Patterns, folder: Path, light: str) -> CyclesImages:
        """Take frames for the images of bodies."""
        own = {each.name: getattr(images, each.name) for each in fields(ImageSet)}
        names = {pattern.identity: name for name, pattern in patterns.items()}
        return cls(**own, folder=folder, light=light, names=names)

    @property
    def identity(self) -> str:
        """See `ImageSet`: the folder is named by what decides its frames."""
        return sha256_record([super().identity, self.folder.name, self.light])

    def compose(self, indices: Indices, patterns: Sequence[Pattern]) -> Iterator[Float[Tensor, "B 3 H W"]]:
        """See `ImageSet`."""
        rows = self.trials.iloc[np.asarray(indices, np.int64)]
        behind = self.bare(rows["background"].to_numpy())
        shifts = self.shifts(indices).tolist()
        for pattern in patterns:
            name = self.names[pattern.identity]
            seen = zip(rows["pose"].tolist(), map(float, rows["angle"]), shifts, strict=True)
            bodies = (_shifted(self.body(pose, angle, name), *shift) for pose, angle, shift in seen)
            yield torch.stack([b[:3] * b[3:] + back * (1 - b[3:]) for b, back in zip(bodies, behind, strict=True)])

    def body(self, pose: int, angle: float, name: str = LOGO) -> Float[Tensor, "4 H W"]:
        """Read one frame: RGBA in [0, 1], straight alpha."""
        key = (pose, angle, name)
        if key not in self._frames:
            pixels = read_picture(self.folder / file_name(self.light, *key), "RGBA")
            self._frames[key] = torch.from_numpy(pixels).permute(2, 0, 1).contiguous()
        return self._frames[key].to(self.device).float() / 255


def _shifted(body: Float[Tensor, "4 H W"], right: int, down: int) -> Float[Tensor, "4 H W"]:
    """Move the body by whole pixels; what leaves the image is lost, what comes in is empty."""
    height, width = body.shape[1:]
    moved = torch.zeros_like(body)
    y, x = max(0, down), max(0, right)
    part = body[:, max(0, -down) : height - y, max(0, -right) : width - x]
    moved[:, y : y + part.shape[1], x : x + part.shape[2]] = part
    return moved


def image_difference(ours: ImageSet, cycles: CyclesImages, pattern: Pattern) -> dict[str, float]:
    """Compare images of the cloaked bodies, averaged over poses and angles, before mid-grey, in display colours [0, 1].

    "rms": over pixels that either covers, all channels; "bias": mean of Cycles' minus ours; "inside": rms where both
    cover the pixel wholly, so that silhouettes do not count.
    """
    either, both = [], []
    for (pose, angle), trial in first_trials(ours.trials).items():
        (view,) = ours.views([trial], pattern)
        image, covered = before_grey(view, pattern, trial=trial)
        frame = cycles.body(pose, angle)
        theirs = frame[:3] * frame[3:] + 0.5 * (1 - frame[3:])
        alpha = frame[3].flatten()
        difference = (theirs - image).flatten(1).double()
        either.append(difference[:, (covered > 0) | (alpha > 0)].flatten())
        both.append(difference[:, (covered > 1 - 1e-4) & (alpha == 1)].flatten())
    shown, inside = torch.cat(either), torch.cat(both)
    rms = lambda values: float((values**2).mean().sqrt()) if len(values) else 0.0
    return {"rms": rms(shown), "inside": rms(inside), "bias": float(shown.mean()) if len(shown) else 0.0}
