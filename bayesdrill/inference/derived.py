"""Derive quantities from the unknowns at every draw: poles, steady state, formulas.

Each draw of the unknowns has one value of each derived quantity, so no further inference is needed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill.basics import symbols
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import SPEED_UNITS, Symbol, product_latex, unit_product
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.unknowns import labelled_symbol
from bayesdrill.record.experiment import typical_inputs
from bayesdrill.rig.models.friction import Named
from bayesdrill.rig.models.linear import Linear, Model, constant_forcing, dynamics
from bayesdrill.rig.steady_state import angle_indices, equilibrium, fix_rotation, free_turn

HDI_PROBABILITY = 0.94
_N_PRIOR_DRAWS = 1000  # number of draws from the priors at which formulas are tried
_LARGEST = 1e150  # a larger value is refused, since its square may overflow in the sd
# A pair of poles faster than the slowest pair by this factor vibrates inside a part, and is not shown.
_MAX_FREQUENCY_RATIO = 100.0
# Poles with a smaller relative imaginary part count as real: rounding splits a double pole.
_REAL_POLE_TOLERANCE = 1e-7


@dataclass(frozen=True, slots=True, kw_only=True)
class Derived:
    """Q derived quantities have `values (E, N, Q)`, in SI, at N draws of each of E ensembles.

    A value is NaN where the quantity does not exist.  `nominal` gives the value at nominal
    parameters, by name, or NaN.
    """

    symbols: tuple[Symbol, ...]
    values: Array
    nominal: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class DerivedRow:
    """A row summarises a derived quantity, in SI, at the draws where it exists (`share` of all)."""

    name: str
    unit: str
    nominal: float | None
    mean: float
    sd: float
    hdi_low: float
    hdi_high: float
    deviation: float | None
    share: float


def impossible_formulas(problem: Problem) -> dict[str, str]:
    """Return, by name, why formulas have no mean or sd at draws from the priors."""
    if not problem.derived:
        return {}
    theta = problem.posterior.space.draw(_N_PRIOR_DRAWS, np.random.default_rng(0))
    values, reasons = values_at(problem, theta), {}
    for formula in problem.derived:
        name, text = formula.symbol.name, f"'{formula.expression.text}'"
        x = np.abs(values[name][np.isfinite(values[name])])
        if not len(x):
            none = f"{text} is no number at any of {_N_PRIOR_DRAWS} draws from the priors"
            reasons[name] = f"{none}; correct the formula"
        elif x.max() > _LARGEST:
            large = f"{text} reaches {x.max():.3g} at draws from the priors"
            reasons[name] = f"{large}, too large for a mean; rescale it"
    return reasons


def derive(problem: Problem, draws: Array) -> Derived:
    """Return tied parameters, poles, steady state and formulas at physical draws `(E, N, D)`."""
    values = values_at(problem, draws.reshape(-1, draws.shape[-1]))
    shape = draws.shape[:2]
    return Derived(
        symbols=derived_symbols(problem),
        values=np.stack([x.reshape(shape) for x in values.values()], axis=-1),
        nominal=_nominal(problem),
    )


def with_products(
    derived: Derived, problem: Problem, draws: Array, exponents: Sequence[Sequence[int]]
) -> Derived:
    """Add products of powers of the first unknowns at draws `(E, N, D)`, such as `k_s_over_j_1`."""
    symbols_by_name = {symbol.name: symbol for symbol in problem.symbols}
    all_symbols, columns, nominal = list(derived.symbols), [derived.values], dict(derived.nominal)
    for powers in exponents:
        names = list(problem.names[: len(powers)])
        factors = [(symbols_by_name[n], e) for n, e in zip(names, powers, strict=True) if e]
        if len(factors) < 2:  # an unknown by itself has its own row already
            continue
        name = product_name(names, powers)
        if name in nominal:  # a formula of the config already has this name
            name += "_"
        unit = unit_product([n.unit for n, _ in factors], [e for _, e in factors])
        latex = product_latex(powers, problem.symbols)
        meaning = "a product of powers that no exact symmetry changes"
        all_symbols.append(Symbol(name, unit, latex, "SI", meaning))
        logs = np.log(draws[..., : len(powers)]) @ np.array(powers, dtype=float)
        columns.append(np.exp(logs)[..., None])
        values = [problem.nominal.get(n.name, np.nan) ** e for n, e in factors]
        nominal[name] = float(np.prod(values))
    values_of_all = np.concatenate(columns, axis=-1)
    return Derived(symbols=tuple(all_symbols), values=values_of_all, nominal=nominal)


def product_name(names: Sequence[str], exponents: Sequence[int]) -> str:
    """Return the product's name, a valid identifier such as `r_m_t_f_squared_over_k_s`."""
    powers, pairs = {1: "", 2: "_squared", 3: "_cubed"}, [*zip(names, exponents, strict=False)]
    sides = [[(n, s * e) for n, e in pairs if s * e > 0] for s in (1, -1)]
    above, below = ("_".join(n + powers.get(e, f"_to_{e}") for n, e in side) for side in sides)
    return f"{above or 'one'}_over_{below}" if below else above


