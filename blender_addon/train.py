# SPDX-License-Identifier: GPL-3.0-or-later
"""Train without a window, from a checkout: from a .blend file to a .blend file that wears the cloak.

    blender -b body.blend -P blender_addon/train.py -- --logo chest --detector builtin --frames 1:60:10 --out RUN --save cloaked.blend
    python blender_addon/train.py -- --blend body.blend --logo chest --out RUN      (a Python with the bpy package)

Where the extension is installed, `blender -b body.blend --command cloak ...` is the same. This file is not part of it.
"""  # noqa: E501

import contextlib
import importlib.util
import os
import shutil
import sys
from pathlib import Path

import bpy

NAME = "cloak_headless"  # of the package, installed extension or not


def load() -> object:
    """The add-on's module `headless`, from the folder of this file."""
    folder = Path(__file__).resolve().parent
    spec = importlib.util.spec_from_file_location(
        NAME, folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    sys.modules[NAME] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[NAME])
    return importlib.import_module(f"{NAME}.headless")


def leave(code: int) -> None:
    """Exit with a code, also if standard output is closed."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            if stream is not None:  # it was closed before Python began
                stream.flush()
    # The interpreter would flush again, and end with code 120; and the bpy package may wait for ever in its own
    # destructors (a condition variable still in use).
    shutil.rmtree(bpy.app.tempdir, ignore_errors=True)
    os._exit(code)


if __name__ == "__main__":
    given = sys.argv[1:] if bpy.app.binary_path == "" else []
    leave(load().run(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else given))
