"""What a thing is: hashes of content, from which caches, resuming and "seen or unseen" are decided."""

from __future__ import annotations

import hashlib

import numpy as np


def sha256_arrays(*arrays: np.ndarray) -> str:
    """SHA-256 (hex) of arrays: their dtypes, shapes and bytes, in order."""
    digest = hashlib.sha256()
    for array in arrays:
        array = np.ascontiguousarray(array)
        digest.update(f"{array.dtype.str}{array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
