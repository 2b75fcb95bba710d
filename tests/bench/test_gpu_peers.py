"""CUDA rasterizers beside ours, by stand-ins of their packages: each gets places as that package counts them."""

import sys
from types import ModuleType, SimpleNamespace

import pytest
import torch
from torch import Tensor

from cloak_core.bench.gpu_peers import run_gpu_peers
from cloak_core.bench.growth import sphere
from cloak_core.core.cameras import Camera

CAMERA = Camera(distance=2.6, azimuth=20.0, width=24, height=17)


def nearest(place: Tensor, triangles: Tensor, columns: Tensor, rows: Tensor) -> Tensor:
    """The triangle with the least z at each point, -1 = none; place: [V, 3], x and y of the screen, z linear on it."""
    at = torch.stack(torch.meshgrid(rows, columns, indexing="ij"), -1)[..., [1, 0]].double()
    a, b, c = (place.double()[triangles[:, corner].long()] for corner in range(3))
    cross = lambda u, v: u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    area = cross(b[:, :2] - a[:, :2], c[:, :2] - a[:, :2])
    p = at[:, :, None]
    w0 = cross(b[:, :2] - p, c[:, :2] - p) / area
    w1 = cross(c[:, :2] - p, a[:, :2] - p) / area
    w2 = 1 - w0 - w1
    z = w0 * a[:, 2] + w1 * b[:, 2] + w2 * c[:, 2]
    z = torch.where((w0 >= 0) & (w1 >= 0) & (w2 >= 0), z, torch.inf)
    return torch.where(z.amin(-1).isfinite(), z.argmin(-1), -1)


def of_nvdiffrast(context: object, place: Tensor, triangles: Tensor, resolution: tuple, grad_db: bool) -> tuple:
    """Clip space; the first row is the lowest, at y = -1."""
    (height, width), clip = resolution, place[0]
    screen = torch.cat([clip[:, :2], clip[:, 2:3]], 1) / clip[:, 3:]
    columns = (torch.arange(width) + 0.5) / width * 2 - 1
    rows = (torch.arange(height) + 0.5) / height * 2 - 1
    ids = nearest(screen, triangles, columns, rows) + 1
    return torch.stack([ids * 0.0, ids * 0.0, ids * 0.0, ids.float()], -1)[None], None


def of_drtk(place: Tensor, triangles: Tensor, height: int, width: int) -> Tensor:
    """Pixels, of whose first the middle is (0, 0); z in metres, so that here it is turned over."""
    screen = torch.cat([place[0, :, :2], -1 / place[0, :, 2:]], 1)
    return nearest(screen, triangles, torch.arange(width), torch.arange(height))[None].int()


@pytest.fixture
def stand_ins(monkeypatch: pytest.MonkeyPatch) -> None:
    package, own = ModuleType("nvdiffrast"), ModuleType("nvdiffrast.torch")
    own.RasterizeCudaContext = lambda device: SimpleNamespace()
    own.rasterize = of_nvdiffrast
    drtk = ModuleType("drtk")
    drtk.rasterize = of_drtk
    for name, module in (("nvdiffrast", package), ("nvdiffrast.torch", own), ("drtk", drtk)):
        monkeypatch.setitem(sys.modules, name, module)


@pytest.mark.usefixtures("stand_ins")
def test_peers_see_what_we_see() -> None:
    records = run_gpu_peers(sphere(300), CAMERA, "cpu", repeats=1)
    assert set(records) == {"nvdiffrast.torch", "drtk"}
    for record in records.values():
        assert record["other"] < 0.02 and record["visibility_ms"]["median"] > 0 and record["step_ms"]["median"] > 0


def test_a_peer_that_is_not_installed_is_said_to_be_not_run() -> None:
    records = run_gpu_peers(sphere(60), CAMERA, "cpu", repeats=1)
    assert all("No module named" in record["not_run"] for record in records.values())
