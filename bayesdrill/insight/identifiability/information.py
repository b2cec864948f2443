"""How well a record determines unknowns and products of their powers: Fisher and Cramer-Rao.

All in the logs of the unknowns, so that a standard deviation of 0.01 is one per cent.  The
information is kept as its square root R (information = R' R): squaring would lose the digits that
tell a badly determined direction from one that is not determined at all.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RANK_TOLERANCE = 1e-11  # of the largest singular value; exact nulls come out at 1e-16
BLIND = 1e-6  # share of a direction that may lie in the blind ones before its bound is infinite
MOST_FACTORS = 3  # in a simple product


@dataclass(frozen=True, slots=True)
class Information:
    """`root (m, m)`: of the information of the record about `names`, in logs."""

    names: tuple[str, ...]
    root: Array

    def bound(self, exponents: Array) -> float:
        """Cramer-Rao bound of the sd of the log of a product of powers; inf if not determined."""
        return float(self.bounds_of(exponents[None])[0])

    def bounds(self) -> Array:
        """Of each unknown: `(m,)`."""
        return self.bounds_of(np.eye(len(self.names)))

    def bounds_of(self, exponents: Array) -> Array:
        """`bound` of many products, `(n, m) -> (n,)`."""
        _, values, rows = np.linalg.svd(self.root)
        seen = values > RANK_TOLERANCE * values[0]
        along = exponents @ rows.T
        hidden = np.linalg.norm(along[:, ~seen], axis=1)
        known = np.linalg.norm(along[:, seen] / values[seen], axis=1)
        return np.where(hidden > BLIND * np.linalg.norm(exponents, axis=1), np.inf, known)

    def with_knowledge(self, exponents: Array, sd: float) -> Information:
        """The log of a product of powers known to `sd` from elsewhere."""
        return Information(self.names, root_of(np.vstack([self.root, exponents / sd])))

    def with_priors(self, sd: Array) -> Information:
        """Priors taken as Gaussian in the logs, with these standard deviations `(m,)`."""
        return Information(self.names, root_of(np.vstack([self.root, np.diag(1.0 / sd)])))

    @property
    def n_blind(self) -> int:
        """Independent products of which the record says nothing."""
        values = np.linalg.svd(self.root, compute_uv=False)
        return int(np.sum(values <= RANK_TOLERANCE * values[0]))


def from_sensitivities(names: tuple[str, ...], sensitivities: Array) -> Information:
    """From d signal / d log unknown over sigma, `(n, m)`."""
    return Information(names, root_of(sensitivities))


def root_of(rows: Array) -> Array:
    """`(n, m) -> (m, m)` with the same `rows' rows`."""
    m = rows.shape[1]
    reduced = np.linalg.qr(rows, mode="r")
    return np.asarray(np.vstack([reduced, np.zeros((m - len(reduced), m))]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Direction:
    """A principal direction of the information, its largest exponent 1.

    `sd`: Cramer-Rao bound of the sd of the log of the product; inf where the record is blind.
    """

    exponents: tuple[float, ...]
    sd: float


def directions(information: Information) -> tuple[Direction, ...]:
    """The sloppy spectrum: independent products, from the best determined to the worst."""
    _, values, rows = np.linalg.svd(information.root)
    found = []
    for value, row in zip(values, rows, strict=True):
        largest = row[np.argmax(np.abs(row))]
        blind = value <= RANK_TOLERANCE * values[0]
        sd = float("inf") if blind else float(1.0 / (value * np.abs(largest)))
        found.append(Direction(exponents=tuple(map(float, row / largest)), sd=sd))
    return tuple(found)


@dataclass(frozen=True, slots=True, kw_only=True)
class Product:
    """A simple product of powers: `sd` of its log with record and priors, `prior_sd` before.

    `bound`: from the record alone, inf if it does not determine the product.  `price`: of what is left
    of the prior's sd, each factor.
    """

    exponents: tuple[int, ...]
    sd: float
    prior_sd: float
    bound: float

    @property
    def price(self) -> float:
        return self.sd / self.prior_sd * sum(map(abs, self.exponents))


def products(information: Information, prior_sd: Array, candidates: Array) -> tuple[Product, ...]:
    """As many independent ones of the `candidates (n, m)` as there are, the most narrowed first.

    Each is the one that the record narrows most of those independent of the ones before it; a
    factor more has to pay for itself.
    """
    joint = information.with_priors(prior_sd)
    spread = np.linalg.inv(joint.root)
    rank = np.linalg.matrix_rank(candidates) if len(candidates) else 0
    sd = np.linalg.norm(candidates @ spread, axis=1)
    before = np.linalg.norm(candidates * prior_sd, axis=1)
    price = sd / before * np.abs(candidates).sum(axis=1)
    chosen: list[int] = []
    for index in np.argsort(price, kind="stable"):
        if len(chosen) == rank:
            break
        if np.linalg.matrix_rank(candidates[[*chosen, index]]) > len(chosen):
            chosen.append(int(index))
    return tuple(
        Product(
            exponents=tuple(int(x) for x in candidates[k]),
            sd=float(sd[k]),
            prior_sd=float(before[k]),
            bound=information.bound(candidates[k]),
        )
        for k in chosen
    )


def simple_exponents(m: int) -> Array:
    """All products of up to three unknowns with exponents up to 2, the first one positive."""
    rows = []
    for size in range(1, min(MOST_FACTORS, m) + 1):
        for places in itertools.combinations(range(m), size):
            for powers in itertools.product((1, -1, 2, -2), repeat=size):
                if powers[0] > 0 and math.gcd(*powers) == 1:
                    row = np.zeros(m)
                    row[list(places)] = powers
                    rows.append(row)
    return np.array(rows)
