"""A cache of objects that hold tensors, bounded by their bytes."""

from __future__ import annotations

import threading
from collections import OrderedDict

from torch import Tensor


class Kept:
    """Objects of tensors by key, the least recently used dropped first once they exceed a number of bytes.

    Threads may share one.
    """

    def __init__(self, limit: int) -> None:
        self.limit, self.bytes = limit, 0
        self._items: OrderedDict[object, tuple[object, int]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: object) -> object | None:
        with self._lock:
            if key not in self._items:
                return None
            self._items.move_to_end(key)
            return self._items[key][0]

    def put(self, key: object, item: object) -> object:
        tensors = [value for value in vars(item).values() if isinstance(value, Tensor)]
        size = sum(tensor.numel() * tensor.element_size() for tensor in tensors)
        with self._lock:
            self.bytes -= self._items.pop(key, (None, 0))[1]
            self._items[key] = (item, size)
            self.bytes += size
            while self.bytes > self.limit and len(self._items) > 1:
                _, (_, freed) = self._items.popitem(last=False)
                self.bytes -= freed
        return item
