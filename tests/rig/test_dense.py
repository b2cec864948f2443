"""Walkers with starts and sensors of their own, at any times, against steps in extended precision."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from oracles import NOMINAL, ORDER
from rigs import STATES, experiment, vector
from together import for_each

from bayesdrill.rig.kernels.sums import SQUARES
from bayesdrill.rig.models.linear import Linear, Model, Tangent
from bayesdrill.rig.models.motor_shaft import MotorShaft, TwoRotors
from bayesdrill.rig.simulators.exact import Response
from bayesdrill.rig.simulators.irregular import Dense

LONG = np.longdouble
W, STEP = 9, 0.01
FOUR = {name: {name: 1.0} for name in STATES[:4]}


@dataclass(frozen=True)
class Toy(Model):
    """a'' = -w^2 a - z a' + v: two numbers of very different size, hardly damped."""

    name = "toy"
    declares = ()
    parameters = ("w", "z")
    states = ("a", "b")
    inputs = ("v", "t_1")

    def linear(self, p: Any) -> Linear:
        A = {("a", "b"): 1.0, ("b", "a"): -(p["w"] ** 2), ("b", "b"): -p["z"]}
        return Linear(A=A, B={("b", "v"): 1.0, ("b", "t_1"): p["z"]}, c={"a": 0.1 * p["z"]})


def exponential(m: np.ndarray) -> np.ndarray:
    """exp(m) - 1 by squarings of a series: beside a one, slow states would be lost."""
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


class Oracle:
    """One walker: the exact solution from knot to knot, and from a knot to any time."""

    def __init__(self, model, p, t, series, constant, first_order) -> None:
        linear = model.linear(p)
        n, s = len(model.states), len(series)
        row = {name: k for k, name in enumerate(model.states)}
        self.a, self.b, self.c = np.zeros((n, n)), np.zeros((n, s)), np.zeros(n)
        for (one, other), value in linear.A.items():
            self.a[row[one], row[other]] = value
        for name, value in linear.c.items():
            self.c[row[name]] = value
        for (name, of), value in linear.B.items():
            if of in series:
                self.b[row[name], list(series).index(of)] = value
            else:
                self.c[row[name]] += value * constant.get(of, 0.0)
        self.t, self.u = t, np.array([*series.values()]).reshape(s, len(t)).T
        self.slopes = np.zeros_like(self.u)
        if first_order and s:
            self.slopes[:-1] = np.diff(self.u, axis=0) / np.diff(t)[:, None]

    def on(self, x: np.ndarray, j: int, s: Any) -> np.ndarray:
        n = len(self.a)
        m = np.zeros((n + 2, n + 2), dtype=LONG)
        m[:n, :n] = self.a
        m[:n, n] = self.c + self.b @ self.u[j]
        m[:n, n + 1] = self.b @ self.slopes[j]
        m[n + 1, n] = 1
        z = np.concatenate([x, [LONG(1), LONG(0)]])
        return (z + exponential(m * s) @ z)[:n]

    def signals(self, x0, before, shift, rows) -> np.ndarray:
        """(T, K)."""
        t = self.t.astype(LONG)
        states = [x0.astype(LONG)]
        for j in range(len(t) - 1):
            states.append(self.on(states[j], j, t[j + 1] - t[j]))
        out = np.zeros((len(t), len(shift)))
        for k, i in np.ndindex(len(shift), len(t)):
            tau = t[i] - LONG(shift[k])
            if tau < t[0]:
                x, u = x0 + (tau - t[0]) * before, self.u[0]
            else:
                j = int(np.searchsorted(t, tau, side="right")) - 1
                x = self.on(states[j], j, tau - t[j]) if tau > t[j] else states[j]
                u = self.u[j] + self.slopes[j] * (tau - t[j])
            out[i, k] = rows[k] @ np.concatenate([x, [1.0], u])
        return out


