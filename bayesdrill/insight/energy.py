"""Where the energy goes in each experiment, at the MAP and as surely as the posterior has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.energy import Energies, can_tell, energies
from bayesdrill.rig.simulator import Simulator

Array = NDArray[np.float64]

STORED, CONVERTED, AT_START = "stored", "conversion", "start"
NOTHING = 1e-9  # of the largest flow


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """`name`: of an input, a parameter, a friction, or `conversion`, `start` and `stored`; `joules`
    until the end; `share` of all that came in, and its `sd` over draws, None without any.
    """

    name: str
    joules: float
    share: float
    sd: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Account:
    """Of one experiment: `came` in and `went` at each of the times `t (N,)`, J, by name; what is stored
    at the start has come in.  `left`: the share that is in neither, of the order of the steps.
    """

    label: str
    t: Array
    came: dict[str, Array]
    went: dict[str, Array]
    parts: tuple[Part, ...]
    left: float

    @property
    def total(self) -> Array:
        """All that came in so far `(N,)`."""
        return np.asarray(sum(self.came.values(), np.zeros(len(self.t))))


def accounts(posterior: Posterior, theta: Array, draws: Array) -> tuple[Account, ...]:
    """Of experiments whose rig rubs, at the MAP `theta (D,)` and draws `(N, D)`."""
    found = []
    for one in posterior.likelihood.observations:
        rig = one.response
        if rig.model.frictions and can_tell(rig.model):
            found.append(_account(one, posterior, rig, theta, draws))
    return tuple(found)


def _account(
    one: Observation, posterior: Posterior, rig: Simulator, theta: Array, draws: Array
) -> Account:
    told = one.told(posterior.space.full(np.vstack([theta[None], draws])))
    best = energies(rig, told[0])
    flows = _flows(best)
    names = _sides(flows)
    came = {name: flows[name] for name in names[0]}
    went = {name: -flows[name] for name in names[1]}
    shares = [_shares(_flows(energies(rig, each)), names) for each in told[1:]]
    parts = [
        Part(
            name=name,
            joules=float((came | went)[name][-1]),
            share=share,
            sd=None if len(shares) < 2 else float(np.std([o[name] for o in shares], ddof=1)),
        )
        for name, share in _shares(flows, names).items()
    ]
    total = sum(part[-1] for part in came.values())
    left = float(np.abs(best.open[-1]) / total) if total else 0.0
    return Account(label=one.label, t=best.t, came=came, went=went, parts=tuple(parts), left=left)


def _flows(found: Energies) -> dict[str, Array]:
    """By name, what comes in is positive."""
    flows = {**found.given, CONVERTED: found.converted}
    flows |= {name: -part for name, part in found.lost.items()}
    start = np.full(len(found.t), found.stored[0])
    return {**flows, AT_START: start, STORED: -found.stored}


def _sides(flows: dict[str, Array]) -> tuple[list[str], list[str]]:
    """Names of what came in and of what went, in the end; what is next to nothing has none."""
    scale = max(float(np.abs(part).max()) for part in flows.values())
    kept = [n for n, part in flows.items() if n == STORED or np.abs(part).max() > NOTHING * scale]
    came = [name for name in kept if name != STORED and flows[name][-1] >= 0]
    return came, [name for name in kept if name not in came]


def _shares(flows: dict[str, Array], names: tuple[list[str], list[str]]) -> dict[str, float]:
    """Of all that came in."""
    ends = {name: float(flows[name][-1]) for name in (*names[0], *names[1])}
    total = sum(ends[name] for name in names[0])
    signs = dict.fromkeys(names[0], 1.0) | dict.fromkeys(names[1], -1.0)
    return {name: signs[name] * end / total if total else 0.0 for name, end in ends.items()}
