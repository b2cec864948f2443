"""The paper's forward model beside the exact one: its printed matrix, and its integrator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.insight import derived
from bayesdrill.paper.as_printed import AsPrinted
from bayesdrill.paper.studies import trapezoid
from bayesdrill.record import Experiment, regular
from bayesdrill.rig import Model, MotorShaft, Response

Array = NDArray[np.float64]

GEAR = 1 / MotorShaft().i_m  # the right i_n; the models read it as i_m unless told
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
class Reading:
    """A way to read the printed matrix: the speed of theta_2 [rad/s] at `time` [s] and in the end.

    `error`: largest distance of the paper's integrator from the exact speed until `time`, `steps`
    its steps; `curve (T,)`: the speed at times `t (T,)` [s].
    """

    name: str
    matrix: str
    time: float
    w_2: float
    w_2_trapezoid: float
    w_end: float
    error: float
    steps: int
    t: Array
    curve: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Error:
    """Of the paper's integrator in one channel of the record, at its default tolerances."""

    channel: str
    largest: float
    rms: float
    steps: int


def readings(experiment: Experiment, p: Mapping[str, float]) -> tuple[Reading, ...]:
    """The same step with each reading, at parameters `p` (SI), followed for `FOLLOWED` s."""
    experiment = regular(experiment, FOLLOWED, 1 / experiment.dt)
    found = []
    for name, (matrix, model) in READINGS.items():
        exact = Response(model, experiment).signals(_row(model, p))[0]
        w_2 = exact[:, experiment.names.index("w_2")]
        stepped, steps = signals(model, experiment, _row(model, p)[0])
        approximate = stepped[:, experiment.names.index("w_2")]
        end = derived.steady(model, model.linear(p), 1, experiment.constant)["w_end"]
        found.append(
            Reading(
                name=name,
                matrix=matrix,
                time=float(experiment.t[-1]),
                w_2=float(w_2[-1]),
                w_2_trapezoid=float(approximate[-1]),
                w_end=float(end[0]),
                error=float(np.abs(approximate - w_2).max()),
                steps=steps,
                t=experiment.t,
                curve=w_2,
            )
        )
    return tuple(found)


def errors(experiment: Experiment, p: Mapping[str, float]) -> tuple[Error, ...]:
    """Of the integrator on the corrected model."""
    model = MotorShaft()
    exact = Response(model, experiment).signals(_row(model, p))[0]
    stepped, steps = signals(model, experiment, _row(model, p)[0])
    off = stepped - exact
    return tuple(
        Error(
            channel=name,
            largest=float(np.abs(off[:, k]).max()),
            rms=float(np.sqrt(np.mean(off[:, k] ** 2))),
            steps=steps,
        )
        for k, name in enumerate(experiment.names)
    )


def signals(model: Model, experiment: Experiment, p: Array) -> tuple[Array, int]:
    """Channels `(T, K)` as the paper integrates, at parameters `p (P,)`; and the steps taken.

    Raises `ValueError` unless all inputs are constant, as they are in the paper.
    """
    if experiment.series:
        raise ValueError(f"{', '.join(experiment.series)} must be constant")
    named = dict(zip(model.parameters, p, strict=True))
    matrix, forcing = trapezoid.six_states(model, named, experiment.constant)
    start = np.array([experiment.start.get(name, 0.0) for name in trapezoid.SIX_STATES])
    lead = [experiment.t_start] if experiment.t_start < experiment.t[0] else []
    solution = trapezoid.integrate(matrix, forcing, start, np.array([*lead, *experiment.t]))
    weights = [
        [channel.weights.get(name, 0.0) for name in trapezoid.SIX_STATES]
        for channel in experiment.channels
    ]
    return solution.x[len(lead) :] @ np.array(weights).T, solution.steps


def _row(model: Model, p: Mapping[str, float]) -> Array:
    return np.array([[p[name] for name in model.parameters]])