def derived_symbols(problem: Problem) -> tuple[Symbol, ...]:
    """Return the symbols in the order of the values; the speed of a rig that slides is in m/s."""
    model, formulas = problem.model, (formula.symbol for formula in problem.derived)
    called = {
        x: labelled_symbol(model.symbols[n], each.label if x != n else "")
        for each in problem.all_observations
        for n, x in each.named(model.parameters).items()
    }
    tied = [called[name] for name in problem.posterior.space.relations]
    speed = SPEED_UNITS[model.symbols[model.angles[0]].unit] if model.angles else "rad/s"
    end = symbols.DERIVED["w_end"]
    moved = dataclasses.replace(end, unit=speed, latex_unit=symbols.latex_unit(speed))
    return (*tied, *{**symbols.DERIVED, end.name: moved}.values(), *formulas)


def values_at(problem: Problem, theta: Array) -> dict[str, Array]:
    """Return derived quantities by name, each `(W,)`, at physical unknowns `(W, D)`."""
    space = problem.posterior.space
    named = space.named(theta)
    tied = {name: np.broadcast_to(named[name], len(theta)) for name in space.relations}
    return tied | _derived_values(problem, named, len(theta))


def _derived_values(problem: Problem, named: Named, n: int) -> dict[str, Array]:
    model, first = problem.model, problem.observations[0]
    names = first.named(model.parameters)
    p = {name: np.broadcast_to(named[names[name]], n) for name in model.parameters}
    linear = model.linear(p)
    inputs = typical_inputs(first.experiment)
    values = poles(model, linear, n) | steady_values(model, linear, n, inputs)
    known_values: dict[str, Array | float] = {**named, **values}
    for formula in problem.derived:
        name = formula.symbol.name
        value = np.broadcast_to(formula.expression.value(known_values), n)
        values[name] = known_values[name] = np.where(np.isfinite(value), value, np.nan)
    return values


def _nominal(problem: Problem) -> dict[str, float]:
    """Return nominal values by name; NaN if a formula names a quantity without a nominal value."""
    space = problem.posterior.space
    names = (*space.model, *space.free, *space.fixed)
    named: dict[str, Array | float] = dict.fromkeys(names, np.nan)
    fixed = {name: value for name, value in space.fixed.items() if name not in space.model}
    named |= {**fixed, **problem.nominal}
    values = {name: float(x[0]) for name, x in _derived_values(problem, named, 1).items()}
    return {name: problem.nominal.get(name, np.nan) for name in space.relations} | values


