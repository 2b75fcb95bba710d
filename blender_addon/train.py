# SPDX-License-Identifier: GPL-3.0-or-later
"""Train without a window, from a checkout: from a .blend file to a .blend file that wears the cloak.

    blender -b body.blend -P blender_addon/train.py -- --logo chest --detector builtin --frames 1:60:10 --out RUN --save cloaked.blend
    python blender_addon/train.py -- --blend body.blend --logo chest --out RUN      (a Python with the bpy package)

Where the extension is installed, `blender -b body.blend --command cloak ...` is the same. This file is not part of it.
"""  # noqa: E501

import contextlib
import os
import shutil
import sys
from pathlib import Path

import bpy

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from blender_addon import headless

    arguments = sys.argv[1:] if bpy.app.binary_path == "" else []
    code = headless.run(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else arguments)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            if stream is not None:  # it was closed before Python began
                stream.flush()
    # The interpreter would flush again, and end with code 120; and the bpy package may wait for ever in its own
    # destructors (a condition variable still in use).
    shutil.rmtree(bpy.app.tempdir, ignore_errors=True)
    os._exit(code)
