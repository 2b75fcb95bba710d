"""Clean recall and false alarms, counted on a detector whose answers are known."""

import numpy as np
import pytest
import torch

from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.studies.clean import check_scene, clean_renders


class RedDetector(Detector):
    """Reports a person with the share of red pixels, times 100."""

    def __init__(self) -> None:
        super().__init__("red", "red")

    def detect(self, images):
        red = (images[:, 0] > 0.3) & (images[:, 1:].amax(1) < 0.05)
        score = (100 * red.float().mean((1, 2))).clamp(max=1)
        return Detections(torch.zeros(len(images), 1, 4), score[:, None])


def body() -> Bodies:
    """A tetrahedron a metre wide; poses 0 and 1 stand before the camera, pose 2 lies edge-on, thinner than a pixel."""
    corners = np.array([[-0.5, 0, 0], [0.5, 0, 0], [0, 1, 0], [0, 0.3, -0.5]], np.float32)
    poses = np.stack([corners, corners * 0.8, corners * [0.001, 1, 0.001]])
    triangles = np.array([[0, 1, 2], [1, 0, 3], [1, 3, 2], [0, 2, 3]])
    red = np.zeros((2, 4, 3))
    red[0, :, 0] = 1  # the first outfit; the second is black
    return Bodies(vertices=poses, triangles=triangles, face_colors=red)


def places(red: int, count: int) -> Backgrounds:
    def draw(index: int, height: int, width: int) -> np.ndarray:
        return np.full((height, width, 3), (255, 0, 0) if index < red else (200, 200, 200), np.uint8)

    return Backgrounds([str(i) for i in range(count)], draw)


def test_every_body_at_every_angle_counts_once_per_image():
    result = check_scene(RedDetector(), body(), places(0, 5), (0.0, 10.0), images_per_view=3)
    own = {"operating_point": 0.5, "operating_point_assumed": True, "clean_recall_own": 2 / 3, "false_alarms_own": 0.0}
    assert result == {"clean_recall": 2 / 3, "false_alarms": 0.0, "n": 18, "backgrounds": 5, "alarms": []} | own


def test_false_alarms_are_counted_on_bare_backgrounds_and_the_detectors_own_point_beside():
    detector = RedDetector()
    detector.operating_point = 1.0  # it never says more
    result = check_scene(detector, body(), places(2, 8), (0.0,), images_per_view=1)
    assert result["clean_recall_own"] == result["false_alarms_own"] == 0 < result["clean_recall"]
    assert result["false_alarms"] == 0.25 and result["n"] == 3
    assert result["alarms"] == [{"background": name, "score": 1.0} for name in ("0", "1")]


@pytest.mark.slow
def test_renders_to_check_detectors_on():
    images = clean_renders(3, (40, 64))
    assert images.shape == (3, 3, 40, 64) and images.dtype == torch.uint8 and len(images.unique()) > 50
    assert torch.equal(images, clean_renders(3, (40, 64))) and not torch.equal(images[0], images[1])
    assert clean_renders(0, (40, 64)).shape == (0, 3, 40, 64)
