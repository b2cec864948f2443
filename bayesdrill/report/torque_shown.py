"""What figure and tables show of a missing torque, in the units of the user."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import symbols
from bayesdrill.basics.symbols import Symbol
from bayesdrill.basics.units import Unit
from bayesdrill.insight.shaking import TAILS, Shaking
from bayesdrill.report.rubbed import speed_symbol
from bayesdrill.rig import vocabulary

Array = NDArray[np.float64]

BINS = 24  # of a panel; each needs some samples
FEWEST = 5
TIME = Symbol("t", "s", "t", "s", "time")
TORQUE = Symbol("d", "N*m", "d", r"N\,m", "missing torque")
TURN = {
    "motor": Symbol(
        "turn", "1", r"\theta_3/2\pi", "", "angle of the motor within a turn, in turns"
    ),
    "rotor_1": Symbol(
        "turn", "1", r"\theta_1/2\pi", "", "angle of rotor 1 within a turn, in turns"
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Against:
    """What a torque may follow: `values (T,)`, and by `centres (B,)` of bins its means `(B,)`,
    with a `band (2, B)` of the means of draws.
    """

    label: Symbol
    values: Array
    centres: Array
    means: Array
    band: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """Of one experiment; `expected (T,)`, `band (2, T)`."""

    t: Array
    time: Symbol
    torque: Symbol
    expected: Array
    band: Array
    against: tuple[Against, ...]


def shown(found: Shaking, clock: Unit) -> Shown:
    return Shown(
        t=found.t / clock.factor,
        time=dataclasses.replace(TIME, latex_unit=clock.latex),
        torque=TORQUE,
        expected=found.expected,
        band=found.band,
        against=tuple(_against(found)),
    )


def _against(found: Shaking) -> Iterator[Against]:
    """Its own speed first, the other one, the angle within a turn, the inputs that were measured."""
    for name, speed in found.speeds:
        geared = found.gear != 1.0
        label = speed_symbol(name, found.roles) if geared else vocabulary.STATES[name]
        yield _binned(found, label, speed)
    turns = found.angle / (2 * np.pi)
    if np.ptp(turns) > 1.0:
        yield _binned(found, TURN[found.at], turns % 1.0)
    for name, values in found.inputs.items():
        if name not in found.states:
            yield _binned(found, symbols.INPUTS[name], values)


def _binned(found: Shaking, label: Symbol, values: Array) -> Against:
    edges = np.linspace(values.min(), values.max(), BINS + 1)
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1)
    counts = np.bincount(which, minlength=BINS)
    good = np.flatnonzero(counts >= FEWEST)
    sums = np.zeros((len(found.draws), BINS))
    for k in good:
        sums[:, k] = found.draws[:, which == k].mean(axis=1)
    means = np.bincount(which, weights=found.expected, minlength=BINS)
    return Against(
        label=label,
        values=values,
        centres=0.5 * (edges[1:] + edges[:-1])[good],
        means=means[good] / counts[good],
        band=np.quantile(sums[:, good], TAILS, axis=0),
    )
