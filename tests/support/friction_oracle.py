"""A rig that rubs, from event to event: what the tests of dry friction believe.

Nothing of the package is used.  Between events the signs of all speeds, and what sticks, stay what
they are, the equations are smooth, and SciPy's DOP853 follows them at rtol 1e-10.  An event is a speed
that comes to zero, or a holding torque that is no longer enough; then it is decided anew what sticks.

    j_1 w_1' = -k_s (theta_1 - theta_2) - c_s (w_1 - w_2) - c_1 w_1 - t_1 - T_1
    (j_m + i_m^2 j_2) w_3' = i_m (k_s (theta_1 - theta_2) + c_s (w_1 - w_2))
                             - c_m w_3 + k_T i - t_f - T_m                      w_2 = i_m w_3
    l_m i' = v - (r_m + r_s) i - k_e w_3 - T_v

T is sgn(speed) times a size while it slips, and what keeps the speed at zero while it sticks, at most
the size at rest.  Sizes: `t_c + (t_s - t_c) exp(-(|w|/w_s)^power)`, where only t_c is named t_c; at the
motor (1/eta - 1) i_m k_s |theta_1 - theta_2| more; v_d of the current.  With sizes of zero nothing rubs.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

STATES = ("theta_1", "theta_2", "w_1", "w_2", "i")
RUBS = ("friction_m", "friction_1", "drop")
ROWS = (3, 2, 4)  # of the states, the speeds of the rubs
MOST_EVENTS = 1000  # between two changes of the voltage: more are a mistake of this file
NEAR = 1e-14  # beyond zero by so much a speed has changed its sign

Modes = tuple[int, int, int, int]  # signs of w_3, w_1, i, zero where it sticks; of the twist


@dataclass(frozen=True, kw_only=True)
class Rig:
    """`p`: parameters by their names, those that are not named are zero (eta: one)."""

    p: Mapping[str, float]
    i_m: float = 1 / 8
    power: int = 1

    def get(self, name: str) -> float:
        return self.p.get(name, 1.0 if name == "eta" else 0.0)

    @property
    def loss(self) -> float:
        return 1.0 / self.get("eta") - 1.0

    @property
    def rubs(self) -> tuple[bool, bool, bool]:
        sizes = (("t_cm", "t_sm"), ("t_c1", "t_s1"), ("v_d",))
        any_ = [any(self.get(name) > 0 for name in names) for names in sizes]
        return (any_[0] or self.loss > 0, any_[1], any_[2])

    def size(self, k: int, speed: float, twist: float) -> float:
        """Of rub `k` at a `speed` (w_3, w_1 or i) that is not negative; `twist` likewise."""
        if k == 2:
            return self.get("v_d")
        end = "m1"[k]
        found = self.get(f"t_c{end}")
        if f"t_s{end}" in self.p:
            ratio = speed / self.p[f"w_s{end}"]  # below zero where SciPy tries too long a step
            share = math.exp(min(-(ratio**self.power), 30.0))
            found += (self.p[f"t_s{end}"] - found) * share
        if k == 0:
            found += self.loss * self.i_m * self.p["k_s"] * twist
        return found

    def driving(self, x: list[float], v: float, t_1: float) -> tuple[float, float, float]:
        """What acts on w_3, w_1 and i beside the rubs."""
        theta_1, theta_2, w_1, w_2, i = x
        w_3 = w_2 / self.i_m
        shaft = self.p["k_s"] * (theta_1 - theta_2) + self.get("c_s") * (w_1 - w_2)
        motor = self.i_m * shaft - self.p["c_m"] * w_3 + self.p["k_T"] * i - self.get("t_f")
        rotor = -shaft - self.get("c_1") * w_1 - t_1
        resistance = self.p["r_m"] + self.get("r_s")
        return motor, rotor, v - resistance * i - self.p["k_e"] * w_3

    @property
    def masses(self) -> tuple[float, float, float]:
        motor = self.p["j_m"] + self.i_m**2 * self.get("j_2")
        return motor, self.p["j_1"], self.p["l_m"]

    def efforts(
        self, x: list[float], v: float, t_1: float, modes: Modes
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """What drives and what rubs, of motor, rotor and current."""
        driving = self.driving(x, v, t_1)
        speeds, twist = (x[3] / self.i_m, x[2], x[4]), modes[3] * (x[0] - x[1])
        rubs = tuple(
            0.0 if not on else force if not sign else sign * self.size(k, sign * speed, twist)
            for k, (on, force, sign, speed) in enumerate(
                zip(self.rubs, driving, modes, speeds, strict=False)
            )
        )
        return driving, rubs

    def rate(self, x: list[float], v: float, t_1: float, modes: Modes) -> list[float]:
        """Return the rates of the states, and of the integrals over their frictions."""
        (motor, rotor, rise), (t_m, t_r, t_v) = self.efforts(x, v, t_1, modes)
        j_m, j_1, l_m = self.masses
        return [
            x[2],
            x[3],
            (rotor - t_r) / j_1,
            self.i_m * (motor - t_m) / j_m,
            (rise - t_v) / l_m,
            t_m,
            t_r,
            t_v,
        ]

    def decided(self, x: list[float], v: float, t_1: float, modes: Modes) -> Modes:
        """The same where it moves; where a speed is zero, what it does now."""
        found = list(modes)
        for k, speed in enumerate((x[3], x[2], x[4])):
            found[k] = int(math.copysign(1, speed)) if speed else self.at_rest(k, x, v, t_1)
        return (found[0], found[1], found[2], found[3])

    def at_rest(self, k: int, x: list[float], v: float, t_1: float) -> int:
        """Whether it is held, or else which way it goes."""
        force = self.driving(x, v, t_1)[k]
        held = self.rubs[k] and abs(force) <= self.size(k, 0.0, abs(x[0] - x[1]))
        return 0 if held else int(math.copysign(1, force))


@dataclass(frozen=True, kw_only=True)
class Moved:
    """At times `t (T,)`: `states (T, 5)`; `efforts (T, 3)` of `RUBS`, signed; `stuck (T, 3)`; their
    integrals so far `impulses (T, 3)`; `v (T,)` as it was at each time.
    """

    t: np.ndarray
    states: np.ndarray
    efforts: np.ndarray
    stuck: np.ndarray
    impulses: np.ndarray
    v: np.ndarray

    def of(self, name: str) -> np.ndarray:
        return self.states[:, STATES.index(name)]


Drive = Callable[[float], tuple[float, float]]  # voltage and load at a time


@dataclass
class Course:
    """What is kept while it runs; `at`: the times that are asked for."""

    rig: Rig
    at: np.ndarray
    t: float
    y: np.ndarray  # states, integrals of rubs
    modes: Modes
    longest: float
    rows: list[tuple[np.ndarray, np.ndarray, float, Modes]] = field(default_factory=list)
    events: int = 0

    def run(self, until: float, drive: Drive) -> None:
        """Under inputs that are smooth until then."""
        events = self.events
        self.note(drive)
        while self._smooth(until, drive):
            self.events += 1
            if self.events - events > MOST_EVENTS:
                raise RuntimeError(f"more than {MOST_EVENTS} events before {until} s")

    def note(self, drive: Drive) -> None:
        """What sticks now, and what it does if it is asked for."""
        self.modes = self.rig.decided(self.y[:5].tolist(), *drive(self.t), self.modes)
        if len(self.rows) < len(self.at) and self.at[len(self.rows)] == self.t:
            self._keep(self.t, self.y, drive)

    def _keep(self, t: float, y: np.ndarray, drive: Drive) -> None:
        _, rubs = self.rig.efforts(y[:5].tolist(), *drive(t), self.modes)
        self.rows.append((y, np.array(rubs), drive(t)[0], self.modes))

    def _smooth(self, until: float, drive: Drive) -> bool:
        """On to the next event, or to the end; whether there was an event."""
        modes, rig, events = self.modes, self.rig, [*self._events(drive)]
        ahead = self.at[len(self.rows) :]
        asked = ahead[(ahead > self.t) & (ahead < until)]
        solved = solve_ivp(
            lambda t, y: rig.rate(y[:5].tolist(), *drive(t), modes),
            (self.t, until),
            self.y,
            method="DOP853",
            rtol=1e-10,
            atol=1e-12,
            max_step=self.longest,
            events=events,
            t_eval=np.append(asked, until),
        )
        if solved.status < 0:
            raise RuntimeError(solved.message)
        for t, y in zip(solved.t, np.transpose(solved.y), strict=True):
            if t < until:
                self._keep(float(t), y, drive)
        if solved.status == 0:
            self.t, self.y = until, solved.y[:, -1]
            return False
        which = next(k for k, times in enumerate(solved.t_events) if len(times))
        self.t = float(solved.t_events[which][0])
        self.y = np.array(solved.y_events[which][0])
        self._arrive(events[which].of, drive)  # type: ignore[attr-defined]
        return True

    def _events(self, drive: Drive):
        """Of each, a function that falls to zero; `of`: its rub, 3 for the twist."""
        rig, modes = self.rig, self.modes

        def twisted(t: float, y: np.ndarray) -> float:
            return float(modes[3] * (y[0] - y[1]) + NEAR)

        for k in range(3):
            if rig.rubs[k]:
                row, sign = ROWS[k], modes[k]

                def slows(t: float, y: np.ndarray, row: int = row, sign: int = sign) -> float:
                    return float(sign * y[row] + NEAR)

                def holds(t: float, y: np.ndarray, k: int = k) -> float:
                    x = y[:5].tolist()
                    force = abs(rig.driving(x, *drive(t))[k])
                    return rig.size(k, 0.0, abs(x[0] - x[1])) - force

                yield _falling(slows if sign else holds, k)
        if rig.loss > 0:
            yield _falling(twisted, 3)

    def _arrive(self, of: int, drive: Drive) -> None:
        """At an event: what moved is held or turns, what was held goes."""
        found, inputs = list(self.modes), drive(self.t)
        if of == 3:
            found[3] = -found[3]
        else:
            self.y[ROWS[of]] = 0.0
            x = self.y[:5].tolist()
            goes = int(math.copysign(1, self.rig.driving(x, *inputs)[of]))
            found[of] = self.rig.at_rest(of, x, *inputs) if found[of] else goes
        self.modes = (found[0], found[1], found[2], found[3])


def _falling(function: Callable[[float, np.ndarray], float], of: int):
    function.terminal, function.direction, function.of = True, -1, of  # type: ignore[attr-defined]
    return function


def simulate(
    rig: Rig,
    knots: np.ndarray,
    v: np.ndarray | Callable[[int, np.ndarray], float],
    *,
    at: np.ndarray | None = None,
    first_order: bool = False,
    t_1: np.ndarray | float = 0.0,
    start: Mapping[str, float] | None = None,
    longest: float = 5e-3,
) -> Moved:
    """From `knots[0]` on, at times `at` (None: at `knots`), which may go on beyond the last knot.

    `v` and `t_1` at the `knots (N,)` are held, or straight between them; `v` may also be what gives
    it of the number of a knot and the states there.  `longest`: a step of SciPy, well below what may
    happen twice between two looks at the events.
    """
    asked = knots if at is None else at
    y = np.zeros(5 + 3)
    for name, value in (start or {}).items():
        y[STATES.index(name)] = value
    course = Course(rig, asked, float(knots[0]), y, (1, 1, 1, 1), longest)
    loads = np.broadcast_to(t_1, knots.shape)
    ends = np.append(knots[1:], max(asked[-1], knots[-1])).tolist()
    for k, end in enumerate(ends):
        given = np.full(k + 2, v(k, course.y[:5])) if callable(v) else v
        drive = _drive(k, knots, (given, loads), first_order and not callable(v))
        goes_on = not callable(v) and not first_order and _same(k, given, loads)
        if end > course.t and not goes_on:
            course.run(end, drive)
    course.note(drive)
    states = np.array([y for y, _, _, _ in course.rows])
    modes = np.array([modes[:3] for *_, modes in course.rows])
    return Moved(
        t=asked,
        states=states[:, :5],
        efforts=np.array([rubs for _, rubs, _, _ in course.rows]),
        stuck=(modes == 0) & np.array(rig.rubs),
        impulses=states[:, 5:],
        v=np.array([v for _, _, v, _ in course.rows]),
    )


def _drive(k: int, knots: np.ndarray, inputs: tuple[np.ndarray, ...], straight: bool) -> Drive:
    """From knot `k` to the next."""
    now, load = (float(u[k]) for u in inputs)
    if not straight or k + 1 == len(knots):
        return lambda t: (now, load)
    begin, step = float(knots[k]), float(knots[k + 1] - knots[k])
    rise, more = (float(u[k + 1] - u[k]) / step for u in inputs)
    return lambda t: (now + rise * (t - begin), load + more * (t - begin))


def _same(k: int, *inputs: np.ndarray) -> bool:
    """Whether none changes at the next knot."""
    return all(k + 1 < len(u) and bool(u[k + 1] == u[k]) for u in inputs)
