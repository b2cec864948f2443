"""The registry of ensemble moves.

emcee 3.1.6's snooker move is not among them: its Hastings factor is wrong (it shrinks a unit
normal in five dimensions to a standard deviation of 0.84).  A move enters here after it has passed
`tests/contracts/test_moves.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from emcee.moves import Move  # late: emcee takes a second to load


def _differential_evolution() -> Move:
    from emcee.moves import DEMove

    return DEMove()


def _stretch() -> Move:
    from emcee.moves import StretchMove

    return StretchMove()


MOVES: Mapping[str, Callable[[], Move]] = MappingProxyType(
    {"differential_evolution": _differential_evolution, "stretch": _stretch}
)


def mixture(weights: Mapping[str, float]) -> list[tuple[Move, float]]:
    """What emcee takes as `moves`."""
    return [(MOVES[name](), weight) for name, weight in weights.items() if weight > 0]
