"""Coordinates in which the posterior of the motor-shaft rig is straight, for any free parameters.

A record determines a steady speed and rates far better than it determines the parameters in them;
in logs of the parameters the posterior is therefore a thin curved ridge.  Here those combinations
are coordinates themselves.  With rho = r_m/k_T, kappa = k_e/rho and d = c_m + kappa:

    speed       w = (v/rho - t_f) / d          steady speed of the motor
    rotor       k_s / j_1                      square of the rotor's frequency
    shaft       i_m^2 k_s / d                  stiffness over damping
    inertia     j_m / d                        mechanical time constant
    electrical  l_m / r_m                      electrical time constant

and as many logs of free parameters as are needed beside them.  Going back, the equations above are
solved one by one, each for the one quantity in it that is not known yet; a plan for that is found
for each set of free parameters.  In logs, |d coordinates / d parameters| is the product of the
derivatives of each equation by what it is solved for, most of which are 1.

A parameter that is given by others as a product of powers (`k_T = k_e`, `k_s = pi G d^4/(32 L)`)
brings one more log-linear equation, and G, d, L further logs to keep.  Such equations can be left
with several unknowns in common; then they are solved together.

`v/rho - t_f` is continued by a positive function where friction takes more than half of the stall
torque, so that all positive parameters have coordinates.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import wrightomega

from bayesdrill.formulas import Monomial
from bayesdrill.models.linear import NO_RELATIONS

Array = NDArray[np.float64]
Logs = dict[str, Array | float]
Equations = Mapping[str, Mapping[str, float]]

TARGETS = ("speed", "rotor", "shaft", "inertia", "electrical")

# Log-linear equations: sum of weight * log(quantity) = 0.  Targets are quantities too.
LINEAR: Mapping[str, Mapping[str, int]] = {
    "rho": {"rho": 1, "r_m": -1, "k_T": 1},
    "kappa": {"kappa": 1, "k_e": -1, "rho": 1},
    "rotor": {"rotor": 1, "k_s": -1, "j_1": 1},
    "shaft": {"shaft": 1, "k_s": -1, "d": 1, "gear": -2},
    "inertia": {"inertia": 1, "j_m": -1, "d": 1},
    "electrical": {"electrical": 1, "l_m": -1, "r_m": 1},
}
CURVED: Mapping[str, tuple[str, ...]] = {
    "d": ("d", "c_m", "kappa"),
    "speed": ("speed", "d", "rho", "t_f"),
}
AUXILIARY = ("rho", "kappa", "d")

# Which logs to keep beside the targets: what the record knows least comes first.
# Quantities that parameters are given by come even before, as they are known beforehand.
KEPT_FIRST = ("c_m", "t_f", "j_1", "r_m", "l_m", "k_T", "k_s", "j_m", "k_e")


@dataclass(frozen=True, slots=True)
class Step:
    """Solve `equation` for `unknown`."""

    equation: str
    unknown: str


@dataclass(frozen=True, slots=True)
class Block:
    """Solve log-linear `equations` for as many `unknowns`, whose weights are `matrix`."""

    equations: tuple[str, ...]
    unknowns: tuple[str, ...]
    matrix: Array


@dataclass(frozen=True, slots=True)
class Stage:
    """A curved step of the way back: its other quantities are `basis @ weights + offset`."""

    step: Step
    names: tuple[str, ...]
    weights: Array
    offset: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorShaftChart:
    """See `models.linear.Chart`; columns of parameters in the order of `free`."""

    i_m: float
    v: float
    free: tuple[str, ...]
    fixed: Mapping[str, float]
    relations: Mapping[str, Monomial]
    coordinates: tuple[str, ...]
    stages: tuple[Stage, ...]
    weights: Array
    offset: Array
    log_pivots: float

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(f"log {name}" for name in self.coordinates)

    def straighten(self, logs: Array) -> Array:
        known = self._everything(logs)
        return np.stack([np.broadcast_to(known[c], len(logs)) for c in self.coordinates], axis=-1)

    def bend(self, z: Array) -> tuple[Array, Array]:
        m = z.shape[1]
        basis = np.empty((len(z), m + len(self.stages)))
        basis[:, :m] = z
        log_det = np.full(len(z), -self.log_pivots)
        for column, stage in enumerate(self.stages, start=m):
            values = basis[:, :column] @ stage.weights + stage.offset
            known: Logs = dict(zip(stage.names, values.T, strict=True))
            known[stage.step.unknown] = basis[:, column] = _solve(stage.step, known)
            log_det -= np.log(_slope(stage.step, known))
        return basis @ self.weights + self.offset, log_det

    def _everything(self, logs: Array) -> Logs:
        """All quantities from the parameters."""
        known: Logs = dict(_constants(self.i_m, self.v, self.fixed))
        known.update(zip(self.free, logs.T, strict=True))
        for name, relation in self.relations.items():
            terms = [power * known[other] for other, power in relation.powers.items()]
            known[name] = math.log(relation.factor) + sum(terms)
        for name in (*AUXILIARY, *TARGETS):
            known[name] = _solve(Step(name, name), known)
        return known


def _constants(i_m: float, v: float, fixed: Mapping[str, float]) -> dict[str, float]:
    named = {name: math.log(value) for name, value in fixed.items()}
    return {**named, "gear": math.log(i_m), "v": math.log(v)}


def make_chart(
    i_m: float,
    v: float,
    free: tuple[str, ...],
    fixed: Mapping[str, float],
    relations: Mapping[str, Monomial] = NO_RELATIONS,
) -> MotorShaftChart:
    """The chart with the most targets that a plan can be found for."""
    free = tuple(map(_own, free))
    fixed = {_own(name): value for name, value in fixed.items()}
    relations = {
        name: Monomial(r.factor, {_own(other): power for other, power in r.powers.items()})
        for name, r in relations.items()
    }
    linear = {**LINEAR, **{_relating(name): _row(name, r) for name, r in relations.items()}}
    coordinates, plan = next(_plans(free, frozenset(fixed), linear))
    curved = [step for step in plan if isinstance(step, Step)]
    # Every quantity is a weighted sum of the coordinates, of what the curved steps before it have
    # found, and of a constant, which stands last.
    unit = np.eye(len(coordinates) + len(curved) + 1)
    forms = {name: value * unit[-1] for name, value in _constants(i_m, v, fixed).items()}
    forms.update((_factor(name), math.log(r.factor) * unit[-1]) for name, r in relations.items())
    forms.update(zip(coordinates, unit, strict=False))
    nothing = 0.0 * unit[-1]
    stages: list[Stage] = []
    log_pivots = 0.0
    for step in plan:
        if isinstance(step, Block):
            rows = [linear[equation] for equation in step.equations]
            rest = [
                -sum(w * forms[n] for n, w in row.items() if n not in step.unknowns) + nothing
                for row in rows
            ]
            solved = np.linalg.solve(step.matrix, rest)
            forms.update(zip(step.unknowns, solved, strict=True))
            log_pivots += float(np.linalg.slogdet(step.matrix)[1])
        else:
            column = len(coordinates) + len(stages)
            names = (*(n for n in CURVED[step.equation] if n != step.unknown), "v")
            form = np.array([forms[name] for name in names])
            stages.append(Stage(step, names, form[:, :column].T.copy(), form[:, -1]))
            forms[step.unknown] = unit[column]
    form = np.array([forms[name] for name in free]).reshape(len(free), len(unit))
    return MotorShaftChart(
        i_m=i_m,
        v=v,
        free=free,
        fixed=fixed,
        relations=relations,
        coordinates=coordinates,
        stages=tuple(stages),
        weights=form[:, :-1].T.copy(),
        offset=form[:, -1],
        log_pivots=log_pivots,
    )


def _own(name: str) -> str:
    """A quantity of the user's may be called as one of those here."""
    return name if name in KEPT_FIRST else f"quantity {name}"


