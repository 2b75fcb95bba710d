"""A .blend file without what differs from one saving to the next, so that the same content has the same bytes.

Blender writes the addresses that data had in its memory (others refer to data by them), random identifiers, and
whatever stood behind the end of a text. `stable` numbers, or clears, all of them. The file's own catalogue of structs
(its block DNA1) says where they are.
"""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

NUMBERED = {("ID", "session_uid"), ("bNode", "identifier")}
"""Integers that are drawn anew at each saving; of a tree's nodes they must differ."""


@dataclass(frozen=True)
class Block:
    """One piece of a file: where its address and its data stand, and `count` times which struct these are."""

    code: bytes
    address_at: int
    address: int
    start: int
    size: int
    kind: int
    count: int


def blocks_of(data: bytes) -> Iterator[Block]:
    """Every block. The head of a file, and of its blocks, is one of two: Blender 5 made the sizes wider."""
    wide = data[7:8].isdigit()
    at, layout = (int(data[7:9]), "<4siQqq") if wide else (12, "<4siQii")
    code = b""
    while code != b"ENDB":
        code, one, address, other, count = struct.unpack_from(layout, data, at)
        size, kind = (other, one) if wide else (one, other)
        start = at + struct.calcsize(layout)
        yield Block(code, at + 8, address, start, size, kind, count)
        at = start + size


class Catalogue:
    """The structs of a file: which fields they have, one after the other."""

    def __init__(self, words: bytes) -> None:
        self._words, self._at = words, 4
        names, types = self._texts(), self._texts()
        self.sizes = self._shorts(len(types))
        self._at += -self._at % 4 + 4
        (count,) = struct.unpack_from("<i", words, self._at)
        self._at += 4
        self.kinds: list[int] = []  # the type of each struct
        self._fields: dict[int, list[tuple[int, str]]] = {}
        for _ in range(count):
            kind, fields = self._shorts(2)
            pairs = self._shorts(2 * fields)
            self.kinds.append(kind)
            self._fields[kind] = [(pairs[i], names[pairs[i + 1]]) for i in range(0, len(pairs), 2)]
        self._types = types
        self.volatile = cache(self._volatile)

    def _shorts(self, count: int) -> tuple[int, ...]:
        if count > 2 and self._words[self._at : self._at + 4] == b"TLEN":
            self._at += 4
        values = struct.unpack_from(f"<{count}H", self._words, self._at)
        self._at += 2 * count
        return values

    def _texts(self) -> list[str]:
        self._at += -self._at % 4 + 4
        (count,) = struct.unpack_from("<i", self._words, self._at)
        self._at += 4
        texts = self._words[self._at :].split(b"\0", count)[:count]
        self._at += sum(len(text) + 1 for text in texts)
        self._at += -self._at % 4
        return [text.decode() for text in texts]

    def _volatile(self, kind: int) -> list[tuple[str, int, int]]:
        """What of a struct is not content: "pointer", "number", "padding" or "text", where it stands, and how long."""
        found, at = [], 0
        for part, name in self._fields.get(kind, ()):
            times = 1
            for length in re.findall(r"\[(\d+)\]", name):
                times *= int(length)
            pointer = name.startswith(("*", "(*"))
            size = 8 if pointer else self.sizes[part]
            if pointer:
                found += [("pointer", at + 8 * i, 8) for i in range(times)]
            elif name.startswith("_pad"):
                found.append(("padding", at, size * times))
            elif (self._types[kind], name) in NUMBERED:
                found.append(("number", at, 4))
            elif self._types[part] == "char" and times > 1:
                found.append(("text", at, times))
            else:
                found += [(what, at + size * i + o, n) for i in range(times) for what, o, n in self.volatile(part)]
            at += size * times
        return found


def stable(data: bytes) -> bytes:
    """The bytes of an uncompressed .blend file, made stable."""
    blocks, new = list(blocks_of(data)), bytearray(data)
    (words,) = (data[b.start : b.start + b.size] for b in blocks if b.code == b"DNA1")
    catalogue = Catalogue(words)
    numbers = {0: 0}
    for block in blocks:
        numbers.setdefault(block.address, len(numbers))
    for count, block in enumerate(blocks):
        struct.pack_into("<Q", new, block.address_at, numbers[block.address])
        if block.code in (b"DNA1", b"ENDB", b"TEST"):
            continue
        kind = catalogue.kinds[block.kind]
        size = catalogue.sizes[kind]
        if block.kind and size * block.count == block.size:
            for at in range(block.start, block.start + block.size, size):
                for what, offset, length in catalogue.volatile(kind):
                    _clear(new, what, at + offset, length, numbers, count)
        else:  # no struct: pixels, texts, or lists of addresses
            for at in range(block.start, block.start + block.size - 7, 8):
                (value,) = struct.unpack_from("<Q", new, at)
                if value > 1 << 20 and value in numbers:
                    struct.pack_into("<Q", new, at, numbers[value])
    return bytes(new)


def _clear(new: bytearray, what: str, at: int, length: int, numbers: dict[int, int], count: int) -> None:
    if what == "pointer":  # one to nothing that was saved is of no use to anybody
        (value,) = struct.unpack_from("<Q", new, at)
        struct.pack_into("<Q", new, at, numbers.get(value, 0))
    elif what == "number":
        struct.pack_into("<i", new, at, count + 1)
    elif what == "padding":
        new[at : at + length] = bytes(length)
    elif (end := new.find(b"\0", at, at + length)) >= 0:
        new[end : at + length] = bytes(at + length - end)
