"""Other renderers for `cloak bench accuracy`; the extra `peers` installs them.

A peer says which triangle is seen at every sample, our own shading does the rest: all are compared by the same figures,
and a difference in an image is a difference in visibility.
"""

from __future__ import annotations

import importlib.metadata
import os
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float32, Int32, Int64

from cloak_core.core.cameras import Camera, Vector
from cloak_core.core.view import Screen, View, Visibility, Window
from cloak_core.core.visibility.rasterizer import bounding_window
from cloak_core.core.visibility.screen import DEPTH_BITS, EMPTY, ID_BITS
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.bodies.view_cache import Key, ViewCache


@dataclass(frozen=True)
class Target:
    """What to look at: the samples, n x n to a pixel, of a window of a camera's image."""

    camera: Camera
    pivot: Vector
    n: int
    window: Window
    cull: bool
    """Whether triangles that show their back may be dropped: the body is closed, nothing cuts it open."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of samples."""
        return (self.window.y1 - self.window.y0) * self.n, (self.window.x1 - self.window.x0) * self.n

    def rays(self) -> tuple[Float32[np.ndarray, "N 3"], Float32[np.ndarray, "N 3"]]:
        """Origins on the near plane and directions (of length 1 along the optical axis) through all samples."""
        rows, columns = self.shape
        x = (self.window.x0 + (np.arange(columns) + 0.5) / self.n - self.camera.width / 2) / self.camera.focal
        y = (self.camera.height / 2 - self.window.y0 - (np.arange(rows) + 0.5) / self.n) / self.camera.focal
        directions = np.empty((rows, columns, 3), np.float32)
        for axis, (right, up, back) in enumerate(zip(*self.camera.axes, strict=True)):
            directions[..., axis] = np.add.outer((y * up - back).astype(np.float32), (x * right).astype(np.float32))
        origins = directions * np.float32(self.camera.near_plane)
        origins += np.array(self.camera.position(self.pivot), np.float32)
        return origins.reshape(-1, 3), directions.reshape(-1, 3)


class Peer(ABC):
    """A renderer of one topology. Making one raises `ImportError` where its package or a library of it is missing."""

    module: ClassVar[str]
    """What is imported; also the peer's name in reports."""

    @abstractmethod
    def __init__(self, triangles: Int64[np.ndarray, "T 3"], threads: int) -> None: ...

    @abstractmethod
    def pose(self, vertices: Float32[np.ndarray, "V 3"]) -> None:
        """Take a pose and do all that is done once for it, such as building a tree."""

    @abstractmethod
    def aim(self, target: Target) -> None:
        """Take a view and do what can be done before the pose is looked at, such as making rays."""

    @abstractmethod
    def look(self) -> Int32[np.ndarray, "rows columns"]:
        """Find the triangle at every sample of the target, -1 = none."""


class Embree(Peer):
    """Embree through embreex: rays on one thread (a second one gains nothing there)."""

    module = "embreex"

    def __init__(self, triangles: np.ndarray, threads: int) -> None:
        import embreex.mesh_construction
        import embreex.rtcore_scene

        self._scene_of = embreex.rtcore_scene.EmbreeScene
        self._mesh_of = embreex.mesh_construction.TriangleMesh
        self._triangles = triangles.astype(np.int32)

    def pose(self, vertices: np.ndarray) -> None:
        self._scene = self._scene_of()
        self._mesh = self._mesh_of(self._scene, vertices, self._triangles)
        self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))  # the first ray builds the tree

    def aim(self, target: Target) -> None:
        self._shape = target.shape
        self._rays = target.rays()

    def look(self) -> np.ndarray:
        return self._scene.run(*self._rays).reshape(self._shape).astype(np.int32, copy=False)


class Mitsuba(Peer):
    """Mitsuba's LLVM variant: rays in compiled wavefronts over its own tree."""

    module = "mitsuba"

    def __init__(self, triangles: np.ndarray, threads: int) -> None:
        import drjit
        import mitsuba

        mitsuba.set_variant("llvm_ad_rgb")
        drjit.set_thread_count(threads)
        self._mitsuba = mitsuba
        self._triangles = triangles.astype(np.uint32)

    def pose(self, vertices: np.ndarray) -> None:
        mesh = self._mitsuba.Mesh("body", len(vertices), len(self._triangles))
        values = self._mitsuba.traverse(mesh)
        values["vertex_positions"] = vertices.ravel()
        values["faces"] = self._triangles.ravel()
        values.update()
        self._scene = self._mitsuba.load_dict({"type": "scene", "body": mesh})

    def aim(self, target: Target) -> None:
        origins, directions = target.rays()
        point = self._mitsuba.Point3f(origins.T)
        vector = self._mitsuba.Vector3f(directions.T)
        self._shape, self._rays = target.shape, self._mitsuba.Ray3f(point, vector)

    def look(self) -> np.ndarray:
        hit = self._scene.ray_intersect_preliminary(self._rays, coherent=True)
        ids = np.array(hit.prim_index).astype(np.int32)
        ids[~np.array(hit.is_valid())] = -1
        return ids.reshape(self._shape)


_VERTEX = """#version 330
uniform mat4 clip; in vec3 position;
void main() { gl_Position = clip * vec4(position, 1); }"""
_FRAGMENT = """#version 330
out int id;
void main() { id = gl_PrimitiveID + 1; }"""


