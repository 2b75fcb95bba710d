"""The optional techniques of training, a file each (settings, code, state). `core.technique` finds them."""

import cloak_core.core.settings  # noqa: F401  (it reads these files' settings, and so has to be imported before one)
