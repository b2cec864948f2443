"""Where the pieces of a chain are kept while it grows: in a folder, or just in memory."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from bayesdrill.engines.samplers.ensemble import Piece


class Shelf(Protocol):
    """`pieces`: those of one ensemble in order; `save`: the piece that begins at `first_step`."""

    def pieces(self, ensemble: int) -> list[Piece]: ...

    def save(self, ensemble: int, first_step: int, piece: Piece) -> None: ...


@dataclass(frozen=True, slots=True)
class Memory:
    """For chains that are not worth a folder."""

    kept: dict[int, list[Piece]] = field(default_factory=dict)

    def pieces(self, ensemble: int) -> list[Piece]:
        return list(self.kept.get(ensemble, []))

    def save(self, ensemble: int, first_step: int, piece: Piece) -> None:
        self.kept.setdefault(ensemble, []).append(piece)
