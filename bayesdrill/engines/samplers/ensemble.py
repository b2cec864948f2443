"""One emcee ensemble, advanced piece by piece: the same chain however it is cut."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.engines.samplers.independence import Proposal
from bayesdrill.engines.samplers.moves import mixture

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class State:
    """All that the future of an ensemble depends on. `random` is a legacy NumPy state tuple."""

    z: Array
    log_p: Array
    random: tuple[Any, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """Consecutive steps: `z (S, W, D)`, `log_p (S, W)`, `accepted (W,)` counts, and the end.

    `seconds`: how long they took; nothing but the length of the next piece depends on it.
    """

    z: Array
    log_p: Array
    accepted: Array
    failures: int
    state: State
    seconds: float


def everywhere(z: Array) -> NDArray[np.bool_]:
    return np.ones(len(z), dtype=bool)


def advance(
    evaluate: Callable[[Array], tuple[Array, int]],
    state: State,
    n_steps: int,
    moves: Mapping[str, float],
    proposal: Proposal | None = None,
    inside: Callable[[Array], NDArray[np.bool_]] = everywhere,
) -> Piece:
    """`n_steps` further; `evaluate` gives the log density of a batch and its failures.

    `proposal`: what the independence move draws from; without it that move is left out.
    `inside`: whether points `(n, D)` may have a density at all, cheaper than asking for it.
    """
    import emcee  # late: it takes half a second to load

    failures = 0

    def target(z: Array) -> Array:
        nonlocal failures
        log_p, failed = evaluate(z)
        failures += failed
        return log_p

    begun = time.perf_counter()
    n_walkers, n_dim = state.z.shape
    sampler = emcee.EnsembleSampler(
        n_walkers, n_dim, target, moves=mixture(moves, proposal, inside), vectorize=True
    )
    start = emcee.State(state.z, log_prob=state.log_p, random_state=state.random)
    end = sampler.run_mcmc(start, n_steps, skip_initial_state_check=True)
    return Piece(
        z=sampler.get_chain(),
        log_p=sampler.get_log_prob(),
        accepted=sampler.backend.accepted.copy(),
        failures=failures,
        state=State(end.coords, end.log_prob, tuple(end.random_state)),
        seconds=time.perf_counter() - begun,
    )