def poles(model: Model, linear: Linear, n: int) -> dict[str, Array]:
    """Return frequency and damping of the least damped pair of poles, and time constants, `(n,)`.

    A rig that can turn freely as a whole has a pole at zero, which is removed first.  Frequency and
    damping are NaN if no pair exists, and a time constant is NaN if its pole does not exist.
    """
    matrix = dynamics(linear, model.states, n)
    angles = angle_indices(model)
    turn = free_turn(matrix, angles)
    if turn is not None:
        first, *others = angles
        matrix[:, others] -= turn[1:, None] * matrix[:, [first]]
        matrix = np.delete(np.delete(matrix, first, axis=1), first, axis=2)
    bad = ~np.isfinite(matrix).all(axis=(1, 2))
    matrix[bad] = 0.0
    eigenvalues = np.linalg.eigvals(matrix)
    size = np.abs(eigenvalues)
    with np.errstate(all="ignore"):
        swings = np.abs(eigenvalues.imag) > _REAL_POLE_TOLERANCE * size
        slowest = np.where(swings, size, np.inf).min(axis=1, keepdims=True)
        visible = swings & (size <= _MAX_FREQUENCY_RATIO * slowest)
        damping = np.where(visible, -eigenvalues.real / size, np.inf)
        least_damped = np.argmin(damping, axis=1)[:, None]
        times = np.where(swings, np.nan, -1.0 / eigenvalues.real)
    none = ~swings.any(axis=1)
    fastest = np.argmax(np.where(swings & ~visible, 0.0, size), axis=1)[:, None]
    n_currents = len({m.current for m in model.roles.motors} & {*model.states})
    # There is a real pole for each current, and one more for the motor's speed.
    slow = (~swings).sum(axis=1) == n_currents + 1
    undefined = np.full(n, np.nan)
    values = {
        "omega_n": np.where(none, np.nan, np.take_along_axis(size, least_damped, axis=1)[:, 0]),
        "zeta": np.where(none, np.nan, np.take_along_axis(damping, least_damped, axis=1)[:, 0]),
        "tau_e": np.take_along_axis(times, fastest, axis=1)[:, 0] if n_currents else undefined,
        "tau_m": np.where(slow, np.max(np.where(swings, -np.inf, times), axis=1), np.nan),
    }
    return {name: np.where(bad, np.nan, value) for name, value in values.items()}


def steady_values(
    model: Model, linear: Linear, n: int, inputs: Mapping[str, float]
) -> dict[str, Array]:
    """Return the final speed and current `(n,)` at constant inputs, each NaN if it does not exist.

    In the steady state all parts turn at the same speed, which is zero if a spring holds the rig.
    """
    matrix = dynamics(linear, model.states, n)
    pushed = constant_forcing(linear, model.states, n, inputs)
    angles = angle_indices(model)
    turn = free_turn(matrix, angles)
    final = equilibrium(matrix if turn is None else fix_rotation(matrix, angles, turn), pushed)
    speed = final[:, angles[0]] if turn is not None else 0.0 * final[:, angles[0]]
    current = next((m.current for m in model.roles.motors if m.current in model.states), None)
    at_end = final[:, model.states.index(current)] if current else np.full(n, np.nan)
    return {"w_end": speed, "i_end": at_end}


def summarise(derived: Derived) -> tuple[DerivedRow, ...]:
    """Return a row for each quantity that exists at two draws or more."""
    rows = []
    for q, symbol in enumerate(derived.symbols):
        all_draws = derived.values[..., q].ravel()
        x = all_draws[np.isfinite(all_draws)]
        if len(x) < 2:
            continue
        table = derived.nominal.get(symbol.name, np.nan)
        nominal = table if np.isfinite(table) else None
        numbers = {"share": len(x) / len(all_draws), **estimate(x, nominal or None)}
        rows.append(DerivedRow(name=symbol.name, unit=symbol.unit, nominal=nominal, **numbers))
    return tuple(rows)


def estimate(x: Array, nominal: float | None) -> dict[str, Any]:
    """Return mean, sd, HDI of draws `(N,)`, and relative deviation of the mean, by field name."""
    mean, (low, high) = float(x.mean()), hdi(x)
    deviation = None if nominal is None else mean / nominal - 1.0
    sd = float(x.std(ddof=1))
    return {"mean": mean, "sd": sd, "hdi_low": low, "hdi_high": high, "deviation": deviation}


def hdi(x: Array) -> tuple[float, float]:
    """Return the narrowest interval that holds `HDI_PROBABILITY` of the draws `(N,)`.

    ArviZ returns the same interval, but takes a second to load in each worker that plots.
    """
    ordered = np.sort(x)
    inside = min(int(HDI_PROBABILITY * len(x)), len(x) - 1)
    first = int(np.argmin(ordered[inside:] - ordered[: len(x) - inside]))
    return float(ordered[first]), float(ordered[first + inside])
