"""Targets with known draws: skewed, bent, cut off, of two modes; off the origin, with unequal scales.

Each turns its draws into independent uniform variables, so that a Kolmogorov-Smirnov test is exact.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.special
import scipy.stats
from scipy.special import ndtr, ndtri

from bayesdrill.sampling.samplers import ridge
from bayesdrill.sampling.samplers.ridge import RidgeMap

SHAPE = 1.5  # of the gamma variables whose logs are mixed: skewed to the left


@dataclass(frozen=True)
class Target:
    """Variables mixed by a lower triangle, scaled and shifted."""

    scales: tuple[float, ...] = (3.0, 0.04, 1.0, 20.0, 0.7, 5.0, 0.1, 1.4, 0.02)
    centre: tuple[float, ...] = (5.0, -2.0, 0.3, 100.0, 1.0, -40.0, 0.5, 3.0, 0.0)
    neighbour: float = 1.5
    others: float = 0.3

    def mixing(self, d: int) -> np.ndarray:
        lower = np.eye(d)
        for k in range(1, d):
            lower[k, : k - 1] = self.others
            lower[k, k - 1] = self.neighbour
        return lower * np.array(self.scales[:d])[:, None]

    def mix(self, base: np.ndarray) -> np.ndarray:
        d = base.shape[-1]
        return base @ self.mixing(d).T + self.centre[:d]

    def unmix(self, x: np.ndarray) -> np.ndarray:
        d = x.shape[-1]
        return np.linalg.solve(self.mixing(d), (x - self.centre[:d]).T).T

    def draw(self, n: int, d: int, rng: np.random.Generator) -> np.ndarray:
        """`(n, d)` independent draws."""
        raise NotImplementedError

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """`(W, d) -> (W,)`, unnormalised."""
        raise NotImplementedError

    def uniforms(self, x: np.ndarray) -> np.ndarray:
        """Draws `(n, d)` as independent uniform variables."""
        raise NotImplementedError

    def in_support(self, x: np.ndarray) -> np.ndarray:
        return np.ones(len(x), dtype=bool)

    def mode(self, x: np.ndarray) -> np.ndarray:
        """Return the number of the mode, from 0 on, to which each of `x (n, d)` belongs: `(n,)`."""
        return np.zeros(len(x), dtype=int)

    def ridges(self, d: int) -> list[RidgeMap]:
        """Return two ridges that bend one way and the other; most targets need none."""
        base = self.unmix(self.draw(500, d, np.random.default_rng(7)))
        columns = self.mixing(d) @ np.linalg.cholesky(np.cov(base.T))
        centre = self.mix(base.mean(axis=0)[None])[0]
        return [bent_ridge(centre, columns, 0.3), bent_ridge(centre, 1.7 * columns, -0.2)]

    def p_values(self, x: np.ndarray) -> np.ndarray:
        """Return p values of Kolmogorov-Smirnov tests of each independent variable, of their sum and of
        the sum of their squares, which see what no margin does.
        """
        uniforms = self.uniforms(x)
        scores = ndtri(np.clip(uniforms, 1e-15, 1.0 - 1e-15))
        d = x.shape[1]
        tests = [*uniforms.T, ndtr(scores.sum(axis=1) / np.sqrt(d))]
        tests.append(scipy.stats.chi2(d).cdf((scores**2).sum(axis=1)))
        return np.array([scipy.stats.kstest(sample, "uniform").pvalue for sample in tests])


@dataclass(frozen=True)
class Skewed(Target):
    """Independent log-gamma variables, mixed."""

    def draw(self, n: int, d: int, rng: np.random.Generator) -> np.ndarray:
        return self.mix(np.log(rng.gamma(SHAPE, size=(n, d))))

    def log_density(self, x: np.ndarray) -> np.ndarray:
        base = self.unmix(x)
        with np.errstate(over="ignore"):
            return (SHAPE * base - np.exp(base)).sum(axis=-1)

    def uniforms(self, x: np.ndarray) -> np.ndarray:
        return scipy.special.gammainc(SHAPE, np.exp(np.clip(self.unmix(x), -700, 700)))


@dataclass(frozen=True)
class Bent(Target):
    """Loose log-gamma variables, and tight ones whose place and spread are curved functions of them."""

    ends: tuple[float, float] = (-np.inf, np.inf)  # of the loose variables
    least: float = -np.inf  # standard deviation below which a tight one is cut off
    shape: ClassVar[float] = 3.0
    tightness: ClassVar[float] = 0.05

    def curve(self, psi: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return place, spread and dependence on the variable before, `(W, n)`, of `psi (W, l)`."""
        loose = psi[:, np.arange(n) % psi.shape[1]]
        place = np.cos(0.9 * loose + np.arange(n)) + 0.3 * psi[:, :1] * loose
        spread = self.tightness * np.exp(0.8 * (loose - 1.0))
        slope = (0.5 + 0.3 * loose) * np.roll(spread, 1, axis=1)
        slope[:, 0] = 0.0
        return place, spread, slope

    def parts(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return loose variables, tight ones in standard deviations, and log det of their root."""
        psi, tau = np.split(self.unmix(x), [count_loose(x.shape[1])], axis=1)
        place, spread, slope = self.curve(np.clip(psi, -20.0, 20.0), tau.shape[1])
        e = (tau - place) / spread
        for j in range(1, e.shape[1]):
            e[:, j] -= slope[:, j] / spread[:, j] * e[:, j - 1]
        return psi, e, np.log(spread).sum(axis=1)

    def draw(self, n: int, d: int, rng: np.random.Generator) -> np.ndarray:
        share = self._mass(np.array(self.ends))
        psi = share[0] + rng.random((n, count_loose(d))) * (share[1] - share[0])
        psi = np.log(scipy.special.gammaincinv(self.shape, psi))
        least = ndtr(self.least)
        e = ndtri(least + (1.0 - least) * rng.random((n, d - count_loose(d))))
        place, spread, slope = self.curve(psi, e.shape[1])
        tau = place + spread * e + slope * np.roll(e, 1, axis=1)
        return self.mix(np.concatenate([psi, tau], axis=1))

    def log_density(self, x: np.ndarray) -> np.ndarray:
        psi, e, log_det = self.parts(x)
        with np.errstate(over="ignore"):
            log_p = (self.shape * psi - np.exp(psi)).sum(axis=1)
        return np.where(self._within(psi, e), log_p - 0.5 * (e**2).sum(axis=1) - log_det, -np.inf)

    def in_support(self, x: np.ndarray) -> np.ndarray:
        return self._within(*self.parts(x)[:2])

    def uniforms(self, x: np.ndarray) -> np.ndarray:
        psi, e, _ = self.parts(x)
        share, least = self._mass(np.array(self.ends)), ndtr(self.least)
        along = (self._mass(psi) - share[0]) / (share[1] - share[0])
        return np.concatenate([along, (ndtr(e) - least) / (1.0 - least)], axis=1)

    def ridges(self, d: int) -> list[RidgeMap]:
        """Return nearly its own ridge, and a ridge of a lower degree in other units."""
        rng, n = np.random.default_rng(3), count_loose(d)
        psi = np.log(rng.gamma(self.shape, size=(600, n)))
        place, spread, slope = self.curve(psi, d - n)
        root = spread[:, :, None] * np.eye(d - n)
        root[:, range(1, d - n), range(d - n - 1)] = slope[:, 1:]

        def scaled(size: float, degree: int) -> RidgeMap:
            basis = ridge.local_basis(np.array(self.centre[:d]), size * self.mixing(d), n)
            return ridge.fit_ridge(basis, psi / size, place / size, root / size, degree, 2)

        return [scaled(1.0, 6), scaled(2.0, 4)]

    def _within(self, psi: np.ndarray, e: np.ndarray) -> np.ndarray:
        ends = (psi > self.ends[0]) & (psi < self.ends[1])
        return ends.all(axis=1) & (e > self.least).all(axis=1)

    def _mass(self, psi: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore"):
            return scipy.special.gammainc(self.shape, np.exp(psi))


@dataclass(frozen=True)
class Boxed(Target):
    """A box, in which the density rises exponentially towards one corner."""

    rate: ClassVar[float] = 3.0

    def _base(self, x: np.ndarray) -> np.ndarray:
        d = x.shape[1]
        return (x - self.centre[:d]) / self.scales[:d]

    def draw(self, n: int, d: int, rng: np.random.Generator) -> np.ndarray:
        rise = np.expm1(self.rate)
        return self.centre[:d] + self.scales[:d] * np.log1p(rise * rng.random((n, d))) / self.rate

    def log_density(self, x: np.ndarray) -> np.ndarray:
        return np.where(self.in_support(x), self.rate * self._base(x).sum(axis=1), -np.inf)

    def in_support(self, x: np.ndarray) -> np.ndarray:
        base = self._base(x)
        return ((base > 0.0) & (base < 1.0)).all(axis=1)

    def uniforms(self, x: np.ndarray) -> np.ndarray:
        return np.expm1(self.rate * self._base(x)) / np.expm1(self.rate)


@dataclass(frozen=True)
class TwoModes(Target):
    """A mixture of two round normal distributions: the first of weight 0.3, the other twice as wide."""

    first: ClassVar[float] = 0.3
    distance: ClassVar[float] = 16.0
    wide: ClassVar[float] = 2.0

    def draw(self, n: int, d: int, rng: np.random.Generator) -> np.ndarray:
        second = rng.random(n) > self.first
        base = rng.standard_normal((n, d)) * np.where(second, self.wide, 1.0)[:, None]
        base[:, 0] += self.distance * second
        return self.mix(base)

    def log_density(self, x: np.ndarray) -> np.ndarray:
        d, base = x.shape[1], self.unmix(x)
        other = (base - self.distance * np.eye(d)[0]) / self.wide
        log_wide = np.log(1.0 - self.first) - d * np.log(self.wide) - 0.5 * (other**2).sum(axis=1)
        return np.logaddexp(np.log(self.first) - 0.5 * (base**2).sum(axis=1), log_wide)

    def mode(self, x: np.ndarray) -> np.ndarray:
        return (self.unmix(x)[:, 0] > 0.4 * self.distance).astype(int)

    def uniforms(self, x: np.ndarray) -> np.ndarray:
        base, second = self.unmix(x), self.mode(x)
        uniforms = ndtr(base / np.where(second, self.wide, 1.0)[:, None])
        high = ndtr((base[:, 0] - self.distance) / self.wide)
        uniforms[:, 0] = self.first * ndtr(base[:, 0]) + (1.0 - self.first) * high
        return uniforms

    def ridges(self, d: int) -> list[RidgeMap]:
        """Return a ridge through each mode, neither of them straight."""
        other, columns = self.mix(self.distance * np.eye(d)[:1])[0], self.mixing(d)
        first = bent_ridge(np.array(self.centre[:d]), columns, 0.2)
        return [first, bent_ridge(other, self.wide * columns, -0.2)]


def count_loose(d: int) -> int:
    """Return how many of `d` variables the tight ones follow."""
    return (d + 1) // 3


def bent_ridge(centre: np.ndarray, columns: np.ndarray, bend: float) -> RidgeMap:
    """Return a ridge that bends in all its directions, and whose root changes along it."""
    d, n = len(centre), count_loose(len(centre))
    psi = np.random.default_rng(5).standard_normal((300, n))
    tau = bend * np.repeat((psi**2).sum(axis=1)[:, None], d - n, axis=1)
    root = np.exp(bend * psi.sum(axis=1))[:, None, None] * (
        np.eye(d - n) + 0.2 * np.eye(d - n, k=-1)
    )
    return ridge.fit_ridge(ridge.local_basis(centre, columns, n), psi, tau, root, 2, 1)


WILD = Skewed()
MILD = Skewed(
    (1.0, 1.3, 0.8, 1.1, 0.9, 1.0, 1.2, 0.9, 1.1),
    (4.0, -2.0, 1.0, 3.0, -1.0, 2.0, 0.5, -3.0, 1.0),
    0.4,
    0.1,
)
TARGETS = {
    "wild": WILD,
    "mild": MILD,
    "bent": Bent(),
    "cut": Bent(ends=(0.2, 1.5), least=-1.0),
    "boxed": Boxed(),
    "two_modes": TwoModes(),
}
