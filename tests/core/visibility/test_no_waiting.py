"""On a device nothing of a cached render may wait for it: what its operations are, seen on the CPU."""

import torch
from bodies_made import sphere
from torch.utils._python_dispatch import TorchDispatchMode

from cloak_core.core.cameras import Camera
from cloak_core.core.paint import compose
from cloak_core.core.visibility.compiled import torch_alone
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.sources.bodies.view_cache import ViewCache

WAITS = {
    "_local_scalar_dense", "nonzero", "masked_select", "_unique2", "unique_consecutive", "unique_dim", "bincount",
    "equal", "is_nonzero", "histc", "index",
}  # fmt: skip
"""Operations whose result's size, or the Python number they return, depends on data: the host waits for those.
`index` does where a mask is among the indices; none is used here."""


class Recorder(TorchDispatchMode):
    """The names of all operations within."""

    def __init__(self) -> None:
        super().__init__()
        self.names: list[str] = []

    def __torch_dispatch__(self, func: object, types: object, args: tuple = (), kwargs: dict | None = None) -> object:
        self.names.append(func.overloadpacket.__name__)
        if func.overloadpacket.__name__ == "repeat_interleave" and (kwargs or {}).get("output_size") is None:
            self.names.append("repeat_interleave without output_size, which is nonzero's kind")
        return func(*args, **kwargs or {})


def test_a_cached_render_and_its_gradient_never_wait() -> None:
    body, cameras = sphere(), [Camera(distance=3.0, width=40, height=30, azimuth=azimuth) for azimuth in (0.0, 40.0)]
    logo = list(range(0, body.face_count, 2))
    colors = torch.full((len(logo), 3), 0.5, requires_grad=True)
    shifts = torch.tensor([[3, 2], [-30, 0]])
    with torch_alone():
        cache = ViewCache(body, RenderSettings(light=Light(color=(1.0, 0.9, 0.8))))
        views = [cache.bake(0, camera, logo) for camera in cameras]
        for view in views:  # kept with the view, like it made once
            _ = view.map.transposed
        for shift in (None, shifts):
            background = torch.rand(2, 3, 30, 40)
            upstream = torch.rand(2, 3, 30, 40)
            with Recorder() as recorder:
                compose(views, colors, background, shift).backward(upstream)
            assert not WAITS & set(recorder.names)
            assert not [name for name in recorder.names if "without" in name]
            assert {"index_select", "scatter_"} <= set(recorder.names)
    assert colors.grad.abs().sum() > 0


def test_the_recorder_sees_what_waits() -> None:
    with Recorder() as recorder:
        torch.arange(3).nonzero()
        torch.ones(1).item()
        torch.arange(3)[torch.tensor([True, False, True])]
    assert {"nonzero", "_local_scalar_dense", "index"} <= set(recorder.names)