class OpenGL(Peer):
    """OpenGL through moderngl without a display (EGL); on a machine without a GPU that is Mesa's llvmpipe."""

    module = "moderngl"

    def __init__(self, triangles: np.ndarray, threads: int) -> None:
        import moderngl

        os.environ["LP_NUM_THREADS"] = str(threads)  # llvmpipe reads it when the context is made
        self._gl = moderngl.create_standalone_context(backend="egl")
        self._program = self._gl.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
        self._gl.enable_only(moderngl.DEPTH_TEST)
        self._gl.cull_face = "back"
        self._face_culling = moderngl.CULL_FACE
        self._triangles = triangles.astype(np.int32)
        self._vertices = self._frame = None

    def pose(self, vertices: np.ndarray) -> None:
        if self._vertices is None:
            index = self._gl.buffer(self._triangles.tobytes())
            self._vertices = self._gl.buffer(vertices.tobytes())
            self._array = self._gl.vertex_array(self._program, [(self._vertices, "3f", "position")], index)
        else:
            self._vertices.write(vertices.tobytes())
        self._gl.finish()

    def aim(self, target: Target) -> None:
        size = (target.camera.width * target.n, target.camera.height * target.n)
        if self._frame is None or self._frame.size != size:
            if self._frame is not None:
                self._frame.release()
            ids = self._gl.texture(size, 1, dtype="i4")
            depth = self._gl.depth_renderbuffer(size)
            self._frame = self._gl.framebuffer([ids], depth)
        self._program["clip"].write(_clip_matrix(target).T.astype(np.float32).tobytes())
        (self._gl.enable if target.cull else self._gl.disable)(self._face_culling)
        w, n = target.window, target.n
        rows, columns = target.shape
        # Image row 0 is the bottom row here: the picture is read from below and turned round.
        self._box = (w.x0 * n, size[1] - w.y1 * n, columns, rows)
        self._ids = np.empty(target.shape, np.int32)

    def look(self) -> np.ndarray:
        self._frame.use()
        self._frame.clear()
        self._array.render()
        self._frame.read_into(self._ids, viewport=self._box, components=1, dtype="i4", alignment=1)
        return self._ids[::-1] - 1


def _clip_matrix(target: Target) -> np.ndarray:
    """World to clip space, the far plane at infinity."""
    camera = target.camera
    near = camera.near_plane
    eye = np.array(camera.position(target.pivot))
    view = np.eye(4)
    view[:3, :3] = camera.axes
    view[:3, 3] = -view[:3, :3] @ eye
    across, down = 2 * camera.focal / camera.width, 2 * camera.focal / camera.height
    lens = np.array([[across, 0, 0, 0], [0, down, 0, 0], [0, 0, -1, -2 * near], [0, 0, -1, 0]])
    return lens @ view


PEERS: tuple[type[Peer], ...] = (Embree, Mitsuba, OpenGL)


def available() -> dict[str, str]:
    """Each peer's version, or in words why it cannot be used here."""
    states = {}
    for kind in PEERS:
        try:
            kind(np.array([[0, 1, 2]]), 1).pose(np.eye(3, dtype=np.float32))
            states[kind.module] = importlib.metadata.version(kind.module)
        except ImportError as error:
            states[kind.module] = f"missing: {error}"
        except Exception as error:  # a library behind the package: libGL, libLLVM, a driver
            states[kind.module] = f"missing: {type(error).__name__}: {error}"
    return states


def usable(states: dict[str, str]) -> Iterator[type[Peer]]:
    """List the peers that `available` gave a version for."""
    return (kind for kind in PEERS if not states[kind.module].startswith("missing"))


class PeerViewCache(ViewCache):
    """A `ViewCache` of one pose that asks a peer what is seen, one view at a time."""

    def __init__(self, bodies: Bodies, light: Light, samples: int, peer: Peer) -> None:
        super().__init__(bodies, RenderSettings(light=light, samples=samples))
        self.peer = peer
        self._targets: dict[Camera, Target] = {}
        self._seen: Visibility | None = None

    def pose(self) -> None:
        """Hand the first pose to the peer, as is done for each new pose."""
        self.peer.pose(np.ascontiguousarray(self.bodies.vertices[0], np.float32))

    def build(self, keys: Sequence[Key]) -> list[View]:
        """Build views as every cache does; the peer looks once, before the work is cut into parts."""
        self._seen = self.seen(keys[0][1])
        return super().build(keys)

    def visibility(self, keys: Sequence[Key], screen: Screen, window: Window | None = None) -> Visibility:
        """Select a part of what the peer saw."""
        whole, n = self._seen.window, self._seen.grid
        window = window or whole
        rows = slice((window.y0 - whole.y0) * n, (window.y1 - whole.y0) * n)
        columns = slice((window.x0 - whole.x0) * n, (window.x1 - whole.x0) * n)
        return replace(self._seen, packed=self._seen.packed[:, rows, columns].contiguous(), window=window)

    def seen(self, camera: Camera) -> Visibility:
        """Ask the peer what it sees; without depths."""
        target = self.target(camera)
        self.peer.aim(target)
        ids = torch.from_numpy(np.ascontiguousarray(self.peer.look())).to(torch.int64)
        packed = torch.where(ids < 0, EMPTY, ids | (((1 << DEPTH_BITS) - 1) << ID_BITS)).unsqueeze(0)
        return Visibility(packed, target.window, camera.width, camera.height, target.n)

    def target(self, camera: Camera) -> Target:
        """Describe the camera's view as peers take it: the part of the image that holds the body."""
        if camera not in self._targets:
            screen = self.screen([(0, camera)])
            cull = bool(self.cull([(0, camera)], screen).all())
            pivot = camera.pivot or self._pose(0).center
            self._targets[camera] = Target(camera, pivot, self.settings.grid, bounding_window(screen), cull)
        return self._targets[camera]
