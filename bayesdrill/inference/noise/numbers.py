"""Numbers that channels have beside the sizes of their noise, and curvatures by several unknowns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Numbers:
    """One for each channel: what is `held`, None where it is unknown.  The unknown ones are columns of
    the noise's own unknowns, from `first` on.
    """

    held: tuple[float | None, ...]
    first: int

    @property
    def free(self) -> list[int]:
        """Channels where it is unknown."""
        return [k for k, value in enumerate(self.held) if value is None]

    def at(self, own: Array) -> Array:
        """`(W, K)`."""
        out = np.empty((len(own), len(self.held)))
        column = self.first
        for k, value in enumerate(self.held):
            out[:, k] = own[:, column] if value is None else value
            column += value is None
        return out

    def beside(self, sizes: Mapping[int, float]) -> dict[int, object]:
        """With the sizes that are known of channels."""
        return {k: (sizes.get(k), value) for k, value in enumerate(self.held)}


def square(curvature: Array, own: Array) -> Array:
    """Of unknowns `own (..., n)`: `(..., n, n)`, of which the diagonal may be given alone."""
    if curvature.ndim > own.ndim:
        return curvature
    return np.asarray(curvature[..., None] * np.eye(own.shape[-1]))


def of_pairs(pairs: Array, places: tuple[list[int], list[int]]) -> Array:
    """`pairs (..., K, 2, 2)` of two numbers of each channel, where `places` are the channels in which
    the first, and in which the second is unknown: `(..., n, n)`, all first before all second.
    """
    every = [(k, which) for which, channels in enumerate(places) for k in channels]
    out = np.zeros((*pairs.shape[:-3], len(every), len(every)))
    for i, (k, one) in enumerate(every):
        for j, (other, two) in enumerate(every):
            if k == other:
                out[..., i, j] = pairs[..., k, one, two]
    return out
