"""OpenGL through moderngl without a display (EGL); on a machine without a GPU that is Mesa's llvmpipe."""

from __future__ import annotations

import os

import numpy as np

from cloak_core.bench.peers.protocol import Peer, Target

_VERTEX = """#version 330
uniform mat4 clip; in vec3 position;
void main() { gl_Position = clip * vec4(position, 1); }"""
_FRAGMENT = """#version 330
out int id;
void main() { id = gl_PrimitiveID + 1; }"""


class OpenGL(Peer):
    module = "moderngl"

    def __init__(self, triangles: np.ndarray, threads: int) -> None:
        import moderngl

        os.environ["LP_NUM_THREADS"] = str(threads)  # llvmpipe reads it when the context is made
        self._gl = moderngl.create_standalone_context(backend="egl")
        self._program = self._gl.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
        self._gl.enable_only(moderngl.DEPTH_TEST)
        self._gl.cull_face = "back"
        self._face_culling, self._triangles = moderngl.CULL_FACE, triangles.astype(np.int32)
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
            ids, depth = self._gl.texture(size, 1, dtype="i4"), self._gl.depth_renderbuffer(size)
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
    near, eye = camera.near_plane, np.array(camera.position(target.pivot))
    view = np.eye(4)
    view[:3, :3] = camera.axes
    view[:3, 3] = -view[:3, :3] @ eye
    across, down = 2 * camera.focal / camera.width, 2 * camera.focal / camera.height
    lens = np.array([[across, 0, 0, 0], [0, down, 0, 0], [0, 0, -1, -2 * near], [0, 0, -1, 0]])
    return lens @ view
