"""Shows every picture and every frame to every detector, and keeps what they say of everybody in it."""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32, UInt8
from PIL import Image, ImageOps

from cloak_core.detectors.protocol import Detections, Detector
from cloak_core.detectors.scoring import max_person_score, person_boxes
from cloak_core.evaluation.inference import OnProgress, max_score_on
from cloak_core.evaluation.photographs.listing import WITH, WITHOUT, Subject
from cloak_core.evaluation.photographs.settings import JudgeSettings
from cloak_core.files.errors import InputError
from cloak_core.scene import videos
from cloak_core.scene.pictures import open_picture

THUMBNAIL = 480
"""Longer side of what is kept of a picture for the report, pixels."""
MOST_THUMBNAILS = 2000
_log = logging.getLogger("cloak")


@dataclass(frozen=True, eq=False)
class Picture:
    """One photograph, or one frame of a video, as it was shown to the detectors."""

    file: str
    frame: int
    """0 for photographs."""
    width: int
    height: int
    scale: float
    """Of the file's pixels."""
    boxes: dict[str, list[list[float]]]
    """By detector: x1, y1, x2, y2, score above the lower of both thresholds, best first, pixels as shown."""
    thumbnail: bytes
    """JPEG; empty where there are too many."""


@dataclass(frozen=True, eq=False)
class Looks:
    """What D detectors say of N subjects, each in one picture."""

    specs: tuple[str, ...]
    own: tuple[float, ...]
    """The detectors' own thresholds."""
    subjects: list[Subject]
    pictures: list[Picture]
    picture: list[int]
    """Of each subject, among the pictures."""
    score: Float32[np.ndarray, "D N"]
    """The best score of a person: on the subject's box where one is told, anywhere in the picture where not."""
    skipped: list[str]
    """What could not be read, a line for each."""


@torch.no_grad()
def look(
    folder: Path,
    subjects: Sequence[Subject],
    detectors: Mapping[str, Detector],
    settings: JudgeSettings,
    on_progress: OnProgress | None = None,
) -> Looks:
    """Read every file once and show it. A file that cannot be read is named in a warning and left out.

    InputError: none with or without the cloak can be read.
    """
    by_file: dict[str, list[Subject]] = {}
    for subject in subjects:
        by_file.setdefault(subject.file, []).append(subject)
    kept, pictures, place, scores, skipped = [], [], [], [], []
    for done, (file, people) in enumerate(by_file.items()):
        before = len(kept), len(pictures)
        try:
            for number, (image, scale) in enumerate(read(folder / file, settings)):
                found = {spec: detector(_tensor(image, detector)) for spec, detector in detectors.items()}
                room = len(pictures) < MOST_THUMBNAILS
                pictures.append(
                    _picture((file, number * settings.every), image, scale, found, detectors, settings, room)
                )
                for person in people:
                    kept.append(person)
                    place.append(len(pictures) - 1)
                    scores.append([_score(found[spec], person, scale, settings.iou) for spec in detectors])
        except InputError as error:
            del kept[before[0] :], place[before[0] :], scores[before[0] :], pictures[before[1] :]  # half a video
            skipped.append(str(error).removeprefix(f"{folder}/"))  # others need not know where it lay
            _log.warning("%s; skipped", error)
        if on_progress:
            on_progress(done + 1, len(by_file))
    if not any(one.garment in (WITH, WITHOUT) for one in kept):
        worn = {one.file for one in subjects if one.garment in (WITH, WITHOUT)}
        raise InputError(f"{folder}: none of its {len(worn)} pictures with or without the cloak can be read")
    own = tuple(float(detector.operating_point) for detector in detectors.values())
    score = np.array(scores, np.float32).T.reshape(len(detectors), len(kept))
    return Looks(tuple(detectors), own, kept, pictures, place, score, skipped)


def read(path: Path, settings: JudgeSettings) -> Iterator[tuple[UInt8[np.ndarray, "h w 3"], float]]:
    """The photograph, or every so many-th frame of the video, upright and reduced; and by how much."""
    if path.suffix.lower() in videos.SUFFIXES:
        for frame in videos.read_frames(path, settings.every, settings.most_frames):
            yield _reduced(Image.fromarray(frame), settings.longest)
    else:
        with open_picture(path) as picture:
            upright = ImageOps.exif_transpose(picture).convert("RGB")
        yield _reduced(upright, settings.longest)


def _reduced(picture: Image.Image, longest: int) -> tuple[np.ndarray, float]:
    scale = min(1.0, longest / max(picture.size))
    if scale < 1:
        size = tuple(max(1, round(side * scale)) for side in picture.size)
        picture = picture.resize(size, Image.Resampling.BOX if scale < 0.5 else Image.Resampling.LANCZOS)
    return np.array(picture), scale


def _tensor(image: np.ndarray, detector: Detector) -> torch.Tensor:
    pixels = torch.from_numpy(image).to(detector.device)
    return pixels.permute(2, 0, 1)[None].float() / 255


def _score(found: Detections, subject: Subject, scale: float, iou: float) -> float:
    if subject.box is None:
        return float(max_person_score(found)[0])
    box = torch.tensor([subject.box], dtype=torch.float32) * scale
    return float(max_score_on(found, box, iou)[0])


def _picture(
    named: tuple[str, int],
    image: np.ndarray,
    scale: float,
    found: Mapping[str, Detections],
    detectors: Mapping[str, Detector],
    settings: JudgeSettings,
    room: bool,
) -> Picture:
    """What is kept of a picture."""
    boxes = {
        spec: person_boxes(found[spec], min(settings.threshold, detector.operating_point))[0].tolist()
        for spec, detector in detectors.items()
    }
    data = io.BytesIO()
    if room:
        small = Image.fromarray(image)
        small.thumbnail((THUMBNAIL, THUMBNAIL))
        small.save(data, "JPEG", quality=88)
    return Picture(*named, image.shape[1], image.shape[0], scale, boxes, data.getvalue())