def _relating(name: str) -> str:
    return f"relation of {name}"


def _factor(name: str) -> str:
    return f"factor of {name}"


def _row(name: str, relation: Monomial) -> dict[str, float]:
    return {name: 1.0, **{n: -p for n, p in relation.powers.items()}, _factor(name): -1.0}


def _plans(
    free: tuple[str, ...], fixed: frozenset[str], linear: Equations
) -> Iterator[tuple[tuple[str, ...], tuple[Step | Block, ...]]]:
    """Possible charts, best first; the last keeps the logs of all free parameters."""
    preferred = [name for name in free if name not in KEPT_FIRST]
    preferred += [name for name in KEPT_FIRST if name in free]
    for n_targets in range(min(len(TARGETS), len(free)), -1, -1):
        for targets in itertools.combinations(TARGETS, n_targets):
            for kept in itertools.combinations(preferred, len(free) - n_targets):
                plan = _plan(targets, frozenset(kept) | fixed, linear)
                if plan is not None:
                    yield (*targets, *kept), plan


def _plan(
    targets: tuple[str, ...], known: frozenset[str], linear: Equations
) -> tuple[Step | Block, ...] | None:
    """An order in which every equation has one unknown left, or None where there is none.

    Log-linear equations may instead have as many unknowns left as they are.
    """
    given = {name for row in linear.values() for name in row if name.startswith(_factor(""))}
    have = known | set(targets) | {"gear"} | given
    wanted = {*AUXILIARY, *targets, *(name for name in linear if name not in LINEAR)}
    open_ = {name: frozenset(row) for name, row in linear.items() if name in wanted}
    open_ |= {name: frozenset(row) for name, row in CURVED.items() if name in wanted}
    steps: list[Step | Block] = []
    while open_:
        left = {name: quantities - have for name, quantities in open_.items()}
        ready = [name for name in left if len(left[name]) == 1]
        if ready and ready[0] in CURVED:
            (unknown,) = left[ready[0]]
            step: Step | Block = Step(ready[0], unknown)
            done, found = [ready[0]], {unknown}
        else:
            pool = ready[:1] or [name for name in left if name in linear]
            block = _block(pool, left, linear)
            if block is None:
                return None
            step, done, found = block, list(block.equations), set(block.unknowns)
        for name in done:
            del open_[name]
        have |= found
        steps.append(step)
    return tuple(steps)


