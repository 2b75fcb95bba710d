"""The one error for bad input.

`InputError` is defined in `scene.exchange`, because Blender ships that file alone; everybody else imports it from here.
"""

from cloak_core.scene.exchange import InputError

__all__ = ["InputError"]
