"""Where a rig ends at constant inputs: it turns steadily, or stands still where its angles are held."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.rig import models
from bayesdrill.rig.models.linear import Model

ROUNDING = 1e-12


def angles_of(model: Model) -> list[int]:
    """Their places among the states."""
    return [k for k, name in enumerate(model.states) if models.STATES[name].unit == "rad"]


def turns(matrix: Array, angles: Sequence[int]) -> bool:
    """Whether nothing changes when all angles are shifted alike, in all of `matrix (n, X, X)`."""
    columns = matrix[np.isfinite(matrix).all(axis=(1, 2))][:, :, list(angles)]
    left = np.abs(columns.sum(axis=-1)) <= ROUNDING * np.abs(columns).sum(axis=-1)
    return bool(left.all())


def turning(matrix: Array, angles: Sequence[int]) -> Array:
    """Of a rig that turns: the place of the first angle, which is zero, is that of the common speed."""
    made = matrix.copy()
    made[:, :, angles[0]] = 0.0
    made[:, list(angles), angles[0]] = -1.0
    return made


def ends(matrix: Array, forcing: Array) -> Array:
    """`x (n, X)` with `matrix x + forcing = 0`; NaN where there is none."""
    matrix = matrix.copy()
    size = matrix.shape[1]
    bad = ~(np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(forcing).all(axis=1))
    matrix[bad] = np.eye(size)
    rows = np.abs(matrix).max(axis=2, keepdims=True)
    singular = np.linalg.matrix_rank(matrix / np.where(rows > 0, rows, 1.0)) < size
    matrix[singular] = np.eye(size)
    found = np.linalg.solve(matrix, -forcing[..., None])[..., 0]
    found[bad | singular] = np.nan
    return np.asarray(found)


def states(matrix: Array, forcing: Array, angles: Sequence[int]) -> Array:
    """The steady state `(n, X)`, its first angle zero where all angles turn."""
    if not turns(matrix, angles):
        return ends(matrix, forcing)
    found = ends(turning(matrix, angles), forcing)
    found[:, angles[0]] = 0.0
    return found


def state_slopes(
    matrix: Array, forcing: Array, matrix_slope: Array, forcing_slope: Array, angles: Sequence[int]
) -> Array:
    """Of `states`, where matrix and forcing change by `(n, X, X)` and `(n, X)`: `(n, X)`."""
    turned = turns(matrix, angles)
    own = turning(matrix, angles) if turned else matrix
    change = matrix_slope.copy()
    if turned:
        change[:, :, angles[0]] = 0.0
    here = ends(own, forcing)
    found = ends(own, np.einsum("nij,nj->ni", change, here) + forcing_slope)
    if turned:
        found[:, angles[0]] = 0.0
    return found
