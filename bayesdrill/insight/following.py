"""What a missing torque follows: the sign of a speed, a speed, its square, an angle, an input, the time.

Each is held against the torque by itself, by least squares, where its inertia turns.  The one that
explains most is taken first, then what takes most of what is left, as long as that is a good part of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.insight.shaking import Shaking

Array = NDArray[np.float64]

WORTH = 0.3  # of what is left of the squares: less is not worth a second word
LEAST = 0.1  # of all
FLAT = 1e-9  # of its size: what varies less is constant


@dataclass(frozen=True, slots=True, kw_only=True)
class Follows:
    """`kind` of `of` (a speed, an angle, an input): `share` of the squares of the torque that it
    explains by itself; `taken`: whether it is among those that explain it together, and then
    `size` with its `sd` over the draws, N m per unit of it, of an angle its amplitude.
    """

    kind: str
    of: str
    share: float
    taken: bool = False
    size: float = 0.0
    sd: float = 0.0


def follows(found: Shaking) -> tuple[Follows, ...]:
    """Those taken first, in their order; then all others by their shares."""
    turning = found.turning
    candidates = ((kind, of, rows[turning]) for kind, of, rows in _candidates(found))
    every = [(kind, of, rows) for kind, of, rows in candidates if _moves(rows)]
    torque = found.expected[turning]
    total = float(torque @ torque)
    if total == 0.0 or not every:
        return ()
    alone = {k: 1.0 - _left(torque, rows) / total for k, (_, _, rows) in enumerate(every)}
    taken: list[int] = []
    rest, rows = total, np.empty((len(torque), 0))
    while len(taken) < len(every):
        lefts = {
            k: _left(torque, np.column_stack([rows, own]))
            for k, (_, _, own) in enumerate(every)
            if k not in taken
        }
        best = min(lefts, key=lambda k: lefts[k])
        if rest - lefts[best] < WORTH * rest or rest - lefts[best] < LEAST * total:
            break
        taken.append(best)
        rest, rows = lefts[best], np.column_stack([rows, every[best][2]])
    return tuple(_told(found, every, alone, taken, rows))


def _told(
    found: Shaking,
    every: list[tuple[str, str, Array]],
    alone: dict[int, float],
    taken: list[int],
    rows: Array,
) -> Iterator[Follows]:
    if taken:
        weights = np.linalg.lstsq(rows, found.draws[:, found.turning].T, rcond=None)[0]  # (rows, N)
        first = 0
        for k in taken:
            kind, of, own = every[k]
            sizes = weights[first : first + own.shape[1]]
            first += own.shape[1]
            size = sizes[0] if len(sizes) == 1 else np.linalg.norm(sizes, axis=0)
            yield Follows(
                kind=kind,
                of=of,
                share=alone[k],
                taken=True,
                size=float(size.mean()),
                sd=float(size.std()),
            )
    for k in sorted(set(alone) - {*taken}, key=lambda k: -alone[k]):
        yield Follows(kind=every[k][0], of=every[k][1], share=alone[k])


def _candidates(found: Shaking) -> Iterator[tuple[str, str, Array]]:
    for name, speed in found.speeds:
        yield "sign", name, np.sign(speed)[:, None]
        yield "speed", name, speed[:, None]
        yield "square", name, (speed * np.abs(speed))[:, None]
    turn = found.angle[:, None]
    yield "turn", found.roles.at(found.at).angle, np.column_stack([np.cos(turn), np.sin(turn)])
    for name, values in found.inputs.items():
        if name not in found.states:
            yield "input", name, values[:, None]
    yield "constant", "", np.ones((len(found.t), 1))
    yield "drift", "", (found.t - found.t.mean())[:, None]


def _moves(rows: Array) -> bool:
    return bool(np.isfinite(rows).all() and np.abs(rows).max() > FLAT)


def _left(torque: Array, rows: Array) -> float:
    weights = np.linalg.lstsq(rows, torque, rcond=None)[0]
    rest = torque - rows @ weights
    return float(rest @ rest)
