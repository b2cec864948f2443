"""Surfaces that are known in closed form: humps between walls, and a bent ridge."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from bayesdrill.inference.laplace import QuadraticModel
from bayesdrill.sampling.proposal.learning import LearnedProposal, learn


@dataclass(frozen=True)
class Walled:
    """Between `middle - reach spread` and `middle + reach spread`."""

    middle: np.ndarray
    spread: np.ndarray
    reach: float

    @property
    def low(self) -> np.ndarray:
        return self.middle - self.reach * self.spread

    @property
    def high(self) -> np.ndarray:
        return self.middle + self.reach * self.spread

    def in_support(self, u: np.ndarray) -> np.ndarray:
        return ((u >= self.low) & (u <= self.high)).all(axis=1)

    def value(self, u: np.ndarray) -> np.ndarray:
        return np.where(self.in_support(u), self.log_density(u), -np.inf)

    def log_density(self, u: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def derivatives(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slopes `(W, D)` and curvatures `(W, D, D)`, those of Gauss and Newton."""
        raise NotImplementedError

    def quadratic_model(self, u: np.ndarray, directions: np.ndarray) -> QuadraticModel:
        slope, curvature = self.derivatives(u)
        # Sums one after the other: a product of matrices rounds as their number has it.
        along = np.einsum("wd,dq->wq", slope, directions)
        return QuadraticModel(
            self.value(u), along, np.einsum("dp,wde,eq->wpq", directions, curvature, directions)
        )

    curvature_model = approximate_model = quadratic_model


