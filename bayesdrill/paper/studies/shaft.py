"""Torsion of the shaft as a continuum, which the paper proposes, beside the spring of its model.

    I rho theta_tt = G I theta_xx
    at x = 0: J_1 theta_tt = G I theta_x;  at x = L: J_2 theta_tt = -G I theta_x

with I = pi d^4/32, c^2 = G/rho, and a_n = J_n c w/(G I):
    (a_1 + a_2) cos(w L/c) + (1 - a_1 a_2) sin(w L/c) = 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from bayesdrill.insight import plausibility

DENSITY = 7850.0  # kg/m^3, of steel; the paper gives none


@dataclass(frozen=True, slots=True, kw_only=True)
class Tone:
    """A natural frequency [Hz] of the free shaft with both inertias; `lumped`: of the spring."""

    mode: int
    distributed: float
    lumped: float | None


def tones(j_1: float, j_2: float, n: int) -> tuple[Tone, ...]:
    """The first `n` with inertias `j_1` and `j_2` [kg m^2] at the ends of the paper's shaft."""
    from scipy.optimize import brentq

    area = math.pi * plausibility.SHAFT_DIAMETER**4 / 32
    speed = math.sqrt(plausibility.STEEL / DENSITY)
    stiffness = plausibility.STEEL * area / plausibility.SHAFT_LENGTH

    def residue(phase: float) -> float:
        """At w L/c = phase; a_n is then J_n phase over the inertia of the shaft itself."""
        own = DENSITY * area * plausibility.SHAFT_LENGTH
        a_1, a_2 = j_1 * phase / own, j_2 * phase / own
        return (a_1 + a_2) * math.cos(phase) + (1 - a_1 * a_2) * math.sin(phase)

    lumped = math.sqrt(stiffness * (1 / j_1 + 1 / j_2)) / (2 * math.pi)
    found = []
    for mode in range(1, n + 1):
        low, high = (mode - 1) * math.pi + 1e-9, mode * math.pi - 1e-9
        phase = brentq(residue, low, high, xtol=1e-15, rtol=1e-14)
        frequency = phase * speed / plausibility.SHAFT_LENGTH / (2 * math.pi)
        found.append(Tone(mode=mode, distributed=frequency, lumped=lumped if mode == 1 else None))
    return tuple(found)
