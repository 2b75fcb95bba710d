"""Face ids, images and colour gradients against PyTorch3D's on the bench scene."""

import numpy as np
import pytest
import torch

from cloak_core.core.cameras import Camera
from cloak_core.core.paint import compose
from cloak_core.core.visibility.screen import DEPTH_BITS, ID_BITS, LIMIT
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.exchange.scenes import read_scene
from cloak_core.sources.bodies.view_cache import ViewCache

CAMERA = Camera(azimuth=-10.0)
LIGHTS = {"front": (0.5, 1.5, 2.5), "default": (0.0, 1.0, 0.0)}


@pytest.fixture(scope="module")
def golden(shared) -> dict[str, np.ndarray]:
    with np.load(shared / "data" / "golden" / "pytorch3d_az-10.npz", allow_pickle=False) as archive:
        return dict(archive)


@pytest.fixture(scope="module", params=LIGHTS)
def lit(request, shared) -> tuple[str, ViewCache]:
    bodies = read_scene(shared / "data" / "bench_scene.npz")
    return request.param, ViewCache(bodies, RenderSettings(light=Light(position=LIGHTS[request.param]), samples=1))


def test_face_ids_and_depth(lit, golden) -> None:
    view_cache = lit[1]
    key = [(0, CAMERA)]
    visibility = view_cache.visibility(key, view_cache.screen(key))
    ids = visibility.triangles()[0, :, :, 0].numpy()
    same = ids == golden["face_id"]
    assert same.mean() >= 0.9999
    w = visibility.window
    inside = (same & (ids >= 0))[w.y0 : w.y1, w.x0 : w.x1]
    inverse_depth = (LIMIT - (visibility.packed[0].numpy()[inside] >> ID_BITS)) / (1 << DEPTH_BITS)
    depth = CAMERA.near_plane / inverse_depth
    np.testing.assert_allclose(depth, golden["depth"][w.y0 : w.y1, w.x0 : w.x1][inside], rtol=1e-5)


def test_image_before_clamping_and_gradient(lit, golden) -> None:
    """All faces at once, straight from the view's matrix, on white."""
    name, view_cache = lit
    bodies, view = view_cache.bodies, view_cache.view(0, CAMERA)
    image = np.ones((416 * 416, 3), np.float32)
    row = np.repeat(np.arange(len(view.pixels)), view.map.crow.diff().numpy())
    weight = view.map.weight.numpy()[:, None]
    body = np.repeat(view.specular.numpy()[:, None], 3, 1)
    np.add.at(body, row, weight * bodies.face_colors[0][view.map.column.numpy()])
    image[view.pixels.numpy()] = body
    expected = golden[f"image_light_{name}"].reshape(-1, 3)
    assert np.abs(image - expected).max() < 2e-4
    upstream = golden["grad_out"].reshape(-1, 3)[view.pixels.numpy()]
    gradient = np.zeros((bodies.face_count, 3))
    np.add.at(gradient, view.map.column.numpy(), weight * upstream[row])
    expected = golden[f"grad_light_{name}"]
    assert np.linalg.norm(gradient - expected) / np.linalg.norm(expected) < 1e-3
    seen = np.unique(view.map.column.numpy())
    np.testing.assert_allclose(gradient[seen], expected[seen], rtol=1e-3, atol=1e-5)


def test_composed_image_and_its_gradient(lit, golden) -> None:
    """The same through `compose`, all faces being the logo."""
    name, view_cache = lit
    faces = np.arange(view_cache.bodies.face_count)
    colors = torch.from_numpy(view_cache.bodies.face_colors[0].copy()).requires_grad_()
    image = compose([view_cache.bake(0, CAMERA, faces)], colors, torch.ones(1, 3, 416, 416))
    expected = torch.from_numpy(golden[f"image_light_{name}"]).permute(2, 0, 1)
    assert (image[0] - expected.clamp(0, 1)).abs().max() < 2e-4
    image.backward(torch.from_numpy(golden["grad_out"]).permute(2, 0, 1).unsqueeze(0))
    # A pixel that the clamp cut passes nothing on; the golden gradient is from before clamping.
    clamped = ((expected < 0) | (expected > 1)).any(0)
    seen = np.setdiff1d(np.unique(golden["face_id"][~clamped.numpy()]), golden["face_id"][clamped.numpy()])
    seen = seen[seen >= 0]
    expected_gradient = golden[f"grad_light_{name}"][seen]
    np.testing.assert_allclose(colors.grad.numpy()[seen], expected_gradient, rtol=1e-3, atol=1e-5)
