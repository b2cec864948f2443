"""Define coordinates along a ridge, in which a posterior is nearly Gaussian.

A record determines some directions well (tight) and others badly (loose).  In a fixed basis, the
unknowns are x = (psi, tau) with psi loose and tau tight.  The ridge t(psi) is the tau of highest
density at psi.  The coordinates y are

    y = (psi, e)        tau = t(psi) + R(psi) e

where R is the Cholesky factor of the covariance of tau given psi.  Polynomials in psi give t and R.
The Jacobian determinant |dx / dy| is det R.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from bayesdrill.basics.arrays import Array, Flags, Indices

RANGE_MARGIN = 0.25  # entries of R may exceed their range at fitted points by this fraction of it


@dataclass(frozen=True, slots=True)
class Monomials:
    """The first monomial is 1, and each later monomial is an earlier monomial times a variable.

    `products` has the indices of these two factors, for all monomials except the first.
    """

    products: tuple[tuple[int, int], ...]

    @property
    def terms(self) -> int:
        """Return the number of monomials."""
        return 1 + len(self.products)

    def evaluate(self, x: Array) -> Array:
        """Evaluate all monomials, `(n, W) -> (terms, W)`."""
        rows = np.empty((self.terms, x.shape[1]))
        rows[0] = 1.0
        for row, (before, variable) in enumerate(self.products, start=1):
            np.multiply(rows[before], x[variable], out=rows[row])
        return rows


def build_monomials(n: int, degree: int) -> Monomials:
    """Build the monomials of `n` variables up to `degree`."""
    products: list[tuple[int, int]] = []
    last = [(0, 0)]  # monomials of the previous degree, and the largest variable index of each
    for _ in range(degree):
        begin = 1 + len(products)
        pairs = [(m, v) for m, largest in last for v in range(largest, n)]
        products += pairs
        last = [(begin + k, v) for k, (_, v) in enumerate(pairs)]
    return Monomials(tuple(products))


@dataclass(frozen=True, slots=True)
class LocalBasis:
    """The fixed basis gives u = centre + loose psi + tight tau, `loose (D, l)` and `tight (D, t)`.

    `inverse (D, D)` is the inverse of M = (loose, tight), and `log_volume` is log |det M|.
    """

    centre: Array
    loose: Array
    tight: Array
    inverse: Array
    log_volume: float

    def split(self, u: Array) -> tuple[Array, Array]:
        """Split `u (W, D)` into psi `(W, l)` and tau `(W, t)`."""
        x = (u - self.centre) @ self.inverse.T
        n = self.loose.shape[1]
        return x[:, :n], x[:, n:]

    def join(self, psi: Array, tau: Array) -> Array:
        """Join psi `(W, l)` and tau `(W, t)` to `u (W, D)`."""
        return np.asarray(self.centre + psi @ self.loose.T + tau @ self.tight.T)


def local_basis(centre: Array, columns: Array, n_loose: int) -> LocalBasis:
    """Build the basis with `columns (D, D)`, of which the first `n_loose` are loose."""
    volume = float(np.linalg.slogdet(columns)[1])
    back = np.linalg.inv(columns)
    return LocalBasis(centre, columns[:, :n_loose], columns[:, n_loose:], back, volume)


@dataclass(frozen=True, slots=True)
class RidgeMap:
    """A ridge map describes a ridge by polynomials of the loose directions.

    With n tight directions, the coefficients are `location (terms, n)` of the ridge t(psi), and
    `root (terms, n (n + 1) / 2)` of R: of the logs of its diagonal, then of its entries below the
    diagonal, divided by the diagonal entry of their column.  Only the components `bent` of psi are
    used, shifted by `psi_centre` and divided by `width`, so that fitted points lie in the unit ball.
    Points outside `radius` are moved to this radius, as polynomials do not extrapolate.
    Entries of R are clipped to `root_limits (2, n (n + 1) / 2)`.
    """

    frame: LocalBasis
    bent: Indices
    psi_centre: Array
    width: Array
    radius: float
    powers: Monomials
    location: Array
    root: Array
    root_limits: Array

    @property
    def n_loose(self) -> int:
        """Return the number of loose directions."""
        return int(self.frame.loose.shape[1])

    def at(self, psi: Array) -> Array:
        """Return tau `(W, t)` on the ridge at psi `(W, l)`."""
        return self.along(psi)[0]

    def is_covered(self, psi: Array) -> Flags:
        """Return whether each `psi (W, l)` lies in the ball of the fitted points: `(W,)`."""
        scaled = (psi[:, self.bent] - self.psi_centre) / self.width
        return np.asarray((scaled**2).sum(axis=1) <= 1.0)

    def from_ridge_coordinates(self, y: Array) -> tuple[Array, Array]:
        """Map `y (W, D)` to u, and return log |du / dy| `(W,)` too."""
        psi, e = y[:, : self.n_loose], y[:, self.n_loose :]
        tau, root, log_det = self.along(psi)
        tau = tau + np.einsum("ijw,wj->wi", root, e)
        return self.frame.join(psi, tau), log_det + self.frame.log_volume

    def to_ridge_coordinates(self, u: Array) -> tuple[Array, Array]:
        """Map `u (W, D)` to y, and return log |du / dy| `(W,)` too."""
        psi, tau = self.frame.split(u)
        on_ridge, root, log_det = self.along(psi)
        e = _forward_substitution(root, tau - on_ridge)
        return np.concatenate([psi, e], axis=1), log_det + self.frame.log_volume

    def along(self, psi: Array) -> tuple[Array, Array, Array]:
        """Return t `(W, t)`, R `(t, t, W)` and log det R `(W,)` at psi `(W, l)`."""
        scaled = ((psi[:, self.bent] - self.psi_centre) / self.width).T
        radius = np.sqrt(np.einsum("lw,lw->w", scaled, scaled))
        scaled *= self.radius / np.maximum(radius, self.radius)
        rows = self.powers.evaluate(scaled)
        entries = self.root.T @ rows[: len(self.root)]
        np.clip(entries, self.root_limits[0][:, None], self.root_limits[1][:, None], out=entries)
        n = self.location.shape[1]
        root = np.zeros((n, n, psi.shape[0]))
        diagonal = np.exp(entries[:n])
        root[range(n), range(n)] = diagonal
        lower = _below_diagonal(n)
        root[lower] = entries[n:] * diagonal[lower[1]]
        return (self.location.T @ rows).T, root, entries[:n].sum(axis=0)


@cache
def _below_diagonal(n: int) -> tuple[Indices, Indices]:
    """Return rows and columns of the entries below the diagonal of an n by n matrix."""
    return np.tril_indices(n, -1)


def _forward_substitution(root: Array, rhs: Array) -> Array:
    """Solve root e = rhs for e `(W, t)`, with lower triangular `root (t, t, W)` of each walker."""
    e = np.empty((root.shape[0], len(rhs)))
    for row in range(len(root)):
        known = np.einsum("jw,jw->w", root[row, :row], e[:row])
        e[row] = (rhs[:, row] - known) / root[row, row]
    return np.asarray(e.T)


def fit_ridge(
    base: LocalBasis,
    psi: Array,
    tau: Array,
    roots: Array,
    degree: int,
    root_degree: int,
    bent: Indices | None = None,
    reach: float = 1.0,
) -> RidgeMap:
    """Fit polynomials to points of a ridge: `psi (N, l)`, `tau (N, t)` and `roots (N, t, t)`.

    Polynomials of t have this `degree`, and those of R at most `root_degree`.  Their variables
    are the components `bent` of psi, by default all.  `reach` is the `radius` of the `RidgeMap`.
    """
    bent = np.arange(psi.shape[1]) if bent is None else bent
    psi = psi[:, bent]
    middle = psi.mean(axis=0)
    width = np.maximum(psi.std(axis=0), 1e-12)
    radius = np.sqrt((((psi - middle) / width) ** 2).sum(axis=1)).max()
    width = width * max(float(radius), 1e-12)
    scaled = ((psi - middle) / width).T
    # `RidgeMap` describes these entries: logs of the diagonal, and scaled entries below it.
    diagonal = np.diagonal(roots, axis1=1, axis2=2)
    row, column = _below_diagonal(roots.shape[1])
    below = roots[:, row, column] / diagonal[:, column]
    entries = np.concatenate([np.log(diagonal), below], axis=1)
    low, high = entries.min(axis=0), entries.max(axis=0)
    beyond = RANGE_MARGIN * (high - low)
    monomials = build_monomials(len(bent), degree)
    root_terms = build_monomials(len(bent), min(root_degree, degree)).terms
    rows = monomials.evaluate(scaled).T
    return RidgeMap(
        frame=base,
        bent=bent,
        psi_centre=middle,
        width=width,
        radius=reach,
        powers=monomials,
        location=np.linalg.lstsq(rows, tau, rcond=1e-10)[0],
        root=np.linalg.lstsq(rows[:, :root_terms], entries, rcond=1e-10)[0],
        root_limits=np.array([low - beyond, high + beyond]),
    )


def residuals(ridge: RidgeMap, psi: Array, tau: Array, roots: Array) -> Array:
    """Return the distances of points from the fitted ridge, in standard deviations: `(N,)`."""
    sds = np.linalg.solve(roots, (tau - ridge.at(psi))[..., None])[..., 0]
    return np.asarray(np.linalg.norm(sds, axis=1))


def root_residuals(ridge: RidgeMap, psi: Array, tau: Array, roots: Array) -> Array:
    """Return, for each point, the largest error of the log sd of any tight direction: `(N,)`."""
    predicted = np.moveaxis(ridge.along(psi)[1], 2, 0)
    ratio = np.linalg.solve(predicted, roots)
    return np.asarray(np.abs(np.log(np.linalg.svd(ratio, compute_uv=False))).max(axis=1))
