import math

import numpy as np
import pytest

from cloak_core.core.cameras import Camera
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.meshes.subdivision import projected_areas, resolution
from tests.sources.bodies.solids import cube


def test_the_front_of_a_cube_has_the_area_that_its_distance_gives() -> None:
    camera = Camera(distance=3.0, elevation=0.0, width=400, height=400)
    areas = projected_areas(cube(), camera)
    focal = 200 / math.tan(math.radians(30))
    assert areas[5] == pytest.approx((focal / 2.5) ** 2)  # the front is half a metre nearer than the pivot
    assert np.allclose(areas[[0, 1, 2, 3, 4]], 0)


def test_a_camera_inside_the_body_is_refused() -> None:
    with pytest.raises(InputError, match="behind the camera"):
        resolution(cube(), Camera(distance=0.3))
