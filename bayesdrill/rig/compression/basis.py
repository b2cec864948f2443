"""Choose rational functions for responses near that of a reference rig, and project a record on them.

See `basis_kernel` for the functions. Their poles are chosen for the rigs at given points. The
functions' filters, applied to the inputs, give the columns of a matrix B = Q R. With the residuals
r of the reference rig, the record is reduced, block by block, to the triangle R and to Q' r. The
sizes of both do not depend on the length of the record.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.rig.compression.basis_kernel import PAIR, REAL, ROUNDS, ROWS, PoleNumbers

BLOCK = 1 << 14  # samples that are filtered at a time
ROWS_AT_ONCE = 16  # (rows per QR decomposition) / columns: so few that they fit into the cache
MAX_ORDER = 30  # largest `Pole.order`; with more functions the exact response costs less
MAX_SHARED = 1e-9  # largest effect of an integrator on rates, relative to that of other states
NEARLY_ONE = 0.3  # relative distance of real modes below which they are treated as a pair
LEAST_TURN = 0.25  # least rotation or shear of a pair / min(decay, distance from -1) of the pair
UNKNOWN = "the poles of the rig are too uncertain"


class CompressionError(Exception):
    """A record cannot be compressed for some rigs; the message says why."""


@dataclass(frozen=True, slots=True)
class Pole:
    """The pole is 1 + `mu`, or a complex pair; a round has `order` * `size` functions of it."""

    mu: complex
    order: int

    @property
    def size(self) -> int:
        """Return the number of modal coordinates of the pole, and of functions per order."""
        return PAIR if self.mu.imag else REAL

    @property
    def numbers(self) -> PoleNumbers:
        """Return the numbers of the pole that kernels use."""
        return PoleNumbers.of_pole(self.mu)


@dataclass(frozen=True, slots=True)
class Basis:
    """The basis has poles of functions, and coordinates in which rigs are nearly diagonal.

    The columns of `vectors (X, X)` are the directions of `integrators`, then modes of the
    reference; a pair has two adjacent columns. `duals` is the inverse of `vectors`.
    """

    poles: tuple[Pole, ...]
    integrators: int
    vectors: Array
    duals: Array

    def frame(self, sizes: Sequence[float], first: Array) -> Array:
        """Return the block `frame` of the kernels.

        `sizes` are the norms, over all samples, of the sources that drive the rig. `first` has the
        first value of each measured input.
        """
        poles = [number for pole in self.poles for number in pole.numbers.numbers]
        parts = [self.vectors.ravel(), self.duals.ravel(), sizes, first, poles]
        return np.concatenate([np.asarray(part, dtype=float) for part in parts])


def choose_basis(rates: Array, dt: float, neglected: float) -> Basis:
    """Choose functions for n rigs with the state matrices `rates`; the first is the reference.

    `rates` is `(n, X, X)`. `neglected` is the fraction of a mode's response that may be neglected.
    Raises `CompressionError` if a rig has modes that do not decay, or if poles are too far apart.
    """
    from scipy.linalg import expm  # slow to import, and rarely needed

    falls = np.array([expm(a * dt) - np.eye(len(a)) for a in rates])
    return basis_of(falls, _shared_integrators(rates), neglected)


def basis_of(falls: Array, shared: Array, neglected: float) -> Basis:
    """Choose functions as `choose_basis` does, for rigs with the transitions `falls + 1`.

    `falls (n, X, X)` is Phi - 1 of each rig, and the columns of `shared (X, d)` are integrators.
    """
    vectors, modes = _modes(falls[0], shared)
    duals = np.linalg.inv(vectors)
    if not np.isfinite(duals).all():
        raise CompressionError("two poles of the rig coincide")
    d = shared.shape[1]
    inner = (duals @ falls @ vectors)[:, d:, d:]
    values: Any = np.linalg.eigvals(inner)
    if (np.abs(1.0 + np.append(values, modes)) >= 1.0).any():
        raise CompressionError("a mode of the rig does not decay")
    return Basis(tuple(_chosen(modes, values, neglected)), d, vectors, duals)


def _shared_integrators(rates: Array) -> Array:
    """Return the directions `(X, d)` of the state space along which no rate of any rig changes."""
    rows = rates.reshape(-1, rates.shape[2])
    size = np.abs(rows).max(axis=1, keepdims=True)
    rows = rows[size[:, 0] > 0] / size[size[:, 0] > 0]
    _, singular, turned = np.linalg.svd(rows, full_matrices=True)
    singular = np.append(singular, np.zeros(len(turned) - len(singular)))
    null = turned[singular < MAX_SHARED * singular[0]].T
    if null.shape[1] == 1:  # a common rotation of all angles: make equal entries exactly equal
        null = null / null[np.argmax(np.abs(null[:, 0])), 0]
        rounded = np.round(null)
        null = np.where(np.abs(null - rounded) < MAX_SHARED, rounded, null)
    return np.asarray(null)


def _modes(fall: Array, shared: Array) -> tuple[Array, list[complex]]:
    """Return vectors `(X, X)` of integrators, then of modes from fast to slow, and the modes' `mu`.

    Two modes that are conjugate or nearly equal form a pair, with any two vectors of their plane.
    """
    values, vectors = np.linalg.eig(fall)
    order = np.argsort(-np.abs(values), kind="stable")[: len(fall) - shared.shape[1]]
    columns, modes, k = [shared], list[complex](), 0
    while k < len(order):
        value, mode = complex(values[order[k]]), vectors[:, order[k]]
        other = complex(values[order[k + 1]]) if k + 1 < len(order) else complex(np.inf)
        if value.imag != 0.0 or abs(other - value) < NEARLY_ONE * abs(value):
            both = (mode.real, mode.imag if value.imag else vectors[:, order[k + 1]].real)
            columns.append(_pair(fall, np.array(both).T))
            middle = 0.5 * (value + other)
            turn = max(abs(value.imag), _least_turn(middle.real))
            modes.append(complex(middle.real, turn))
            k += 2
        else:
            columns.append(mode.real[:, None])
            modes.append(value)
            k += 1
    return np.concatenate(columns, axis=1), modes


def _pair(fall: Array, both: Array) -> Array:
    """Return vectors `(X, 2)` of a pair's plane, scaled so that `fall` is a rotation or small shear."""
    from scipy.linalg import schur

    plane = np.linalg.qr(both)[0]
    block, turned = schur(plane.T @ fall @ plane, output="real")
    shear, back = abs(block[0, 1]), abs(block[1, 0])
    least = LEAST_TURN * abs(block[0, 0])
    narrow = 1.0 if shear <= least else max(math.sqrt(back / shear), least / shear)
    return np.asarray(plane @ turned @ np.diag([1.0, min(narrow, 1.0)]))


