"""Views as sparse matrices: their weights, what is kept, and how they are baked."""

import dataclasses

import numpy as np
import pytest
import torch
from bodies_made import sphere

from cloak_core.core.cameras import Camera
from cloak_core.core.visibility.normals import NormalOperator
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.core.visibility.torch.matrix import shade
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies import view_cache
from cloak_core.sources.bodies.view_cache import ViewCache

CAMERA = Camera(distance=4.0, azimuth=20.0, width=60, height=50)
FLAT = Light(ambient=1.0, diffuse=0.0, specular=0.0)


def dense(view, face_count: int) -> np.ndarray:
    matrix = np.zeros((len(view.pixels), face_count))
    row = np.repeat(np.arange(len(view.pixels)), view.map.crow.diff().numpy())
    np.add.at(matrix, (row, view.map.column.numpy()), view.map.weight.numpy())
    return matrix


@pytest.mark.parametrize("samples", [1, 4, 16, 64])
def test_weights_are_shares_of_the_pixel_under_flat_light(samples: int) -> None:
    view = ViewCache(sphere(), RenderSettings(light=FLAT, samples=samples)).view(0, CAMERA)
    weight = dense(view, sphere().face_count)
    np.testing.assert_allclose(weight.sum(1), view.coverage.numpy(), rtol=1e-5)
    np.testing.assert_allclose(weight * samples, np.round(weight * samples), atol=1e-3)
    assert (view.pixels.diff() > 0).all() and (view.specular == 0).all()
    assert 0 < view.coverage.min() and view.coverage.max() == 1


def test_the_camera_orbits() -> None:
    """Azimuth 90 looks from +x: what faces +x is in the middle, and +z is to the left."""
    marks = np.array([[0.0, 0, 1], [0.0, 1, 0], [1.0, 0, 0]])
    triangles = np.eye(3)[None] * 0.1
    vertices = (marks[:, None] + triangles - triangles.mean(1, keepdims=True)).reshape(1, -1, 3)
    bodies = Bodies(vertices=vertices, triangles=np.arange(9).reshape(3, 3))
    camera = Camera(distance=4.0, elevation=0.0, azimuth=90.0, width=99, height=99, pivot=(0.0, 0.0, 0.0))
    view = ViewCache(bodies, RenderSettings(light=FLAT, samples=1)).view(0, camera)
    places = {}
    for row, face in enumerate(view.map.column.tolist()):
        places.setdefault(face, []).append(divmod(int(view.pixels[row]), 99))
    y, x = np.array([np.mean(places[face], 0) for face in range(3)]).T
    assert x[0] < 40 and abs(y[0] - 49) < 2, "+z to the left"
    assert abs(x[1] - 49) < 2 and y[1] < 40, "+y on top"
    assert abs(x[2] - 49) < 2 and abs(y[2] - 49) < 2, "+x in the middle"


def test_dropping_back_faces_changes_nothing_on_a_closed_body(monkeypatch: pytest.MonkeyPatch) -> None:
    bodies = sphere(20, 30)
    culled = ViewCache(bodies, RenderSettings(samples=4))
    assert culled._outward.all()
    both = ViewCache(bodies, RenderSettings(samples=4))
    both._outward[:] = False
    for camera in (CAMERA, Camera(distance=1.2, width=40, height=40), Camera(distance=3.0, near=2.5)):
        one, two = culled.view(0, camera), both.view(0, camera)
        assert len(one.pixels) > 10
        for left, right in ((one, two), (one.map, two.map)):
            for name, value in vars(left).items():
                if isinstance(value, torch.Tensor):
                    assert torch.equal(value, getattr(right, name)), name


def test_views_do_not_depend_on_what_they_are_built_with(monkeypatch: pytest.MonkeyPatch) -> None:
    bodies = sphere(poses=3)
    keys = [(pose, dataclasses.replace(CAMERA, azimuth=float(a))) for pose in range(3) for a in (0, 120)]
    together = ViewCache(bodies, RenderSettings(samples=4)).views(keys)
    for key, view in zip(keys, together, strict=True):
        alone = ViewCache(bodies, RenderSettings(samples=4)).view(*key)
        assert torch.equal(alone.pixels, view.pixels) and torch.equal(alone.map.column, view.map.column)
        torch.testing.assert_close(alone.map.weight, view.map.weight, rtol=0, atol=1e-6)
    monkeypatch.setattr(view_cache, "BAND_SAMPLES", {"cpu": 500})
    for key, view in zip(keys, together, strict=True):
        banded = ViewCache(bodies, RenderSettings(samples=4)).view(*key)
        assert torch.equal(banded.pixels, view.pixels) and torch.equal(banded.coverage, view.coverage)
        torch.testing.assert_close(banded.map.weight, view.map.weight, rtol=0, atol=1e-6)


