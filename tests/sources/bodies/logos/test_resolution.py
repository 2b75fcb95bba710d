import math

import numpy as np
import pytest

from cloak_core.core.cameras import Camera
from cloak_core.sources.bodies.logos.resolution import projected_areas, resolution
from cloak_core.sources.bodies.meshes.subdivision import subdivide
from tests.sources.bodies.solids import cube, sphere


def test_the_front_of_a_cube_has_the_area_that_its_distance_gives() -> None:
    camera = Camera(distance=3.0, elevation=0.0, width=400, height=400)
    areas = projected_areas(cube(), camera)
    focal = 200 / math.tan(math.radians(30))
    assert areas[5] == pytest.approx((focal / 2.5) ** 2)  # the front is half a metre nearer than the pivot
    assert np.allclose(areas[[0, 1, 2, 3, 4]], 0)


def test_coarse_faces_call_for_a_level_and_fine_ones_for_none() -> None:
    body, camera = sphere(80, 40), Camera(distance=3.0)
    near, far = resolution(body, camera), resolution(body, Camera(distance=200.0))
    assert near["level"] == 2 and "level 2 makes it" in near["hint"]
    assert far["under_fine"] > 0.5 and far["level"] == 0 and "gains nothing" in far["hint"]
    again = resolution(subdivide(body)[0], camera)
    assert again["median"] == pytest.approx(near["median"] / 4, rel=0.1) and again["level"] == 1
    enough = resolution(subdivide(body, 2)[0], camera)
    assert enough["level"] == 0 and "fine enough" in enough["hint"]
