"""Make a PEOPLE file of a folder of photographs: masks and keypoints by torchvision's own models, in COCO's format.

    python examples/people_file.py PHOTOS --out PHOTOS/people.json

Fetches the official weights of Keypoint R-CNN and Mask R-CNN (ResNet-50, COCO; BSD-3-Clause code) at the first use.
Photographs show real people: measure, publish no faces, identify nobody.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageOps
from torch import Tensor, nn

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")
SURE = 0.9
"""Least score of a person's box."""
SEEN = 2.0
"""Least score of a keypoint (torchvision's heat maps) that counts as seen."""
SAME = 0.5
"""Overlap of boxes from which mask and keypoints are one person's."""


def run_lengths(mask: np.ndarray) -> list[int]:
    """COCO's uncompressed run lengths: by column, zeros first."""
    flat = np.concatenate([[False], mask.T.ravel(), [True]])
    ends = np.flatnonzero(flat[1:] != flat[:-1])
    counts = np.diff(np.concatenate([[0], ends]))
    return [*counts.tolist(), int(mask.size - counts.sum())]


def overlap(a: Tensor, b: Tensor) -> float:
    """Intersection over union of two xyxy boxes."""
    inside = (torch.minimum(a[2:], b[2:]) - torch.maximum(a[:2], b[:2])).clamp(min=0).prod()
    return float(inside / ((a[2:] - a[:2]).prod() + (b[2:] - b[:2]).prod() - inside))


@torch.no_grad()
def people_of(image: Tensor, keypoints: nn.Module, masks: nn.Module) -> list[dict]:
    """Annotations of one photograph [3, H, W] in [0, 1], without ids."""
    posed, cut = keypoints([image])[0], masks([image])[0]
    persons = [
        k
        for k, (label, score) in enumerate(zip(cut["labels"], cut["scores"], strict=True))
        if label == 1 and score > SURE
    ]
    found = []
    for box, score, points, sure in zip(
        *(posed[k] for k in ("boxes", "scores", "keypoints", "keypoints_scores")), strict=True
    ):
        best = max(persons, key=lambda k: overlap(box, cut["boxes"][k]), default=None)
        if score < SURE or best is None or overlap(box, cut["boxes"][best]) < SAME:
            continue
        mask = (cut["masks"][best, 0] > 0.5).numpy()
        if not mask.any():
            continue
        y, x = np.nonzero(mask)
        seen = torch.where(sure > SEEN, 2.0, 0.0)
        found.append(
            {
                "category_id": 1,
                "iscrowd": 0,
                "bbox": [int(x.min()), int(y.min()), int(np.ptp(x)) + 1, int(np.ptp(y)) + 1],
                "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
                "keypoints": torch.cat([points[:, :2], seen[:, None]], dim=1).ravel().tolist(),
            }
        )
    return found


def people_file(folder: Path, keypoints: nn.Module, masks: nn.Module) -> dict:
    """The whole file's content."""
    images, annotations = [], []
    for path in sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES):
        picture = ImageOps.exif_transpose(Image.open(path)).convert("RGB")
        images.append({"id": len(images) + 1, "file_name": path.name, "width": picture.width, "height": picture.height})
        tensor = torch.from_numpy(np.array(picture)).permute(2, 0, 1).float() / 255
        for record in people_of(tensor, keypoints, masks):
            annotations.append({"id": len(annotations) + 1, "image_id": images[-1]["id"]} | record)
    return {"images": images, "annotations": annotations, "categories": [{"id": 1, "name": "person"}]}


def main() -> None:
    """Read the options, load both models, write the file."""
    from torchvision.models.detection import keypointrcnn_resnet50_fpn, maskrcnn_resnet50_fpn_v2

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("photos", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    record = people_file(
        given.photos,
        keypointrcnn_resnet50_fpn(weights="DEFAULT").eval(),
        maskrcnn_resnet50_fpn_v2(weights="DEFAULT").eval(),
    )
    given.out.write_text(json.dumps(record))
    print(f"{given.out}: {len(record['annotations'])} people in {len(record['images'])} photographs")


if __name__ == "__main__":
    main()