def _block(pool: list[str], left: Mapping[str, frozenset[str]], linear: Equations) -> Block | None:
    """The fewest equations of `pool` that determine all that they have left."""
    for size in range(1, len(pool) + 1):
        for equations in itertools.combinations(pool, size):
            unknowns = tuple(sorted(frozenset().union(*(left[name] for name in equations))))
            if len(unknowns) != size:
                continue
            matrix = np.array(
                [[float(linear[name].get(n, 0.0)) for n in unknowns] for name in equations]
            )
            if abs(np.linalg.det(matrix)) > 1e-9:
                return Block(equations, unknowns, matrix)
    return None


def _solve(step: Step, known: Logs) -> Array | float:
    """The log of the unknown; NaN where it would not be positive."""
    if step.equation in LINEAR:  # an auxiliary or a target, from the parameters
        weights = LINEAR[step.equation]
        rest = sum(w * known[name] for name, w in weights.items() if name != step.unknown)
        return -rest / weights[step.unknown]
    if step.equation == "d":
        if step.unknown == "d":
            return np.logaddexp(known["c_m"], known["kappa"])
        part = known["kappa"] if step.unknown == "c_m" else known["c_m"]
        return known["d"] + np.log1p(-np.exp(part - known["d"]))
    if step.unknown == "t_f":
        left = known["speed"] + known["d"] + known["rho"] - known["v"]
        return np.log(_share_of(left)) + known["v"] - known["rho"]
    if step.unknown == "rho":
        return _solve_rho(known)
    other = known["d"] if step.unknown == "speed" else known["speed"]
    friction = known["rho"] + known["t_f"] - known["v"]
    return known["v"] - known["rho"] + _log_left(np.exp(friction)) - other


def _solve_rho(known: Logs) -> Array:
    """log rho - log_left(rho t_f / v) = a, in closed form on both branches."""
    a = known["v"] - known["speed"] - known["d"]
    friction = known["t_f"] - known["v"]
    rho = np.asarray(a - np.log1p(np.exp(a + friction)))
    far = ~(rho + friction <= math.log(0.5))
    if np.any(far):
        beyond = math.log(0.5) + 1.0 + a + friction  # log u + 2 u = this, where u > 1/2
        share = 0.5 * np.real(wrightomega(np.asarray(math.log(2.0) + beyond)))
        rho = np.where(far, np.log(share) - friction, rho)
    return rho


def _slope(step: Step, known: Logs) -> Array | float:
    """|d equation / d log unknown|, the equation written as log(left side) - log(right side)."""
    if step.equation == "d":
        return 1.0 if step.unknown == "d" else np.exp(known[step.unknown] - known["d"])
    if step.unknown in ("d", "speed"):
        return 1.0
    u = np.exp(known["rho"] + known["t_f"] - known["v"])
    share = np.where(u <= 0.5, u / (1.0 - np.minimum(u, 0.5)), 2.0 * u)
    return share if step.unknown == "t_f" else 1.0 + share


def _log_left(u: Array | float) -> Array:
    """log(1 - u) up to u = 1/2, its tangent beyond: what friction leaves of the stall torque."""
    inside = np.minimum(u, 0.5)
    return np.asarray(np.log1p(-inside) - 2.0 * (u - inside))


def _share_of(log_left: Array | float) -> Array:
    """The inverse of `_log_left`; NaN for positive arguments."""
    near = -np.expm1(log_left)
    far = 0.5 * (1.0 + math.log(0.5) - log_left)
    share = np.where(np.asarray(log_left) >= math.log(0.5), near, far)
    return np.where(share > 0, share, np.nan)