def _chosen(poles: list[complex], values: Array, neglected: float) -> Iterator[Pole]:
    """Yield a pole for each mode of the reference, in the middle of the rigs' poles nearest to it."""
    flat = values.ravel()
    nearest = np.argmin([_passed(mu, flat) for mu in poles], axis=0)
    for index, mu in enumerate(poles):
        mine = flat[nearest == index] if (nearest == index).any() else np.array([mu])
        decay = -mine.real
        middle = complex(-math.sqrt(decay.min() * decay.max()), 0.0)
        if mu.imag:
            turns = np.abs(mine.imag)
            turn = max(0.5 * (turns.min() + turns.max()), _least_turn(middle.real))
            middle = complex(middle.real, turn)
        # Round mu so that 1 + mu is exact.
        middle = complex((1.0 + middle.real) - 1.0, middle.imag)
        if abs(1.0 + middle) >= 1.0:
            raise CompressionError(UNKNOWN)
        ratio = float(_passed(middle, mine).max())
        order = 1 if ratio == 0.0 else 1 + math.ceil(math.log(neglected) / math.log(ratio) / ROUNDS)
        if order > MAX_ORDER:
            raise CompressionError(UNKNOWN)
        yield Pole(middle, order)


def _least_turn(real: float) -> float:
    """Return the smallest imaginary part for a pair whose `mu` has this real part."""
    return LEAST_TURN * min(-real, 2.0 + real)


def _passed(mu: complex, values: Array) -> Array:
    """Return the fraction of modes with `values` (pole - 1) that remains after a function of `mu`."""
    numbers = PoleNumbers.of_pole(mu)
    over = np.polynomial.polynomial.polyval(values, numbers.denominator)
    first, second, third = numbers.all_pass
    return np.asarray(np.abs(first + (second + third * values) / over))


