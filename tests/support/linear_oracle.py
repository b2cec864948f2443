"""The oracle of all simulators of linear rigs: what sensors show, in 80-bit numbers, step by step.

Of the package it takes the matrices of a rig alone; `rig/models/test_motor_shaft.py` and
`rig/models/test_equations.py` hold these against the balances of the bodies.
"""

from typing import Any

import numpy as np

from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.sensors import ObservationModel

LONG = np.longdouble


def exponential(m: np.ndarray) -> np.ndarray:
    """Return exp(m) - 1 by squarings of a series; beside a one, slow states would lose digits."""
    size = float(np.abs(m).sum(axis=1).max())
    halvings = max(0, int(np.ceil(np.log2(size / 0.5)))) if size > 0 else 0
    a = m / LONG(2) ** halvings
    term = total = a
    for k in range(2, 22):
        term = term @ a / k
        total = total + term
    for _ in range(halvings):
        total = 2 * total + total @ total
    return total


def series(m: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return (exp(m) - 1) times `start`, by the series itself, which loses nothing where m is small."""
    term, total = start, 0 * start
    for k in range(1, 60):
        term = m @ term / k
        total, before = total + term, total
        if k > 8 and np.array_equal(total, before):
            break
    return total


class ExactMotion:
    """A rig with the parameters `full (P,)`, those of sensors last, under the inputs of `record`.

    Entries of its matrices have the digits of `full`, as those of the package have 64 bits.
    """

    def __init__(
        self,
        model: Model,
        record: Experiment,
        full: np.ndarray,
        sensing: ObservationModel | None = None,
    ) -> None:
        self.model, self.record, self.sensing = model, record, sensing or ObservationModel()
        names = (*model.parameters, *self.sensing.names)
        self.p: dict[str, Any] = dict(zip(names, full, strict=True))
        self.row = {name: k for k, name in enumerate(model.states)}
        linear, x, s = model.linear(self.p), len(model.states), len(record.series)
        series = [*record.series]
        self.m = np.zeros(
            (x + 1 + 2 * s, x + 1 + 2 * s), dtype=LONG
        )  # of states, 1, inputs, slopes
        for (one, other), value in linear.A.items():
            self.m[self.row[one], self.row[other]] += value
        for name, value in linear.c.items():
            self.m[self.row[name], x] += value
        for (name, of), value in linear.B.items():
            if of in series:
                self.m[self.row[name], x + 1 + series.index(of)] += value
            else:
                self.m[self.row[name], x] += value * self.felt(of, record.constant.get(of, 0.0))
        self.m[x + 1 : x + 1 + s, x + 1 + s :] = np.eye(s)
        self.t = record.t.astype(LONG)
        inputs = [self.felt(name, u.astype(LONG)) for name, u in record.series.items()]
        self.u = np.array(inputs, dtype=LONG).reshape(s, len(self.t)).T
        if record.t_start < record.t[0]:
            self.t = np.append(LONG(record.t_start), self.t)
            self.u = np.concatenate([self.u[:1], self.u])
        self.slopes = np.zeros_like(self.u)
        if record.first_order and s:
            self.slopes[:-1] = np.diff(self.u, axis=0) / np.diff(self.t)[:, None]
        self.powers: dict[Any, np.ndarray] = {}

    def felt(self, name: str, u: Any) -> Any:
        """Return an input as the rig feels it."""
        gains, offsets = self.sensing.input_gains, self.sensing.input_offsets
        gain = self.p[gains[name]] if name in gains else LONG(1)
        return gain * u + (self.p[offsets[name]] if name in offsets else LONG(0))

    def start(self) -> np.ndarray:
        """Return the states at the start; a steady one solves the linear equations of a turn."""
        known = {**self.record.start, **{n: self.p[of] for n, of in self.sensing.states.items()}}
        x0 = np.array([known.get(name, 0.0) for name in self.model.states], dtype=LONG)
        if not self.sensing.steady:
            return x0
        rates, free = self.m[: len(x0)], self.u[0]
        drive = rates[:, len(x0)] + rates[:, len(x0) + 1 : len(x0) + 1 + len(free)] @ free
        angles = [self.row[name] for name in self.model.angles]
        rates, held = rates[:, : len(x0)], next(k for k in angles if self.model.states[k] in known)
        rows = [[*rates[k], -drive[k]] for k in range(len(x0)) if k not in angles]
        both = zip(angles[1:], angles, strict=False)
        rows += [[*(rates[k] - rates[j]), drive[j] - drive[k]] for k, j in both]
        rows += [[*np.eye(len(x0))[held], x0[held]]]
        system = np.array(rows)
        solution = np.zeros_like(x0)
        for _ in range(2):  # the second time with the digits that are left
            left = system[:, -1] - system[:, :-1] @ solution
            solution += np.linalg.solve(system[:, :-1].astype(float), left.astype(float))
        return solution

    def on(self, x: np.ndarray, j: int, step: Any) -> np.ndarray:
        """Return the states a `step` after knot `j`, where they are `x`."""
        z, m = np.concatenate([x, [LONG(1)], self.u[j], self.slopes[j]]), self.m * LONG(step)
        if step not in self.powers:
            small = np.abs(np.linalg.eigvals(m.astype(float))).max() < 4
            if small and not self.record.uniform:  # few steps are alike
                return (z + series(m, z))[: len(x)]
            self.powers[step] = series(m, np.eye(len(m))) if small else exponential(m)
        return (z + self.powers[step] @ z)[: len(x)]

    def states(self) -> np.ndarray:
        """Return the states at the knots, `(N, X)`."""
        out, uniform = [self.start()], self.record.uniform
        for j in range(len(self.t) - 1):
            step = self.t[j + 1] - self.t[j]
            if uniform:  # as it was meant, whatever the times were rounded to
                step = LONG(float(f"{float(step):.12g}"))
            out.append(self.on(out[j], j, step))
        return np.array(out)

    def signals(self) -> np.ndarray:
        """Return what channels show, `(T, K)`."""
        sensing, record, states = self.sensing, self.record, self.states()
        x0, before = states[0], np.zeros_like(states[0])
        if sensing.may_move(record.start, self.model.angles):
            z = np.concatenate([x0, [LONG(1)], self.u[0], 0 * self.u[0]])
            before = (self.m @ z)[: len(x0)]
        delay = self.p[sensing.delay] if sensing.delay else LONG(0)
        out = np.zeros((len(record.t), len(record.channels)), dtype=LONG)
        for k, channel in enumerate(record.channels):
            weights = record.weights(self.model.states)[k]
            late = delay + (
                self.p[sensing.lags[channel.name]] if channel.name in sensing.lags else 0
            )
            shown = states[-len(record.t) :]
            if late:
                shown = np.array([self.at(t - late, states, before) for t in self.t])[
                    -len(record.t) :
                ]
            gain = self.p[sensing.gains[channel.name]] if channel.name in sensing.gains else 1
            offset = self.p[sensing.offsets[channel.name]] if channel.name in sensing.offsets else 0
            out[:, k] = gain * (shown @ weights) + offset
        return out

    def at(self, tau: Any, states: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Return the states at any time; before the start they go on as they begin."""
        if tau < self.t[0]:
            return states[0] + (tau - self.t[0]) * before
        j = int(np.searchsorted(self.t, tau, side="right")) - 1
        return self.on(states[j], j, tau - self.t[j]) if tau > self.t[j] else states[j]
