"""Packages that take long to import, imported when something of them is first used."""

from __future__ import annotations

import importlib


class Lazy:
    """Stands for a module: `torch = Lazy("torch")` imports nothing until `torch.tensor` is asked for."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> object:
        return getattr(importlib.import_module(self._name), attribute)
