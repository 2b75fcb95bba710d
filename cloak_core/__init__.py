"""Cloak: adversarial face colours for human meshes, trained against person detectors.

Importing this package imports no torch; its rooms (`scene`, `render`, `detectors`, `attack`, `evaluate`, ...) are
imported one by one.
"""

__version__ = "0.1.0"