class Columns:
    """The columns are the outputs of the functions' filters for each source, computed by blocks."""

    def __init__(self, basis: Basis) -> None:
        self._basis = basis
        self._states = dict[tuple[int, int], Any]()

    def block(self, sources: Array) -> Array:
        """Return the columns `(m, n)` of the next samples of the `sources (m, S)`."""
        columns = []
        for s, signal in enumerate(sources.T):
            stages = ((s, stage) for stage in itertools.count())
            for _ in range(self._basis.integrators):
                columns.append(self._delayed(next(stages), 1.0, signal))
            for pole in ROUNDS * self._basis.poles:
                for _ in range(pole.order):
                    new, signal = self._filtered(next(stages), pole, signal)
                    columns += new
        return np.array(columns).T

    def _filtered(self, stage: tuple[int, int], pole: Pole, u: Array) -> tuple[list[Array], Array]:
        """Return one or two columns, and the input of the next function: `u` after the all-pass."""
        numbers, real, turn = pole.numbers, pole.mu.real, pole.mu.imag
        (_, _, square), even, odd = numbers.denominator, numbers.even_gain, numbers.odd_gain
        if pole.size == REAL:
            out = even * self._delayed(stage, 1.0 + real, u)
            return [out], even * out - (1.0 + real) * u
        # Real and imaginary parts of 1 / (z - a) give both functions of a pair.
        out = self._delayed(stage, 1.0 + pole.mu, u)
        first = even * (out.real + (2.0 + real) / turn * out.imag)
        second = odd * (out.real + real / turn * out.imag)
        return [first, second], square * u + even * first - odd * second

    def _delayed(self, stage: tuple[int, int], a: complex, u: Array) -> Any:
        """Filter a signal by 1 / (z - a), from the state of this stage after the previous block."""
        from scipy.signal import lfilter

        state = self._states.get(stage, np.zeros(1, dtype=type(a)))
        out, self._states[stage] = lfilter([0.0, 1.0], [1.0, -a], u, zi=state)
        return out


@dataclass(frozen=True, slots=True)
class Triangle:
    """The triangles give sums of squares: of residuals, of increments, and of both end residuals.

    `matrix (sums, K', n, n)` has a triangle for each of K' groups of channels that were observed at
    the same times. `projected (K, sums, n + 1)` has, for each channel, the projection of the
    reference's residuals on the columns, then the sum of squares of the part orthogonal to them.
    """

    matrix: Array
    projected: Array


@dataclass(slots=True)
class _Rows:
    """The accumulator keeps triangles of a record's rows, of their increments, and of both ends."""

    triangles: list[Array]
    first_row: Array | None = None
    last_row: Array | None = None

    def add(self, rows: Array) -> None:
        """Add further rows `(m, n)` to the triangles."""
        self.triangles[0] = _appended(self.triangles[0], rows)
        if len(self.triangles) > 1 and len(rows):
            before = rows[:0] if self.last_row is None else self.last_row
            steps = np.diff(np.concatenate([before, rows]), axis=0)
            self.triangles[1] = _appended(self.triangles[1], steps)
            self.first_row = rows[:1] if self.first_row is None else self.first_row
            self.last_row = rows[-1:]
            self.triangles[2] = _appended(self.first_row, self.last_row)


def _appended(part: Array, rows: Array) -> Array:
    size = ROWS_AT_ONCE * rows.shape[1]
    for first in range(0, len(rows), size):
        part = np.linalg.qr(np.concatenate([part, rows[first : first + size]]), mode="r")
    return part


def triangle(
    blocks: Iterable[tuple[Array, Array]], columns: int, sums: int, groups: Sequence[slice]
) -> Triangle:
    """Reduce blocks of columns `(m, n)`, and of the reference's residuals `(m, K)`, to triangles.

    Missing samples are NaN. `columns` is n, and zeros pad triangles to a multiple of `ROWS`. `sums`
    is 1 for residuals alone, and 3 with increments and ends. `groups` are the groups of channels
    that share a triangle.
    """
    parts = [_Rows([np.zeros((0, columns + k.stop - k.start))] * sums) for k in groups]
    for block, residuals in blocks:
        for k, part in zip(groups, parts, strict=True):
            rows = np.concatenate([block, residuals[:, k]], axis=1)
            part.add(rows[~np.isnan(rows[:, -1])])
    padded = columns + -columns % ROWS
    matrix = np.zeros((sums, len(parts), padded, padded))
    projected = np.zeros((groups[-1].stop, sums, padded + 1))
    for (n, k), v in itertools.product(enumerate(groups), range(sums)):
        upper, lower = np.split(parts[n].triangles[v], [columns])
        matrix[v, n, : len(upper), :columns] = upper[:, :columns]
        projected[k, v, : len(upper)] = upper[:, columns:].T
        projected[k, v, padded] = (lower[:, columns:] ** 2).sum(axis=0)
    return Triangle(matrix, projected)
