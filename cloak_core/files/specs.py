"""Specs: lines of text that name something, their parts parted by colons, such as `darknet:CFG:WEIGHTS`."""

from __future__ import annotations

import re

_PART = re.compile(r"(?:^|:)((?:[A-Za-z]:(?=[\\/]))?[^:]*)")


def split_spec(spec: str) -> list[str]:
    r"""The parts between the colons, empty ones too.

    The colon of a Windows drive (`C:\a.cfg`, `C:/a.cfg`) parts nothing, on any system: a spec means the same
    everywhere. So a file whose name is one letter, before a path from the root, is written `./a:/b`.
    """
    return _PART.findall(spec)


def without_folders(text: str) -> str:
    """Commands and specs with the names of files alone: where they lie is nobody's business.

    onnx:/a/b/c.onnx@320 -> onnx:c.onnx@320
    """
    return re.sub(r"/?([^\s/:=@,'\"]+/)+", "", text)
