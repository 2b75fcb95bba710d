"""A cached render and its gradient on a device that is not there: no tensor of the CPU slips in, nothing waits.

torch has neither sparse products nor autograd's streams nor random numbers for such a device: dense matrices of the
same sizes stand in for ours, the gradient's own function is called, and there is no noise.
"""

from collections.abc import Iterator
from dataclasses import fields, replace

import pytest
import torch
from bodies_made import sphere
from torch import Tensor
from torch._subclasses.fake_tensor import DataDependentOutputException, FakeTensorMode

from cloak_core.core.cameras import Camera
from cloak_core.core.linear import SparseMap
from cloak_core.core.paint import Canvas
from cloak_core.core.view import BakedView
from cloak_core.core.visibility.compiled import torch_alone, triton_kernels
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.core.visibility.torch import painting
from cloak_core.sources.bodies.view_cache import ViewCache


@pytest.fixture(autouse=True)
def dense(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    real = SparseMap.matrix.func

    def matrix(applied: SparseMap) -> Tensor:
        if applied.weight.device.type == "cpu":
            return real(applied)
        assert applied.crow.device == applied.column.device == applied.weight.device
        return torch.empty(applied.height, applied.width, device=applied.weight.device)

    monkeypatch.setattr(SparseMap, "matrix", property(matrix))
    painting._columns.cache_clear()
    yield
    painting._columns.cache_clear()


def on_device(view: BakedView) -> BakedView:
    """The view's shapes as tensors of a CUDA device; to be called within a FakeTensorMode."""
    fake = lambda t: torch.empty(t.shape, dtype=t.dtype, device="cuda")
    moved = {f.name: fake(value) for f in fields(view) if isinstance(value := getattr(view, f.name), Tensor)}
    fake_map = lambda one: SparseMap(fake(one.crow), fake(one.column), fake(one.weight), one.width)
    worn = fake_map(view.map)
    worn.__dict__["transposed"] = fake_map(view.map.transposed)  # kept with the view, made once
    return replace(view, map=worn, **moved)


def render(shifted: bool, device: str = "cuda") -> None:
    camera, body = Camera(distance=3.0, width=40, height=30), sphere()
    with torch_alone(), triton_kernels(wanted=False):  # painting has no kernels
        view = ViewCache(body, RenderSettings(light=Light(color=(1.0, 0.9, 0.8)))).bake(
            0, camera, list(range(0, body.face_count, 2))
        )
        _ = view.map.transposed
        with FakeTensorMode():
            make = lambda *shape: torch.rand(shape, device=device)
            colors = make(view.map.width, 3)
            shifts = torch.zeros(2, 2, dtype=torch.int64, device=device) if shifted else None
            canvas = Canvas.of([on_device(view)] * 2, make(2 * 30 * 40 + 1, 3), shifts)
            kept = canvas.logo.paint(colors, canvas.base, canvas.target, canvas.rows)
            gradient = canvas.logo.gradient(kept, make(2, 3, 30, 40), colors.shape)
            assert canvas.rows.device.type == gradient.device.type == "cuda" and gradient.shape == colors.shape


@pytest.mark.parametrize("shifted", [False, True])
def test_a_cached_render_stays_on_its_device(shifted: bool) -> None:
    render(shifted)


def test_what_lies_on_the_cpu_or_waits_is_noticed() -> None:
    with pytest.raises(RuntimeError, match="device"):
        render(True, "cpu")
    with FakeTensorMode(), pytest.raises(DataDependentOutputException):
        torch.ones(1, device="cuda").item()
