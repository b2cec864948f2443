"""Compute the steady state of a rig at constant inputs: it turns steadily, or stands still."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import Dual
from bayesdrill.rig.models.linear import Model

INVARIANCE_TOLERANCE = 1e-12  # largest sum taken as zero, relative to the sum of absolute values
MIN_SHARE = 1e-9  # smallest turn of the first angle, relative to the largest turn


def angle_indices(model: Model) -> list[int]:
    """Return the indices of angles among the states."""
    return [model.states.index(name) for name in model.angles]


def rotates_freely(matrix: Array, angles: Sequence[int]) -> bool:
    """Return whether equal shifts of all angles change no rate, for each of n matrices `(n, X, X)`."""
    columns = matrix[np.isfinite(matrix).all(axis=(1, 2))][:, :, list(angles)]
    invariant = np.abs(columns.sum(axis=-1)) <= INVARIANCE_TOLERANCE * np.abs(columns).sum(axis=-1)
    return bool(invariant.all())


def free_turn(matrix: Array, angles: Sequence[int]) -> Array | None:
    """Return how far each angle turns for one turn of the first; None if the rig cannot turn freely.

    Gears within a drive train make these ratios differ from one.
    """
    if rotates_freely(matrix, angles):
        return np.ones(len(angles))
    columns = matrix[np.isfinite(matrix).all(axis=(1, 2))][:, :, list(angles)]
    turn = np.linalg.svd(columns[0])[2][-1]
    if abs(turn[0]) < MIN_SHARE * np.abs(turn).max():
        return None
    turn = turn / turn[0]
    sizes = np.abs(columns) @ np.abs(turn)
    return turn if (np.abs(columns @ turn) <= INVARIANCE_TOLERANCE * sizes).all() else None


def fix_rotation(matrix: Array, angles: Sequence[int], turn: Array) -> Array:
    """Return the matrix with the speed of the first angle as an unknown, in place of that angle.

    `turn` is the result of `free_turn`. The first angle itself is zero.
    """
    constrained = matrix.copy()
    constrained[:, :, angles[0]] = 0.0
    constrained[:, list(angles), angles[0]] = -turn
    return constrained


def equilibrium(matrix: Array, forcing: Array) -> Array:
    """Return `x (n, X)` with `matrix x + forcing = 0`; NaN where the matrix is singular."""
    matrix = matrix.copy()
    size = matrix.shape[1]
    bad = ~(np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(forcing).all(axis=1))
    matrix[bad] = np.eye(size)
    rows = np.abs(matrix).max(axis=2, keepdims=True)
    scaled = matrix / np.where(rows > 0, rows, 1.0)
    # No singular value exceeds `size`. So if their product is above this limit, the smallest is
    # above the tolerance of `matrix_rank`, and the matrix is regular.
    doubtful = np.abs(np.linalg.det(scaled)) <= float(size) ** (size + 1) * np.finfo(float).eps
    singular = doubtful.copy()
    singular[doubtful] = np.linalg.matrix_rank(scaled[doubtful]) < size
    matrix[singular] = np.eye(size)
    solution = np.linalg.solve(matrix, -forcing[..., None])[..., 0]
    solution[bad | singular] = np.nan
    return np.asarray(solution)


def states(matrix: Any, forcing: Any, angles: Sequence[int], turn: Array | None) -> Any:
    """Return the steady state `(n, X)`; its first angle is zero if the rig turns freely.

    `turn` is the result of `free_turn` for the matrix. Matrix and forcing may both be `Dual`: with
    a derivative ' by a parameter, A x = -f gives A x' = -(f' + A' x), and so the slope x'.
    """
    if isinstance(matrix, Dual):
        here = states(matrix.value, forcing.value, angles, turn)
        moved = np.einsum("nij,nj->ni", matrix.slope, here) + forcing.slope
        return Dual(here, states(matrix.value, moved, angles, turn))
    if turn is None:
        return equilibrium(matrix, forcing)
    steady = equilibrium(fix_rotation(matrix, angles, turn), forcing)
    steady[:, angles[0]] = 0.0
    return steady
