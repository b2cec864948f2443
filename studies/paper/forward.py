"""Integrate the paper's forward model beside the exact one: its matrix, integrator and misfit.

The integrator is one of the kind of MATLAB's ode23t, written anew: the trapezoidal rule with steps
that fit a tolerance, for `x' = A x + f` with both constant:

    x_new - x = (h/2)(x' + x'_new),  so  x_new = x + (1 - h A/2)^-1 h x'

- The local error is -(h^3/12) x''' ; x''' is twice the second divided difference of the slopes x' at
  this step's two ends and the one before (at the start, where there is none, of x'' = A x').
- A step stands if that is at most `rtol` times the size of each state, a size of at least
  `atol / rtol`.  It is then kept as it is, so that nothing has to be factorised, unless a step at
  least `WORTHWHILE` times as long will do.
- What dies out much faster than a step rings on in this rule, with changing sign, and the error sees
  it: a rig with a thousandth of the inductance takes three times as many steps.
- The "free" interpolant between two ends is the cubic with their values and slopes (Hermite).  The
  rule itself takes the cubic's third power away: what is left is the parabola in `_between`.

Hosea and Shampine (Appl. Numer. Math. 20, 1996) for the rule, its interpolant and its error;
Shampine and Reichelt (SIAM J. Sci. Comput. 18, 1997) for the suite: tolerances, the longest step of
a tenth of the interval, and a first step from `rtol` and the first slope.  MATLAB's safety factors
are not all published, so its steps are alike and not the same.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from bayesdrill.basics import Array, Symbol
from bayesdrill.inference import Likelihood, derived
from bayesdrill.record import Experiment
from bayesdrill.rig import Linear, Model, MotorShaft, Named, Response, constant_forcing, dynamics
from bayesdrill.sampling import Task
from studies.paper.printed import Row

SIX_STATES = ("theta_1", "theta_2", "q", "w_1", "w_2", "i")

LONGEST = 0.1  # of the interval
SAFETY = 0.8  # of the step that would just fit
WORTHWHILE, MOST = 1.2, 5.0  # a longer step is taken from the first, at most the second
LEAST = 0.2  # to which a step is cut at once
STRETCH = 1.1  # a last step may be as much longer as this to end the interval
THIRD = 1 / 3  # errors grow as h^3


@dataclass(frozen=True, slots=True)
class Solution:
    """A solution `x (T, X)`, NaN from where no step was short enough; and the steps it took."""

    x: Array
    steps: int
    rejected: int


def six_states(model: Model, p: Named, inputs: Mapping[str, float]) -> tuple[Array, Array]:
    """Return `A (6, 6)` and forcing `(6,)` with the charge q, in the order of `SIX_STATES`."""
    linear = model.linear(p)
    matrix = dynamics(linear, SIX_STATES, 1)[0]
    matrix[SIX_STATES.index("q"), SIX_STATES.index("i")] = 1.0
    return matrix, constant_forcing(linear, SIX_STATES, 1, inputs)[0]


def integrate(
    matrix: Array, forcing: Array, x0: Array, t: Array, rtol: float = 1e-3, atol: float = 1e-6
) -> Solution:
    """Integrate `x' = matrix x + forcing` from `x0 (X,)` at `t[0]`, at increasing times `t (T,)`.

    Raises `ValueError` where times do not increase or a tolerance is not positive.
    """
    if not (rtol > 0 and atol > 0):
        raise ValueError(f"tolerances {rtol:g} and {atol:g} must be positive")
    if len(t) == 0 or not np.all(np.diff(t) > 0):
        raise ValueError("times must increase")
    with np.errstate(all="ignore"):  # what overflows is found out by its error, which is no number
        ends, states, slopes, rejected = _march(matrix, forcing, x0, t, rtol, atol)
        x = _between(np.array(ends), np.array(states), np.array(slopes), t)
    return Solution(x=x, steps=len(ends) - 1, rejected=rejected)


def _march(
    matrix: Array, forcing: Array, x0: Array, t: Array, rtol: float, atol: float
) -> tuple[list[float], list[Array], list[Array], int]:
    """Ends of the steps, states and slopes there, and how many steps were tried in vain."""
    now, end = float(t[0]), float(t[-1])
    least = atol / rtol
    x = np.array(x0, dtype=np.float64)
    slope = matrix @ x + forcing
    size = np.maximum(np.abs(x), least)
    ends, states, slopes, rejected = [now], [x], [slope], 0
    longest = LONGEST * (end - now)
    rate = float(np.max(np.abs(slope) / size))
    # As long as a third-order error of that relative rate of change allows.
    h = min(longest, SAFETY * rtol**THIRD / rate) if rate > 0 else longest
    inverse_step, inverse = 0.0, matrix  # the step that `inverse` is for
    # Slope of the slope over the step before; at the start, the true one, as of a step of length 0.
    bend, before = matrix @ slope, 0.0
    while now < end:
        if STRETCH * h >= end - now:
            h = end - now
        if not h > 16 * np.spacing(max(abs(now), abs(end))) and h < end - now:
            break
        if h != inverse_step:
            inverse, inverse_step = _inverse(matrix, h), h
        x_new = x + inverse @ (h * slope)
        slope_new = matrix @ x_new + forcing
        bend_new = (slope_new - slope) / h
        size_new = np.abs(x_new)
        sizes = np.maximum(np.maximum(size, size_new), least)
        error = float(np.max(np.abs(bend_new - bend) / sizes))
        error *= h**3 / (6 * (h + before))
        if not error <= rtol:  # nor if it is no number
            rejected += 1
            fitting = SAFETY * (rtol / error) ** THIRD
            h *= max(fitting, LEAST) if math.isfinite(fitting) else LEAST
            continue
        now = end if h == end - now else now + h
        x, slope, size, bend, before = x_new, slope_new, size_new, bend_new, h
        ends.append(now)
        states.append(x)
        slopes.append(slope)
        factor = min(SAFETY * (rtol / error) ** THIRD, MOST) if error > 0 else MOST
        if factor >= WORTHWHILE:
            h = min(factor * h, longest)
    return ends, states, slopes, rejected


def _inverse(matrix: Array, h: float) -> Array:
    """(1 - h A/2)^-1; no numbers where there is none, which is then a step in vain."""
    lhs = np.eye(len(matrix)) - 0.5 * h * matrix
    try:
        return np.linalg.inv(lhs)
    except np.linalg.LinAlgError:
        return np.full_like(lhs, np.nan)


def _between(ends: Array, states: Array, slopes: Array, t: Array) -> Array:
    """The interpolant at `t`; NaN behind the last end."""
    k = np.clip(np.searchsorted(ends, t, side="left") - 1, 0, max(len(ends) - 2, 0))
    after = np.minimum(k + 1, len(ends) - 1)
    h = ends[after] - ends[k]
    run = t - ends[k]
    turn = np.divide(run**2, 2 * h, out=np.zeros_like(run), where=h > 0)
    x = states[k] + run[:, None] * slopes[k] + turn[:, None] * (slopes[after] - slopes[k])
    x[t > ends[-1]], x[t == ends[0]] = np.nan, states[0]
    return np.asarray(x)


@dataclass(frozen=True, slots=True)
class AsPrinted(Model):
    """The rig with the matrix that the paper prints, whose errors the two fields can mend.

    `i_n` is the undefined factor in A(6,5), read as `i_m` where it is None; 1/i_m is right.
    `a_51` is the inertia that A(5,1) stands over; j_m is right.
    """

    i_m: float = 1 / 8
    i_n: float | None = None
    a_51: Literal["j_1", "j_m"] = "j_1"

    name: ClassVar[str] = "as_printed"
    declares: ClassVar[tuple[Symbol, ...]] = ()
    parameters: ClassVar[tuple[str, ...]] = MotorShaft.parameters
    states: ClassVar[tuple[str, ...]] = MotorShaft.states
    inputs: ClassVar[tuple[str, ...]] = MotorShaft.inputs

    def linear(self, p: Named) -> Linear:
        """Return the linear model as the paper prints it."""
        right = MotorShaft(self.i_m).linear(p)
        i_n = self.i_m if self.i_n is None else self.i_n
        printed = {
            ("w_2", "theta_1"): self.i_m**2 * p["k_s"] / p[self.a_51],
            ("i", "w_2"): -i_n * p["k_e"] / p["l_m"],
        }
        return Linear(A={**right.A, **printed}, B=right.B, c=right.c)


GEAR = 1 / MotorShaft().i_m  # the right i_n
READINGS: Mapping[str, tuple[str, AsPrinted]] = {
    "right": (
        "A(5,1) over j_m, A(6,5) with 1/i_m: the equations",
        AsPrinted(a_51="j_m", i_n=GEAR),
    ),
    "a_51": ("A(5,1) over j_1 as printed, i_n read as 1/i_m", AsPrinted(i_n=GEAR)),
    "i_n": ("A(5,1) over j_m, i_n read as i_m", AsPrinted(a_51="j_m")),
    "printed": ("as printed, i_n read as i_m", AsPrinted()),
}  # names, and what they mean
FOLLOWED = 30.0  # s; the speed of theta_2 has settled by then but for a swing that dies out


@dataclass(frozen=True, slots=True, kw_only=True)
class MatrixReading:
    """A way to read the printed matrix: the speed of theta_2 [rad/s] at `time` [s] and in the end.

    `row`: of the table, with the `error` of the paper's integrator until `time`, in `steps`;
    `curve (T,)`: the speed at `t (T,)`.
    """

    row: Row
    t: Array
    curve: Array


def regular(experiment: Experiment, duration: float, rate: float) -> Experiment:
    """Return the same with `duration` [s] at `rate` [Hz] from 0, constant inputs and zero signals."""
    t = np.arange(round(duration * rate) + 1) / rate
    return dataclasses.replace(experiment, t=t, y=np.zeros((len(t), len(experiment.channels))))


def readings(experiment: Experiment, p: Mapping[str, float]) -> tuple[MatrixReading, ...]:
    """Return the same step with each reading, at parameters `p` (SI), followed for `FOLLOWED` s."""
    experiment = regular(experiment, FOLLOWED, 1 / experiment.dt)
    k = experiment.names.index("w_2")

    def reading(name: str, matrix: str, model: Model) -> MatrixReading:
        exact, stepped, steps = _both(model, experiment, p)
        end = derived.steady_values(model, model.linear(p), 1, experiment.constant)["w_end"]
        row = {
            "name": name,
            "matrix": matrix,
            "time": float(experiment.t[-1]),
            "w_2": float(exact[-1, k]),
            "w_2_trapezoid": float(stepped[-1, k]),
            "w_end": float(end[0]),
            "error": float(np.abs(stepped - exact)[:, k].max()),
            "steps": steps,
        }
        return MatrixReading(row=row, t=experiment.t, curve=exact[:, k])

    return tuple(reading(name, *what) for name, what in READINGS.items())


def errors(experiment: Experiment, p: Mapping[str, float]) -> list[Row]:
    """Return the errors of the paper's integrator on the corrected model, by channel."""
    exact, stepped, steps = _both(MotorShaft(), experiment, p)
    off = stepped - exact
    return [
        {
            "channel": name,
            "largest": float(np.abs(off[:, k]).max()),
            "rms": float(np.sqrt(np.mean(off[:, k] ** 2))),
            "steps": steps,
        }
        for k, name in enumerate(experiment.names)
    ]