@dataclass(frozen=True)
class Gaussians(Walled):
    """Of `weights (K,)`, `means (K, D)` and covariance roots `(K, D, D)`.

    The curvature is that of the one to which a point belongs most.
    """

    weights: np.ndarray
    means: np.ndarray
    roots: np.ndarray

    def parts(self, u: np.ndarray) -> np.ndarray:
        """Log densities `(K, W)`."""
        white = np.linalg.solve(self.roots[:, None], (u - self.means[:, None])[..., None])[..., 0]
        volume = np.log(np.abs(np.linalg.det(self.roots)))
        return (np.log(self.weights) - volume)[:, None] - 0.5 * (white**2).sum(axis=2)

    def log_density(self, u: np.ndarray) -> np.ndarray:
        return np.logaddexp.reduce(self.parts(u), axis=0)

    def belongs(self, u: np.ndarray) -> np.ndarray:
        """`(W,)`: to which one."""
        return np.argmax(self.parts(u), axis=0)

    def derivatives(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parts = self.parts(u)
        shares = np.exp(parts - np.logaddexp.reduce(parts, axis=0))
        back = np.linalg.inv(self.roots)
        inverse = back.swapaxes(1, 2) @ back
        off = u - self.means[:, None]
        slope = -np.einsum("kw,kde,kwe->wd", shares, inverse, off)
        return slope, inverse[np.argmax(parts, axis=0)]


def humps(d: int, weights: Sequence[float], sds: Sequence[float], apart: float) -> Gaussians:
    """Along a slanted line, `apart` of the larger sds; loose are their last ones, from three on."""
    turned = np.linalg.qr(np.random.default_rng(d).standard_normal((d, d)))[0]
    scales = np.geomspace(1.0, 4.0, d)
    far = apart * max(sds) * turned[0]
    each = np.where(np.arange(d) > 1, 8.0, 1.0)  # of the spread of 24: known 9 times better
    roots = np.array([scales[:, None] * turned.T @ np.diag(sd * each) for sd in sds])
    means = scales * np.array([k * far for k in range(len(sds))])
    middle = scales * (0.5 * far + 3.0)
    return Gaussians(middle, 24.0 * scales, 5.0, np.array(weights), means, roots)


@dataclass(frozen=True)
class Ridged(Walled):
    """Exp(-|e|^2 / 2) with e = (tau - place(psi)) / sd(psi), and u mixed from psi and tau.

    Flat along the ridge e = 0, which is known: it bends by hundreds of standard deviations, which
    change manifold along it.
    """

    n_loose: int
    tightness: float = 0.01
    bend: float = 1.2
    widening: float = 2.2

    @property
    def mixing(self) -> np.ndarray:
        d = len(self.middle)
        return np.eye(d) + 0.4 * np.eye(d, k=1) - 0.3 * np.eye(d, k=-1)

    def place(self, psi: np.ndarray) -> np.ndarray:
        own = psi[:, self._own]
        return np.exp(self.bend * own) + 0.5 * psi[:, :1] * own**2

    def sd(self, psi: np.ndarray) -> np.ndarray:
        return self.tightness * np.exp(self.widening * psi[:, self._own])

    def at(self, psi: np.ndarray, e: np.ndarray) -> np.ndarray:
        """`psi (W, l)` and `e (W, t)` to u."""
        return np.concatenate([psi, self.place(psi) + self.sd(psi) * e], axis=1) @ self.mixing.T

    def parts(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """psi and e."""
        psi, tau = np.split(np.linalg.solve(self.mixing, u.T).T, [self.n_loose], axis=1)
        return psi, (tau - self.place(psi)) / self.sd(psi)

    def log_density(self, u: np.ndarray) -> np.ndarray:
        return -0.5 * (self.parts(u)[1] ** 2).sum(axis=1)

    def derivatives(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        (psi, e), own = self.parts(u), self._own
        sd, x = self.sd(psi), psi[:, self._own]
        by_x = np.zeros((*e.shape, u.shape[1]))
        rows = np.arange(e.shape[1])
        by_x[:, rows, own] -= (self.bend * np.exp(self.bend * x) + psi[:, :1] * x) / sd
        by_x[:, rows, own] -= self.widening * e
        by_x[:, rows, 0] -= 0.5 * x**2 / sd
        by_x[:, rows, self.n_loose + rows] = 1.0 / sd
        by_u = by_x @ np.linalg.inv(self.mixing)
        return -np.einsum("wtd,wt->wd", by_u, e), np.einsum("wtd,wte->wde", by_u, by_u)

    @property
    def _own(self) -> np.ndarray:
        """Which of the loose variables each tight one follows."""
        return np.arange(len(self.middle) - self.n_loose) % self.n_loose


def ridged(n_loose: int, n_tight: int) -> Ridged:
    d = n_loose + n_tight
    return Ridged(0.5 * np.ones(d), np.full(d, 0.7), 1.8, n_loose)


@dataclass(frozen=True)
class Corner(Walled):
    """Of two unknowns, logs, whose sum is known: one arm where the first is the sum, one where the
    second is, as long as each other.
    """

    sd: float

    def log_density(self, u: np.ndarray) -> np.ndarray:
        return -0.5 * (np.logaddexp(u[:, 0], u[:, 1]) / self.sd) ** 2

    def derivatives(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        total = np.logaddexp(u[:, 0], u[:, 1])
        by = np.exp(u - total[:, None]) / self.sd
        return -total[:, None] / self.sd * by, np.einsum("wd,we->wde", by, by)


def corner() -> Corner:
    return Corner(np.full(2, -5.5), np.full(2, 3.0), 2.0, 1e-3)


def altered[Surface: Walled](surface: Surface, **methods: Callable[..., object]) -> Surface:
    """The same surface with other methods."""
    kind = type("Altered", (type(surface),), methods)
    return kind(**{field.name: getattr(surface, field.name) for field in fields(surface)})


def without_density[Surface: Walled](surface: Surface) -> Surface:
    """The same surface, whose density is zero everywhere."""
    return altered(surface, value=lambda self, u: np.full(len(u), -np.inf))


def learned(surface: Walled, maxima: Sequence[np.ndarray], seed: int = 1) -> LearnedProposal:
    """The proposal that is learnt from these maxima `(D,)`."""
    return learn(
        surface, list(maxima), np.random.RandomState(seed), np.random.default_rng(seed + 2)
    )


def ridge_point(surface: Ridged) -> np.ndarray:
    """A point `(D,)` on the ridge."""
    d = len(surface.middle)
    return surface.at(np.full((1, surface.n_loose), 0.1), np.zeros((1, d - surface.n_loose)))[0]
