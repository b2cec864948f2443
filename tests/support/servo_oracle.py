"""A servo or a motor with friction by direction, from event to event: what its tests believe.

Nothing of the package is used.  Of one inertia, before any gear, with u piecewise constant:

    j w' = (k/r) (voltage - k_e w) + torque - g sin(theta) - c w - friction
    voltage = supply(t) clip(dead_zone(s, k_p gain band), +-limit)
    s = k_p gain (goal - theta) - k_d gain w

Friction, of which c is a part, has numbers for each direction: `{"c": (forward, backward), ...}`.
Between events the direction and the range of s are frozen, the equations are smooth, and SciPy's
DOP853 follows them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

Pair = tuple[float, float]
TOLERANCES = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13}


@dataclass(frozen=True, kw_only=True)
class Servo:
    j: float
    k: float = 0.0
    r: float = 1.0
    k_e: float = 0.0
    g: float = 0.0
    c: Pair = (0.0, 0.0)
    t_c: Pair = (0.0, 0.0)
    t_s: Pair | None = None
    w_s: float = 1.0
    supply: Callable[[float], float] = field(default=lambda _: 0.0)
    k_p: float = 1.0
    k_d: float = 0.0
    gain: float = 0.0
    limit: float = math.inf
    band: float = 0.0
    torque: Callable[[float], float] = field(default=lambda _: 0.0)
    goal: Callable[[float], float] = field(default=lambda _: 0.0)

    def size(self, w: float, direction: int) -> float:
        """The dry friction while it slips in a direction."""
        way = 0 if direction > 0 else 1
        sliding = self.t_c[way]
        if self.t_s is None:
            return sliding
        return sliding + (self.t_s[way] - sliding) * math.exp(-min(abs(w) / self.w_s, 50.0))

    def wanted(self, t: float, x: np.ndarray) -> float:
        return self.k_p * self.gain * (self.goal(t) - x[0]) - self.k_d * self.gain * x[1]

    @property
    def edges(self) -> list[float]:
        """Values of s at which its voltage has a corner."""
        dead = self.k_p * self.gain * self.band
        ends = [dead + self.limit] if self.limit < math.inf else []
        ends += [dead] if dead else []
        return sorted([*ends, *(-end for end in ends)])

    def duty(self, s: float, region: int) -> float:
        dead = self.k_p * self.gain * self.band
        middle = len(self.edges) / 2
        sign = 1.0 if region > middle else -1.0
        if dead and region == middle:
            return 0.0
        if self.limit < math.inf and region in (0, len(self.edges)):
            return sign * self.limit
        return s - (sign * dead if dead else 0.0)

    def push(self, t: float, x: np.ndarray, region: int) -> float:
        """All that acts on the inertia but friction."""
        duty = self.duty(self.wanted(t, x), region) if self.gain else 0.0
        volts = self.supply(t) * duty
        motor = self.k / self.r * (volts - self.k_e * x[1])
        return motor + self.torque(t) - self.g * math.sin(x[0])

    def rate(self, t: float, x: np.ndarray, direction: int, region: int) -> list[float]:
        if direction == 0:
            return [0.0, 0.0]
        damping = self.c[0 if direction > 0 else 1] * x[1]
        friction = direction * self.size(x[1], direction)
        return [x[1], (self.push(t, x, region) - damping - friction) / self.j]

    def holds(self, t: float, x: np.ndarray, region: int) -> int:
        """0 while it sticks, or the direction in which it breaks away."""
        push = self.push(t, x, region)
        if push > self.size(0.0, 1):
            return 1
        return -1 if -push > self.size(0.0, -1) else 0

    def simulate(
        self, times: np.ndarray, start: Pair = (0.0, 0.0), corners: np.ndarray | None = None
    ) -> np.ndarray:
        """States `(T, 2)` at times; `corners`: where inputs jump."""
        x, out = np.array(start, dtype=float), [np.array(start, dtype=float)]
        stops = sorted({*times.tolist(), *(() if corners is None else corners.tolist())})
        wanted = set(times.tolist())
        for begin, end in itertools.pairwise(stops):
            x = self._between(begin, end, x)
            if end in wanted:
                out.append(x)
        return np.array(out)

    def _between(self, t: float, end: float, x: np.ndarray) -> np.ndarray:
        last = end - 1e-9 * (end - t)  # inputs are those before the corner at the end
        edges = self.edges
        moved = x[1] != 0.0
        region = int(np.searchsorted(edges, self.wanted(t, x))) if self.gain else 0
        direction = int(math.copysign(1, x[1])) if moved else self.holds(t, x, region)
        for _ in range(1000):
            events = []

            def crossing(t: float, x: np.ndarray) -> float:
                return x[1]

            def breaks(t: float, x: np.ndarray, region: int = region) -> float:
                push = self.push(t, x, region)
                return max(push - self.size(0.0, 1), -push - self.size(0.0, -1))

            if direction:
                crossing.direction = -direction  # type: ignore[attr-defined]
            events.append(crossing if direction else breaks)
            for edge, way in [(region - 1, -1), (region, 1)]:
                if 0 <= edge < len(edges):

                    def passes(t: float, x: np.ndarray, level: float = edges[edge]) -> float:
                        return self.wanted(t, x) - level

                    passes.direction = way  # type: ignore[attr-defined]
                    events.append(passes)
            for event in events:
                event.terminal = True  # type: ignore[attr-defined]
            now = (direction, region)
            solved = solve_ivp(
                lambda t, x, now=now: self.rate(t, x, *now), (t, last), x, events=events,
                **TOLERANCES,
            )  # fmt: skip
            t, x = float(solved.t[-1]), solved.y[:, -1].copy()
            if solved.status == 0:
                return x
            which = next(k for k, hits in enumerate(solved.t_events) if len(hits))
            if which == 0 and direction:
                x[1] = 0.0
                direction = self.holds(t, x, region)
            elif which == 0:
                direction = self.holds(t + 1e-12, x, region) or (
                    1 if self.push(t, x, region) > 0 else -1
                )
            else:
                region += 1 if events[which].direction > 0 else -1
        raise AssertionError("more events than this oracle allows for")
