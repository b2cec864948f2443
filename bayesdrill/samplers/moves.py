"""The registry of ensemble moves.

emcee 3.1.6's snooker move is not among them: its Hastings factor is wrong (it shrinks a unit
normal in five dimensions to a standard deviation of 0.84).  A move enters here after it has passed
`tests/contracts/test_moves.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

from bayesdrill.samplers.independence import Mixture

if TYPE_CHECKING:
    from emcee.moves import Move  # late: emcee takes a second to load


def _differential_evolution(_proposal: Mixture | None) -> Move:
    from emcee.moves import DEMove

    return DEMove()


def _stretch(_proposal: Mixture | None) -> Move:
    from emcee.moves import StretchMove

    return StretchMove()


def _independence(proposal: Mixture | None) -> Move | None:
    """None as long as nothing has been learnt."""
    from emcee.moves import MHMove

    return None if proposal is None else MHMove(proposal.propose)


MOVES: Mapping[str, Callable[[Mixture | None], Move | None]] = MappingProxyType(
    {
        "differential_evolution": _differential_evolution,
        "stretch": _stretch,
        "independence": _independence,
    }
)


def mixture(weights: Mapping[str, float], proposal: Mixture | None) -> list[tuple[Move, float]]:
    """What emcee takes as `moves`; those that need a proposal only where there is one."""
    made = [(MOVES[name](proposal), weight) for name, weight in weights.items() if weight > 0]
    return [(move, weight) for move, weight in made if move is not None]
