"""Drive trains integrated by SciPy, from masses, springs and gears that are typed in anew.

All angles are T times those of the free coordinates.  Then T' J T is the mass matrix, and a torque at
an inertia acts on the coordinates by T'.  Dry friction is integrated from event to event: a coordinate
slips with the sign of its speed until that is zero, and sticks up to its friction.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy.integrate

from bayesdrill.rig.models.train import Train

Spring = tuple[int, int | None, float, float]  # ends, stiffness, damping


def springs(train: Train, p: dict[str, float]) -> list[Spring]:
    """Return those of a train's shafts; an end at the ground stands last, as None."""
    place = {name: k for k, name in enumerate(train.inertias)}
    out = list[Spring]()
    for shaft in train.shafts:
        first, *second = (place[end] for end in shaft.ends if end in place)
        numbers = p[f"k_{shaft.name}"], p.get(f"c_{shaft.name}", 0.0)
        out.append((first, second[0] if second else None, *numbers))
    return out


@dataclass
class Oracle:
    """A train of n inertias on q coordinates, of which each inertia turns by `ratios (n, q)`, as T."""

    inertias: np.ndarray
    ratios: np.ndarray
    springs: list[Spring]
    dampers: np.ndarray  # of each inertia, to the ground
    sliding: np.ndarray  # of each coordinate
    weights: np.ndarray  # m g l of each inertia
    tilts: np.ndarray
    push: Callable[[float], np.ndarray] = field(default=lambda t: np.zeros(0))

    def __post_init__(self) -> None:
        n, q = self.ratios.shape
        stiffness, damping = np.zeros((n, n)), np.diag(self.dampers)
        for first, second, k, c in self.springs:
            d = np.zeros(n)
            d[first] = 1.0
            if second is not None:
                d[second] = -1.0
            stiffness += k * np.outer(d, d)
            damping = damping + c * np.outer(d, d)
        t = self.ratios
        self.mass = t.T @ np.diag(self.inertias) @ t
        self.k, self.c = t.T @ stiffness @ t, t.T @ damping @ t
        self.q = q

    def force(self, t: float, angle: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Return all that acts on coordinates, without dry friction."""
        gravity = self.weights * np.sin(self.ratios @ angle + self.tilts)
        pushed = self.ratios.T @ (self.push(t) - gravity)
        return pushed - self.k @ angle - self.c @ speed

    def solve(self, times: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Return states (angles, speeds) at `times`, between which the push is constant."""
        states = [start]
        for begin, end in itertools.pairwise(times):
            states.append(self._between(begin, end, states[-1]))
        return np.array(states)

    def _between(self, begin: float, end: float, state: np.ndarray) -> np.ndarray:
        middle = 0.5 * (begin + end)
        now = begin

        def changes(k: int, sign: float) -> Callable[[float, np.ndarray], float]:
            """Return the event at which a coordinate that slips with `sign` stops, or begins to."""

            def event(_: float, x: np.ndarray) -> float:
                held = self.force(middle, x[: self.q], x[self.q :])[k]
                return x[self.q + k] if sign else abs(held) - self.sliding[k]

            event.direction, event.terminal = -sign or 1.0, True
            return event

        while now < end - 1e-14:
            signs = self._signs(middle, state)

            def rate(_: float, x: np.ndarray, signs: np.ndarray = signs) -> np.ndarray:
                angle, speed = x[: self.q], x[self.q :]
                force = self.force(middle, angle, speed) - self.sliding * signs
                free = (signs != 0) | (self.sliding == 0)
                moved = np.zeros(self.q)
                inside = np.ix_(free, free)
                moved[free] = np.linalg.solve(self.mass[inside], force[free])
                return np.concatenate([np.where(free, speed, 0.0), moved])

            events = [changes(k, signs[k]) for k in np.flatnonzero(self.sliding > 0)]
            solved = scipy.integrate.solve_ivp(
                rate, (now, end), state, method="DOP853", rtol=1e-11, atol=1e-13, events=events
            )
            state, now = solved.y[:, -1].copy(), float(solved.t[-1])
            for k, event in zip(np.flatnonzero(self.sliding > 0), solved.t_events, strict=True):
                if len(event) and signs[k]:
                    state[self.q + k] = 0.0
        return state

    def _signs(self, t: float, state: np.ndarray) -> np.ndarray:
        """Return how each coordinate slips: by its speed, or from rest by what it cannot hold."""
        angle, speed = state[: self.q], state[self.q :]
        force = self.force(t, angle, speed)
        held = np.abs(force) < self.sliding * (1 - 1e-12)
        return np.where(speed != 0, np.sign(speed), np.where(held, 0.0, np.sign(force)))
