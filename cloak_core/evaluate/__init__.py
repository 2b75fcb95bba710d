"""How well a cloak works: rates, controls, intervals, experiments, reports.

The library's function has the name of this room, and Python puts whichever it meets last under `cloak_core.evaluate`.
So the room can be called, and does what the function does.
"""

import sys
from types import ModuleType


class _Room(ModuleType):
    def __call__(self, *given: object, **named: object) -> dict:
        from cloak_core.library import evaluate

        return evaluate(*given, **named)


sys.modules[__name__].__class__ = _Room
