"""Triton kernels against the torch operations that they stand for: interpreted on the CPU, and compiled for a card."""

import re
import subprocess
import sys

import pytest
import torch
from bodies_made import soup, sphere

from cloak_core.core.cameras import Camera
from cloak_core.core.view import View
from cloak_core.core.visibility import compiled
from cloak_core.core.visibility.compiled import torch_alone, triton_kernels, use_kernels
from cloak_core.core.visibility.rasterizer import rasterize
from cloak_core.core.visibility.screen import GRID, GUARD
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.sources.bodies.view_cache import ViewCache

pytest.importorskip("triton")
pytestmark = pytest.mark.slow
CAMERA = Camera(distance=2.6, width=11, height=9)


@pytest.fixture(autouse=True)
def interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRITON_INTERPRET", "1")


@pytest.mark.parametrize("extent", [0, 3 * GRID, GUARD // 2])
@pytest.mark.parametrize("grid", [1, 2])
def test_keys_are_the_same_bits(extent: int, grid: int) -> None:
    screen, triangles = soup(extent + grid, extent, 30, (7, 5))
    cull = torch.rand(1, 60, generator=torch.Generator().manual_seed(grid)) < 0.5
    with torch_alone():
        plain = rasterize(screen, triangles, grid, cull)
        with triton_kernels():
            fused = rasterize(screen, triangles, grid, cull)
    assert torch.equal(fused.packed, plain.packed)
    assert len(plain.packed.unique()) > 3


def built(light: Light, camera: Camera) -> View:
    return ViewCache(sphere(4, 6), RenderSettings(light=light, samples=1)).build([(0, camera)])[0]


@pytest.mark.parametrize("shininess", [0.0, 7.0])
def test_light_is_the_same(shininess: float) -> None:
    light = Light(ambient=0.4, diffuse=0.5, specular=0.6, shininess=shininess, position=(2.0, 1.0, 3.0))
    with torch_alone():
        plain = built(light, CAMERA)
        with triton_kernels():
            fused = built(light, CAMERA)
    assert len(plain.map) > 5 and plain.specular.max() > 0.1
    assert torch.equal(fused.map.column, plain.map.column)
    torch.testing.assert_close(fused.map.weight, plain.map.weight, rtol=0, atol=1e-6)
    torch.testing.assert_close(fused.specular, plain.specular, rtol=0, atol=1e-6)


COMPILE = """
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource, compile
from cloak_core.core.visibility import fused

def compiled(function, types, constants, **options):
    names = [parameter.name for parameter in function.params]
    signature = dict(zip(names, types.split())) | dict.fromkeys(constants, "constexpr")
    source = ASTSource(function, signature, constexprs={(names.index(n),): v for n, v in constants.items()})
    return compile(source, target=GPUTarget("cuda", 80, 32), options=options).asm["ptx"]

drawn = "*i64 *i32 *i32 *fp64 *i64 *i64 *i1" + 6 * " i32"
constants = {"DEPTH_BITS": 39, "ID_BITS": 24, "BLOCK": 64}
print(compiled(fused.draw, drawn, constants, **fused.OPTIONS))
lit = "*fp32 *i64 *fp32 *fp64 *fp64 *i64 *fp64 *fp32 *fp32 *fp64" + 3 * " i32" + 6 * " fp32"
compiled(fused.light_all, lit, {"BLOCK": 128}, **fused.NO_FUSION)
"""


def test_kernels_compile_for_a_card_and_round_every_operation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a card: down to its machine code. Depth has a sum of two products, which no instruction may fuse."""
    monkeypatch.delenv("TRITON_INTERPRET")
    done = subprocess.run([sys.executable, "-c", COMPILE], capture_output=True, text=True)
    assert not done.returncode, done.stderr
    assert re.search(r"mul\S*\.f64", done.stdout) and re.search(r"(atom|red)\S*min\.s64", done.stdout)
    assert not re.search(r"fma\S*\.f64", done.stdout)


def test_where_no_kernel_starts_torch_draws_and_a_line_says_so(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def no_compiler(device: torch.device) -> None:
        raise RuntimeError("Failed to find C compiler.\nMore of it.")

    from cloak_core.core.visibility.fused import try_out

    try_out(torch.device("cpu"))  # interpreted
    monkeypatch.setattr("cloak_core.core.visibility.fused.try_out", no_compiler)
    compiled._kernels_start.cache_clear()
    assert not use_kernels(torch.device("cuda")) and not use_kernels(torch.device("cuda"))
    compiled._kernels_start.cache_clear()
    assert [record.message for record in caplog.records] == [
        "Triton's kernels do not start here, torch's operations draw instead: Failed to find C compiler."
    ]
