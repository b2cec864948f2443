"""How deep cells and structs of a MATLAB file (v5 to v7) lie in each other, found without recursion.

SciPy reads each inside the one that holds it, and some thousands end the process.  Elements are a flat
stream of tags, which is followed here as SciPy follows it: how many a cell holds is known from its
dimensions, never from the length in its tag.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Buffer

from bayesdrill.basics.sizes import LARGEST_FILE

DEEPEST = 100  # ten times what anyone nests, and a tenth of what SciPy stands

_MATRIX, _COMPRESSED = 14, 15  # kinds of elements
# Classes of matrices that hold others.
_CELL, _STRUCT, _OBJECT, _FUNCTION, _OPAQUE = 1, 2, 3, 16, 17
_HOLDING = {_CELL, _STRUCT, _OBJECT, _FUNCTION, _OPAQUE}
_CLASS = 16  # bytes from the tag of a matrix to its class
_DIMENSIONS = 32  # at most


def too_deep(file: bytes) -> bool:
    """Whether something lies deeper than `DEEPEST`; of compressed numbers only the beginning is read.

    Raises `zlib.error` or `struct.error` where the file is damaged.
    """
    if 0 in file[:4]:  # v4, which has no cells
        return False
    order = "<" if file[126:128] == b"IM" else ">"
    at, view = 128, memoryview(file)
    while at < len(file):
        kind, size = struct.unpack_from(f"{order}II", file, at)
        matrix: Buffer = view[at:]
        if kind == _COMPRESSED:
            packed = view[at + 8 : at + 8 + size]
            matrix = zlib.decompressobj().decompress(packed, _CLASS + 4)
            if _class(matrix, 0, order) in _HOLDING:
                matrix = zlib.decompressobj().decompress(packed, LARGEST_FILE)
        if _class(matrix, 0, order) in _HOLDING and _Walk(matrix, order).too_deep():
            return True
        at += 8 + size
    return False


def _class(matrix: Buffer, at: int, order: str) -> int:
    return int(struct.unpack_from(f"{order}I", matrix, at + _CLASS)[0]) & 0xFF


class _Walk:
    """Through one variable, element by element."""

    def __init__(self, data: Buffer, order: str) -> None:
        self._data, self._order, self._at = memoryview(data), order, 0

    def too_deep(self) -> bool:
        left = [1]  # matrices still to come, at each depth
        try:
            while left and len(left) <= DEEPEST + 1:
                if left[-1] == 0:
                    left.pop()
                    continue
                left[-1] -= 1
                if held := self._enter():
                    left.append(held)
        except struct.error:  # the end, or cut short
            return False
        return bool(left)

    def _enter(self) -> int:
        """From the tag of a matrix to that of the next: how many it holds."""
        (size,) = self._words(self._at + 4, 1)
        if size == 0:
            self._at += 8
            return 0
        kind, held = _class(self._data, self._at, self._order), 0
        self._at += _CLASS + 8
        if kind in (_FUNCTION, _OPAQUE):
            held = 1
        if kind != _OPAQUE:
            begin, size = self._element()
            held = held or math.prod(self._words(begin, min(size // 4, _DIMENSIONS)))
            self._element()  # its name
        if kind == _OBJECT:
            self._element()  # that of its class
        if kind in (_STRUCT, _OBJECT):
            letters = self._words(self._element()[0], 1)[0]
            held *= self._element()[1] // max(letters, 1)
        while self._words(self._at, 1)[0] != _MATRIX:
            self._element()
        return held if kind in _HOLDING else 0

    def _element(self) -> tuple[int, int]:
        """Past one that is no matrix: where what it holds begins, and how many bytes that is."""
        at, (kind, size) = self._at, self._words(self._at, 2)
        if kind >> 16:  # a small one, all in its tag
            self._at += 8
            return at + 4, kind >> 16
        self._at += 8 + size + -size % 8
        return at + 8, size

    def _words(self, at: int, count: int) -> tuple[int, ...]:
        return struct.unpack_from(f"{self._order}{count}I", self._data, at)