def _both(model: Model, experiment: Experiment, p: Mapping[str, float]) -> tuple[Array, Array, int]:
    """Channels `(T, K)` exact and as the paper integrates, and the steps that it takes."""
    row = np.array([p[name] for name in model.parameters])
    exact = Response(model, experiment).signals(row[None])[0]
    return (exact, *paper_signals(model, experiment, row))


def paper_signals(model: Model, experiment: Experiment, p: Array) -> tuple[Array, int]:
    """Return channels `(T, K)` as the paper integrates, at parameters `p (P,)`; and the steps."""
    if experiment.series:
        raise ValueError(f"{', '.join(experiment.series)} must be constant")
    named = dict(zip(model.parameters, p, strict=True))
    matrix, forcing = six_states(model, named, experiment.constant)
    start = np.array([experiment.start.get(name, 0.0) for name in SIX_STATES])
    lead = [experiment.t_start] if experiment.t_start < experiment.t[0] else []
    solution = integrate(matrix, forcing, start, np.array([*lead, *experiment.t]))
    return solution.x[len(lead) :] @ experiment.weights(SIX_STATES).T, solution.steps


def stepped_signals(likelihood: Likelihood, theta: Array) -> Array:
    """Return the channels without noise, `(T, K)`, at `theta (D,)`."""
    (full,) = likelihood.space.full(theta[None])
    observation = likelihood.only_observation
    return paper_signals(observation.response.model, observation.experiment, full)[0]


def stepped_misfit(likelihood: Likelihood, theta: Array) -> float:
    """Return the misfit per number at one point `(D,)`; for known noise."""
    observation = likelihood.only_observation
    sigma = observation.noise.scales(np.empty((1, 0)))
    off = stepped_signals(likelihood, theta) - observation.experiment.y
    return float(np.mean((off / sigma) ** 2))


def stepped_task(exact: Task, likelihood: Likelihood) -> Task:
    """Pose the task with the integrator's misfit; `exact` says where the density is above zero."""

    def density(theta: Array) -> Array:
        inside = exact.density(theta) > -np.inf
        half, rows = 0.5 * likelihood.n_measured, zip(theta, inside, strict=True)
        values = [-half * stepped_misfit(likelihood, x) if good else -np.inf for x, good in rows]
        return np.asarray(np.nan_to_num(values, nan=-np.inf, neginf=-np.inf))

    return dataclasses.replace(exact, density=density)