def times(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    even = 3.0 + STEP * np.arange(n)
    jitter = 0.3 * STEP * rng.uniform(-1, 1, n)
    gap = np.where(np.arange(n) >= n // 2, 1.0, 0.0)
    return {
        "uniform": even,
        "left out": 3.0 + STEP * (np.arange(n) + np.arange(n) // 5),
        "gaps": even + 0.0731 * gap,
        "jitter": even + jitter,
        "long gap": even + jitter + (500 * STEP + 0.004) * gap,
    }[kind]


def walkers(model, n_series: int, k_count: int, rng: np.random.Generator, shift: Any):
    """Parameters over decades, two stiff: norms of A times a step up to 1e7."""
    if isinstance(model, Toy):
        theta = np.exp(rng.normal(0, 1, (W, 2))) * [30.0, 2.0]
        theta[2] = [1e3, 3e5]
    else:
        theta = vector(NOMINAL) * np.exp(rng.normal(0, 1, (W, 9)))
        theta[2, ORDER.index("l_m")] *= 1e-4
        theta[5, ORDER.index("l_m")] *= 1e-7
    x = len(model.states)
    x0, before = rng.normal(0, 1, (2, W, x))
    rows = rng.normal(0, 1, (W, k_count, x + 1 + n_series))
    rows[:, 0, x:] = 0.0
    if shift is None:
        return theta, x0, before, None, rows
    # One channel is not shifted; some walkers not either, and two the other way or by far.
    shifts = STEP * (np.array(shift) + rng.normal(0, 0.3, (W, k_count)))
    shifts[:, 2] = 0.0
    shifts[4] = 0.0
    shifts[6, 1], shifts[7, 0] = -3.3 * STEP, -40.7 * STEP
    return theta, x0, before, shifts, rows


SHIFTS = (2.4, -0.7, 0.0, 30.0)


def squares(dense: Dense, *walkers_and_record: np.ndarray | None) -> np.ndarray:
    *walkers, y = walkers_and_record
    return dense.sums(tuple(walkers), y, SQUARES)[..., 0]


def test_equals_steps_in_extended_precision() -> None:
    kinds = ["uniform", "left out", "gaps", "jitter", "long gap"]
    cases = [
        (MotorShaft(), False, (), SHIFTS),
        (MotorShaft(), True, ("v", "t_1"), SHIFTS),
        (TwoRotors(0.2, 7e-3, 0.2), False, ("t_1", "v"), SHIFTS),
        (Toy(), True, ("v",), SHIFTS),
        (Toy(), False, ("v",), None),
    ]

    def check(kind: str, model, first_order, names, shift) -> None:
        rng = np.random.default_rng(5)
        n = 22
        t = times(kind, n, rng)
        series = {name: rng.normal(3, 1, n) for name in names}
        constant = {name: 0.7 for name in ("v", "t_1") if name not in names}
        theta, x0, before, shifts, rows = walkers(model, len(names), 4, rng, shift)
        dense = Dense(model, t, series, constant, first_order)
        found = dense.signals(theta, x0, before, shifts, rows)
        zero = np.zeros(4)
        for w in range(W):
            p = dict(zip(model.parameters, theta[w], strict=True))
            oracle = Oracle(model, p, t, series, constant, first_order)
            true = oracle.signals(x0[w], before[w], zero if shifts is None else shifts[w], rows[w])
            assert np.abs(found[w] - true).max() < 1e-11 * np.abs(true).max()
        y = rng.normal(0, 1, (n, 4))
        y[rng.uniform(size=y.shape) < 0.3] = np.nan
        sums = np.nansum((y - found) ** 2, axis=1)
        assert np.allclose(squares(dense, theta, x0, before, shifts, rows, y), sums, rtol=1e-12)

    for_each({f"{kind} {case}": (kind, *case) for kind in kinds for case in cases}, check)


def test_few_samples() -> None:
    """Mutant killed: a last step that is taken though it leads nowhere."""

    def check(n: int) -> None:
        rng = np.random.default_rng(6)
        t = np.array([1.0, 1.013, 1.1])[:n]
        series = {name: rng.normal(3, 1, n) for name in ("v", "t_1")}
        theta, x0, before, shifts, rows = walkers(MotorShaft(), 2, 4, rng, SHIFTS)
        dense = Dense(MotorShaft(), t, series, {}, True)
        found = dense.signals(theta, x0, before, shifts, rows)
        for w in range(W):
            p = dict(zip(ORDER, theta[w], strict=True))
            oracle = Oracle(MotorShaft(), p, t, series, {}, True)
            true = oracle.signals(x0[w], before[w], shifts[w], rows[w])
            assert np.abs(found[w] - true).max() < 1e-11 * np.abs(true).max()

    for_each({str(n): (n,) for n in [1, 2, 3]}, check)


def test_a_plain_experiment_is_the_response() -> None:
    def check(first_order: bool) -> None:
        rng = np.random.default_rng(7)
        n = 3001
        series = {"v": rng.normal(6, 1, n)}
        y = rng.normal(0, 3, (n, 4))
        record = experiment(
            n, constant={"t_1": 0.02}, series=series, measures=FOUR, y=y, first_order=first_order
        )
        theta = vector(NOMINAL) * rng.uniform(0.5, 1.5, (11, 9))
        start, rows = np.zeros((11, 5)), np.broadcast_to(np.eye(4, 7), (11, 4, 7))
        dense = Dense(MotorShaft(), record.t, series, {"t_1": 0.02}, first_order)
        plain = Response(MotorShaft(), record)
        found, true = dense.signals(theta, start, start, None, rows), plain.signals(theta)
        assert np.abs(found - true).max() < 1e-11 * np.abs(true).max()
        sums = squares(dense, theta, start, start, None, rows, y)
        assert np.allclose(sums, plain.squares(theta), rtol=1e-11)

    for_each({str(first_order): (first_order,) for first_order in [False, True]}, check)


def test_samples_between_change_nothing() -> None:
    """Of a long record with jitter and dropouts, under an input that is straight between samples."""
    rng = np.random.default_rng(8)
    n = 6000
    t = STEP * (np.sort(rng.choice(n + 300, n, replace=False)) + 0.3 * rng.uniform(-1, 1, n))
    some = np.sort(rng.choice(n, n // 3, replace=False))
    some[0] = 0
    v = np.interp(t, t[some], rng.normal(6, 1, len(some)))
    theta = vector(NOMINAL) * rng.uniform(0.7, 1.4, (3, 9))
    start, rows = rng.normal(0, 1, (3, 5)), rng.normal(0, 1, (3, 4, 7))
    shift = STEP * np.array([2.4, -0.7, 0.0, 30.3]) * rng.uniform(0.9, 1.1, (3, 4))

    def seen(which: np.ndarray) -> np.ndarray:
        dense = Dense(MotorShaft(), t[which], {"v": v[which]}, {}, True)
        return dense.signals(theta, start, start, shift, rows)

    all_, few = seen(np.arange(some[-1] + 1))[:, some], seen(some)
    assert np.abs(all_ - few).max() < 1e-10 * np.abs(few).max()


def test_the_tangent_is_the_central_difference() -> None:
    def check(kind: str) -> None:
        rng = np.random.default_rng(9)
        n, h = 200, 1e-5
        t = times(kind, n, rng)
        series = {"v": rng.normal(6, 1, n)}
        theta = vector(NOMINAL) * rng.uniform(0.8, 1.2, (5, 9))
        along = vector(NOMINAL) * rng.normal(0, 1, (5, 9))
        x0, x0_along, before, before_along = rng.normal(0, 1, (4, 5, 5))
        rows = np.concatenate([rng.normal(0, 1, (5, 4, 5)), np.zeros((5, 4, 2))], axis=2)
        shift = STEP * rng.uniform(0.1, 3.9, (5, 4))
        plain = Dense(MotorShaft(), t, series, {}, False)

        def at(step: float) -> np.ndarray:
            start, rate = x0 + step * x0_along, before + step * before_along
            return plain.signals(theta + step * along, start, rate, shift, rows)

        of_slopes = np.concatenate([np.zeros((5, 4, 5)), rows], axis=2)
        both = [np.concatenate(pair, axis=1) for pair in ((theta, along), (x0, x0_along))]
        tangent = Dense(Tangent(MotorShaft()), t, series, {}, False)
        rates = np.concatenate([before, before_along], axis=1)
        found = tangent.signals(*both, rates, shift, of_slopes)
        true = (at(h) - at(-h)) / (2 * h)
        assert np.abs(found - true).max() < 1e-7 * np.abs(true).max()

    for_each({kind: (kind,) for kind in ["uniform", "jitter"]}, check)


def test_a_walker_does_not_depend_on_its_neighbours() -> None:
    """Bits, though lanes halve cells as often as each needs, and walkers alone are not shifted.

    Mutant killed: the degree of a series that the lanes share.
    """

    def check(kind: str) -> None:
        rng = np.random.default_rng(10)
        t = times(kind, 50, rng)
        dense = Dense(MotorShaft(), t, {"v": rng.normal(6, 1, 50)}, {}, True)
        n = 64
        theta = vector(NOMINAL) * np.exp(rng.normal(0, 1.5, (n, 9)))
        x0, before = rng.normal(0, 1, (2, n, 5))
        rows = rng.normal(0, 1, (n, 3, 7)) * (rng.uniform(size=(3, 7)) < 0.5)
        shift = STEP * rng.normal(0, 3, (n, 3)) * [1.0, 0.0, 1.0] * (np.arange(n) % 3 > 0)[:, None]
        y = rng.normal(0, 1, (50, 3))
        one = [slice(w, w + 1) for w in range(n)]
        together = dense.signals(theta, x0, before, shift, rows)
        alone = [dense.signals(theta[w], x0[w], before[w], shift[w], rows[w])[0] for w in one]
        assert np.array_equal(alone, together)
        sums = squares(dense, theta, x0, before, shift, rows, y)
        each = [squares(dense, theta[w], x0[w], before[w], shift[w], rows[w], y)[0] for w in one]
        assert np.array_equal(each, sums)

    for_each({kind: (kind,) for kind in ["uniform", "jitter"]}, check)


def test_an_overflowing_walker_leaves_its_neighbours_alone() -> None:
    rng = np.random.default_rng(11)
    dense = Dense(MotorShaft(), times("jitter", 60, rng), {}, {"v": 8.0}, False)
    theta = vector(NOMINAL) * rng.uniform(0.5, 1.5, (8, 9))
    x0, before, rows = rng.normal(0, 1, (8, 5)), np.zeros((8, 5)), rng.normal(0, 1, (8, 2, 6))
    shift, y = STEP * rng.uniform(0, 3, (8, 2)), rng.normal(0, 1, (60, 2))
    true = squares(dense, theta, x0, before, shift, rows, y)
    sick, late = theta.copy(), shift.copy()
    sick[2, ORDER.index("l_m")] = 0.0
    sick[5, ORDER.index("j_m")] = 1e-300
    late[6] = np.nan
    for moved in (late, None):
        found = squares(dense, sick, x0, before, moved, rows, y)
        healthy = [0, 1, 3, 4, 7]
        assert not np.isfinite(found[[2, 5]]).any()
        if moved is not None:
            assert np.isnan(found[6]).all()
            assert np.array_equal(found[healthy], true[healthy])