def test_polygons_merge_their_triangles() -> None:
    whole = sphere()
    pairs = Bodies(
        vertices=whole.vertices, triangles=whole.triangles, triangle_face=np.arange(whole.triangle_count) // 2
    )
    view = ViewCache(pairs, RenderSettings(light=FLAT, samples=16)).view(0, CAMERA)
    split = dense(ViewCache(whole, RenderSettings(light=FLAT, samples=16)).view(0, CAMERA), whole.face_count)
    row = np.repeat(np.arange(len(view.pixels)), view.map.crow.diff().numpy())
    entries = np.stack([row, view.map.column.numpy()], -1)
    assert len(np.unique(entries, axis=0)) == len(entries)
    np.testing.assert_allclose(dense(view, pairs.face_count), split[:, ::2] + split[:, 1::2], atol=1e-6)


def test_light_never_gives_nan() -> None:
    zero, point = torch.zeros(3, 2), torch.tensor([[0.0, 0], [0, 0], [1, 0]])
    for light_position in (zero, point):
        for values in shade(point, zero, light_position, Light()) + shade(point, point, light_position, Light()):
            assert torch.isfinite(values).all()


def test_vertex_normals_of_a_sphere_point_outward() -> None:
    bodies = sphere(20, 30)
    vertices = torch.from_numpy(bodies.vertices[0].T.astype(np.float64)).contiguous()
    normals = NormalOperator(torch.from_numpy(bodies.triangles.T.astype(np.int64)).contiguous(), bodies.vertex_count)(
        vertices
    )
    assert ((normals * vertices).sum(0) > 0.99).all()
    loose = NormalOperator(torch.zeros(3, 1, dtype=torch.int64), 2)(torch.ones(3, 2, dtype=torch.float64))
    assert (loose == 0).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"distance": 0.0}, "distance"), ({"azimuth": float("nan")}, "azimuth"), ({"field_of_view": 180.0}, "180"),
     ({"width": 0}, "0 x 416"), ({"near": -1.0}, "near"), ({"pivot": (0.0, float("inf"), 0.0)}, "pivot y")],
)  # fmt: skip
def test_cameras_refuse_what_makes_no_picture(arguments: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Camera(**arguments)


def test_bad_requests_are_named() -> None:
    cache = ViewCache(sphere(), RenderSettings(samples=1))
    with pytest.raises(InputError, match="pose 1: the scene has 1"):
        cache.view(1, CAMERA)
    with pytest.raises(InputError, match="outfit 2: the scene has 2"):
        cache.bake(0, CAMERA, [0], outfit=2)
    with pytest.raises(Exception, match="samples"):  # an InputError, or the type check that pytest switches on
        ViewCache(sphere(), RenderSettings(samples=3))


def test_a_device_gets_exact_areas_that_the_cpu_worked_out() -> None:
    """No kernel of the device is asked: one that only knows shapes stands for it."""
    key = (0, Camera(width=11, height=9, distance=3.0))
    here = ViewCache(sphere()).view(*key)
    cache = ViewCache(sphere(), RenderSettings(device="meta"))
    there = cache.view(*key)
    tensors = [there.pixels, there.coverage, there.specular, there.map.crow, there.map.column, there.map.weight]
    assert cache.works_on.type == "cpu" and {tensor.device.type for tensor in tensors} == {"meta"}
    assert len(there.map) == len(here.map) > 5


def test_a_view_that_is_on_its_device_stays_itself_and_keeps_its_transpose() -> None:
    view = ViewCache(sphere()).bake(0, Camera(width=11, height=9, distance=3.0), [0, 1, 2])
    transposed = view.map.transposed
    assert view.to(torch.device("cpu")) is view and view.map.transposed is transposed
    moved = view.to(torch.device("meta"))
    assert {moved.pixels.device.type, moved.base_color.device.type, moved.map.weight.device.type} == {"meta"}
    assert moved.front_count == view.front_count and moved.box == view.box
