"""Which directions the record knows at a point, which it does not, and which nothing ever changes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bayesdrill.engines.samplers import ridge
from bayesdrill.engines.samplers.ridge import Frame
from bayesdrill.inference.surface import Expansion, Surface

Array = NDArray[np.float64]
Expand = Callable[[Array, Array], Expansion]

# A direction is tight if the record makes its variance so many times smaller than the prior's, ...
TIGHT = 100.0
# ... and by as many times the root of that of the tightest, which else bends along it.
STRAIGHT = 0.003
NEAR_END = 1e-6  # of the prior's spread
OWN = 1e-6  # share of an unknown that is not among what is set apart already: less is rounding
PRESSED = 0.5  # standard deviations that a maximum may lie beyond an end of a prior
PROBES = 12  # points all over the prior
STILL = 1e-12  # of the largest knowledge: what is less is rounding


def split(
    surface: Surface, centre: Array, here: Expansion, still: Array | None = None
) -> tuple[Frame, Array]:
    """The basis at the maximum `centre (D,)`, and the record's knowledge of its loose part `(l,)`.

    `here`: the expansion there; `still (D, f)`: directions along which nothing changes, which come
    first.  An unknown that the end of its prior keeps from going further is no part of a tight
    direction, whose maximum would lie where there is no density: it is loose by itself.
    """
    scale = surface.spread
    slope, curvature = here.slope[0] * scale, here.curvature[0] * np.outer(scale, scale)
    apart = np.zeros((len(centre), 0)) if still is None else still
    values, vectors = _directions(curvature, apart)
    tight_from = max(TIGHT, STRAIGHT * float(np.sqrt(max(values[-1], 0.0))))
    tight = values >= tight_from
    known = np.zeros(apart.shape[1])
    if np.linalg.norm((slope @ vectors[:, tight]) / np.sqrt(values[tight])) > PRESSED:
        near = NEAR_END * scale
        pressed = (centre <= surface.low + near) & (slope < 0)
        pressed |= (centre >= surface.high - near) & (slope > 0)
        apart, own = _beside(apart, np.flatnonzero(pressed))
        known = np.concatenate([known, np.diag(curvature)[own] + slope[own] ** 2])
        values, vectors = _directions(curvature, apart)
    n_loose = int((values < tight_from).sum())
    columns = scale[:, None] * np.concatenate([apart, vectors], axis=1)
    return (
        ridge.frame(centre, columns, len(known) + n_loose),
        np.concatenate([known, np.maximum(values[:n_loose], 0.0)]),
    )


def corner(surface: Surface, centre: Array, here: Expansion) -> tuple[Frame, Array]:
    """The unknowns themselves as a basis, where the ends of the priors hold nearly all of them."""
    scale = surface.spread
    known = np.diag(here.curvature[0]) * scale**2 + (here.slope[0] * scale) ** 2
    return ridge.frame(centre, np.diag(scale), len(centre)), known


def _beside(apart: Array, unknowns: NDArray[np.intp]) -> tuple[Array, list[int]]:
    """Columns at right angles: those `apart`, then what `unknowns` add to them, and which these are."""
    own: list[int] = []
    for d in map(int, unknowns):
        axis = np.eye(len(apart))[d] - apart @ apart[d]
        if (length := float(np.linalg.norm(axis))) > OWN:
            apart, own = np.column_stack([apart, axis / length]), [*own, d]
    return apart, own


def _directions(curvature: Array, without: Array) -> tuple[Array, Array]:
    """Eigenvalues, the smallest first, and vectors `(D, n)`, at right angles to those `without`."""
    whole = np.linalg.qr(without, mode="complete")[0]
    rest = whole[:, without.shape[1] :]
    values, vectors = np.linalg.eigh(rest.T @ curvature @ rest)
    return values, rest @ vectors


def unmoved(surface: Surface, expand: Expand, rng: np.random.Generator) -> Array:
    """Directions `(D, f)` in units of the spreads along which the density changes nowhere at all.

    Looked for at points all over the prior: what is flat at one of them may bend elsewhere.
    """
    d = len(surface.middle)
    scattered = surface.middle + surface.spread * rng.standard_normal((PROBES, d))
    here = expand(np.clip(scattered, surface.low, surface.high), np.eye(d))
    whitened = here.curvature * np.outer(surface.spread, surface.spread)
    largest = np.linalg.eigvalsh(whitened)[:, -1]
    seen = largest > 0
    if not seen.any():
        return np.zeros((d, 0))
    values, vectors = np.linalg.eigh((whitened[seen] / largest[seen, None, None]).mean(axis=0))
    return np.asarray(vectors[:, values < STILL])
