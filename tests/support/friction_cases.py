"""Rigs with dry friction and their inputs; what `friction_oracle` says of them is kept for all tests."""

import dataclasses
import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from support.friction_oracle import Moved, Rig, simulate
from support.scipy_oracles import NOMINAL, ORDER, skewed

DEGREE = math.pi / 180
SERVO = {
    "j_m": 4.5e-6,
    "c_m": 2e-6,
    "k_e": 0.02,
    "k_T": 0.02,
    "r_m": 1.8,
    "l_m": 0.6e-3,
    "k_s": 0.9,
    "c_s": 8e-4,
    "j_1": 2.4e-3,
    "t_f": 0.0,
    "t_cm": 2.5e-3,
    "t_c1": 0.006,
    "t_s1": 0.012,
    "w_s1": 0.3,
}


@dataclass(frozen=True, kw_only=True)
class Case:
    """`v (N,)` at the times `t (N,)`, held unless `first_order`; None: what the servo's loop gives."""

    rig: Rig
    t: np.ndarray
    v: np.ndarray | None
    first_order: bool = False
    t_1: np.ndarray | float = 0.0
    start: Mapping[str, float] = field(default_factory=dict)

    def moved(self, rig: Rig | None = None, at: np.ndarray | None = None) -> Moved:
        """At the times `at` (None: `t`), with the voltage that the case has, whatever the `rig`."""
        return simulate(
            rig or self.rig,
            self.t,
            _loop(self.t) if self.v is None else self.v,
            at=at,
            first_order=self.first_order,
            t_1=self.t_1,
            start=self.start,
        )

    @property
    def added(self) -> tuple[str, ...]:
        """Its parameters beside the nine."""
        return tuple(name for name in self.rig.p if name not in ORDER)


def _loop(t: np.ndarray):
    """By the angle that is missing, less what the speed takes; in steps of 5 mV, at most 10 V."""

    def law(k: int, x: np.ndarray) -> float:
        wanted = 40 * DEGREE * (1 if (t[k] // 0.6) % 2 == 0 else -0.7)
        asked = 12.0 * (wanted - x[1]) - 0.6 * x[3]
        return 5e-3 * round(min(max(asked, -10.0), 10.0) / 5e-3)

    return law


def _stick_slip() -> Case:
    p = {**NOMINAL, "t_f": 0.0, "t_c1": 0.3, "t_s1": 1.2, "w_s1": 0.5}
    t = 0.01 * np.arange(1201)
    return Case(rig=Rig(p=p), t=t, v=np.full(len(t), 1.0))


def _reversing() -> Case:
    """Friction at both ends, numbers of the nominal rig."""
    p = {**NOMINAL, "t_f": 0.0, "t_cm": 0.05, "t_c1": 0.25}
    t = 0.01 * np.arange(1001)
    return Case(rig=Rig(p=p), t=t, v=np.where((t // 2.5) % 2 == 0, 6.0, -6.0))


def _static() -> Case:
    """Static friction 2.5 times the sliding one, at both ends; most reversals come to a stop."""
    p = {**skewed(), "t_f": 0.0, "c_s": 1.7e-3}
    p |= {"t_cm": 0.05, "t_sm": 0.125, "w_sm": 6.0, "t_c1": 0.3, "t_s1": 0.75, "w_s1": 1.2}
    t = 0.01 * np.arange(701)
    level = 0.06 * (t // 0.06)
    return Case(rig=Rig(p=p), t=t, v=4.0 * np.sin(1.3 * level) + 1.1 * np.sin(3.7 * level + 0.4))


def _servo() -> Case:
    t = 0.002 * np.arange(601)
    return Case(rig=Rig(p=SERVO, i_m=1 / 14), t=t, v=None)


def _other() -> Case:
    """All there is: in motion, off the origin, under a load and a voltage that goes straight."""
    p = {name: value * 1.3 for name, value in skewed().items()} | {"t_f": 0.013}
    p |= {"c_s": 2.3e-3, "j_2": 1.9e-3, "r_s": 0.21, "c_1": 1.1e-3, "eta": 0.83, "v_d": 0.35}
    p |= {"t_cm": 0.031, "t_sm": 0.047, "w_sm": 2.9, "t_c1": 0.17, "t_s1": 0.26, "w_s1": 0.8}
    t = 2.5 + 0.008 * np.arange(501)
    return Case(
        rig=Rig(p=p, i_m=1 / 3.7, power=2),
        t=t,
        v=5.0 * np.sin(2.1 * t) - 1.5 * np.cos(0.7 * t),
        first_order=True,
        t_1=np.where((t // 0.9) % 2 == 0, 0.11, -0.06),
        start={"theta_1": 0.8, "theta_2": -0.4, "w_1": 2.0, "w_2": -3.0, "i": 0.7},
    )


def _sine() -> Case:
    """Friction at both ends, of a constant size, numbers of the nominal rig; slowly to and fro."""
    t = 0.01 * np.arange(601)
    return Case(rig=_reversing().rig, t=t, v=3.0 * np.sin(1.3 * t))


def _falling() -> Case:
    """Static friction at rotor 1 alone, from reversal to reversal."""
    p = {**NOMINAL, "t_f": 0.0, "t_c1": 0.25, "t_s1": 0.4, "w_s1": 0.5}
    return dataclasses.replace(_reversing(), rig=Rig(p=p))


CASES = {
    "stick slip": _stick_slip(),
    "reversing": _reversing(),
    "sine": _sine(),
    "straight": dataclasses.replace(_sine(), first_order=True),
    "falling": _falling(),
    "static": _static(),
    "servo": _servo(),
    "other": _other(),
}


@functools.cache
def moved(name: str) -> Moved:
    return CASES[name].moved()


def moved_of(case: Case) -> Moved:
    return moved(next(name for name, one in CASES.items() if one is case))
