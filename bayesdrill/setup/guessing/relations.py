"""What columns say of each other and of themselves: derivatives, ratios, noise."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bayesdrill.record import angles

Array = NDArray[np.float64]

# How many units of the angle are one of the speed, times s: what a derivative can be.
FACTORS = {
    ("rad", "rad/s"): 1.0,
    ("deg", "deg/s"): 1.0,
    ("deg", "rpm"): 6.0,
    ("deg", "rad/s"): 180 / math.pi,
    ("rad", "rpm"): math.pi / 30,
    ("rad", "deg/s"): math.pi / 180,
}
NEAR = 0.15  # of the logarithm, around one of them
EXPLAINED = 0.98  # of the variance of an angle, at least


def integral(speed: Array, dt: float) -> Array:
    """(T,) by the trapezoidal rule, zero at the first sample."""
    return np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) * (0.5 * dt))])


def explained(y: Array, *causes: Array) -> tuple[list[float], float]:
    """Factors of the causes, beside a constant, and the share of the variance that they explain."""
    design = np.stack([*causes, np.ones(len(y))], axis=-1)
    scale = np.maximum(np.abs(design).max(axis=0), 1e-300)
    factors = np.linalg.lstsq(design / scale, y, rcond=None)[0] / scale
    total = float(np.var(y))
    left = float(np.var(y - design @ factors))
    return [float(one) for one in factors[:-1]], 1 - left / total if total > 0 else 0.0


def centred(values: Array) -> Array:
    return values - values.mean()


def explained_by(y: Array, cause: Array) -> tuple[float, float]:
    """As `explained`, of one cause alone and both `centred`: for many pairs."""
    # Not `y @ cause`: BLAS shares vectors out to threads, which costs far more than the sum.
    total, square, both = (
        float(np.einsum("i,i", *pair)) for pair in ((y, y), (cause, cause), (y, cause))
    )
    if total == 0 or square == 0:
        return 0.0, 0.0
    return both / square, both / square * both / total


def units_of(factor: float, angle: str, speed: str) -> list[tuple[str, str]]:
    """Units of angle and speed (empty: not known) that such a factor between them can mean."""
    if factor == 0:
        return []
    return [
        pair
        for pair, one in FACTORS.items()
        if abs(math.log(abs(factor) / one)) < NEAR
        and angle in ("", pair[0])
        and speed in ("", pair[1])
    ]


def ratio(over: Array, under: Array) -> float:
    """Of two angles that go together; NaN where one does not move."""
    first, second = over - over[0], under - under[0]
    square = float(second @ second)
    return float(first @ second) / square if square > 0 else math.nan


def ratio_through_shaft(over: Array, rotor: Array, dt: float) -> float:
    """As `ratio`, of an angle before the shaft to that of rotor 1 behind it, which swings.

    The angle at the gearbox is `rotor` and a multiple of its acceleration; twice integrated, so that
    noise is not differentiated.
    """
    double = [integral(integral(one - one[0], dt), dt) for one in (over, rotor)]
    (found, *_), _ = explained(double[0], double[1], rotor, integral(np.ones(len(rotor)), dt))
    return found


def differenced(angle: Array, speed: Array, t: Array) -> bool:
    """Whether the speed is no measurement of its own, but differences of the angle; all `(T,)`."""
    middle = speed[1:-1]
    for guess in angles.quotients(angle, t).values():
        rough = np.diff(middle, 2)
        if len(rough) < 3 or not np.any(rough):
            return False
        _, share = explained(rough, np.diff(guess, 2))
        if share > 0.999:
            return True
    return False


def step(values: Array) -> float:
    """Between neighbouring levels of what is counted or rounded; 0: it has none."""
    apart = np.diff(np.unique(values))
    apart = apart[apart > 1e-9 * float(np.ptp(values))]
    return float(np.mean(apart[apart < 1.5 * apart.min()])) if len(apart) else 0.0


def counted(angle: Array) -> str:
    """The unit in which the steps of an encoder make a round number for one turn; empty: none."""
    one = step(angle)
    if one == 0 or abs(math.log10(one) - round(math.log10(one))) < 1e-6:  # rounded, not counted
        return ""
    if not np.allclose(angle / one, np.round(angle / one), atol=0.1, rtol=1e-4):
        return ""
    for unit, turn in (("rad", 2 * math.pi), ("deg", 360.0)):
        count = turn / one
        whole = round(count)
        near = abs(count / whole - 1) < 2e-4 if whole else False
        if near and 100 <= whole <= 65536 and (whole % 100 == 0 or whole & (whole - 1) == 0):
            return unit
    return ""


def noise(values: Array) -> float:
    """Standard deviation of what differs from sample to sample; at least that of the last digit.

    Differences of higher order leave less of the signal, so the smallest counts.
    """
    found = []
    for order in (2, 3, 4, 5):
        rough = np.diff(values, order)
        if len(rough) > order:
            own = math.sqrt(math.comb(2 * order, order))
            found.append(float(np.median(np.abs(rough))) / 0.6745 / own)
    few = len(np.unique(values)) < 0.5 * len(values)
    rounding = step(values) / math.sqrt(12) if few else 0.0
    tiny = 1e-6 * float(np.ptp(values))
    return max(min(found, default=0.0), rounding, tiny)
