"""The learnt proposal: exact whatever it has learnt, and good where it should be.

The exact test is that of `test_moves.py`: walkers that start i.i.d. from the target stay so.
"""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats
from targets import TARGETS

from bayesdrill.samplers import independence, shear
from bayesdrill.samplers.ensemble import State, advance, everywhere
from bayesdrill.samplers.independence import Proposal, expected_acceptance, learn

FAIL = 1e-6
ALONE = {"independence": 1.0}


class Bent:
    """A skewed loose coordinate, and a tight one that is a quadratic of it: far off the origin.

    Cut off on both sides of the loose coordinate, as a prior does.
    """

    low, high, bend, tightness = 0.5, 2.5, 0.3, 0.02
    loose = scipy.stats.gamma(2.0)

    def draw(self, n: int, rng: np.random.Generator) -> np.ndarray:
        share = self.loose.cdf(self.low) + rng.random(n) * self._mass()
        x = self.loose.ppf(share)
        return np.stack(
            [x, 40.0 + self.bend * x**2 + self.tightness * rng.standard_normal(n)], axis=-1
        )

    def inside(self, z: np.ndarray) -> np.ndarray:
        return (z[:, 0] > self.low) & (z[:, 0] < self.high)

    def log_density(self, z: np.ndarray) -> np.ndarray:
        off = (z[:, 1] - 40.0 - self.bend * z[:, 0] ** 2) / self.tightness
        with np.errstate(invalid="ignore"):
            return np.where(self.inside(z), self.loose.logpdf(z[:, 0]) - 0.5 * off**2, -np.inf)

    def p_values(self, z: np.ndarray) -> list[float]:
        share = (self.loose.cdf(z[:, 0]) - self.loose.cdf(self.low)) / self._mass()
        off = (z[:, 1] - 40.0 - self.bend * z[:, 0] ** 2) / self.tightness
        return [scipy.stats.kstest(share, "uniform").pvalue, scipy.stats.kstest(off, "norm").pvalue]

    def _mass(self) -> float:
        return float(self.loose.cdf(self.high) - self.loose.cdf(self.low))


BENT = Bent()


def bent_proposal(n: int = 2000) -> Proposal:
    draws = BENT.draw(n, np.random.default_rng(2))
    return learn(draws, BENT.inside, np.random.RandomState(3))


def walked(proposal: Proposal, n: int = 4000, steps: int = 30):
    z = BENT.draw(n, np.random.default_rng(5))
    state = State(z, BENT.log_density(z), np.random.RandomState(6).get_state())
    evaluate = lambda z: (BENT.log_density(z), 0)  # noqa: E731
    return advance(evaluate, state, steps, ALONE, proposal, BENT.inside)


def test_a_bent_target_that_is_cut_off_is_kept_exactly() -> None:
    """Mutants killed: a density of the bent instead of the straight point; a draw cut unevenly."""
    assert min(BENT.p_values(walked(bent_proposal()).state.z)) > FAIL


def test_a_proposal_learnt_from_something_else_is_exact_too() -> None:
    draws = BENT.draw(2000, np.random.default_rng(2)) + np.array([0.3, 0.5])
    proposal = learn(draws, BENT.inside, np.random.RandomState(3))
    assert min(BENT.p_values(walked(proposal, steps=100).state.z)) > FAIL


def test_a_bend_is_taken_out() -> None:
    """Mutant killed: the quadratic left out (acceptance 0.5)."""
    piece = walked(bent_proposal())
    assert piece.accepted.mean() / len(piece.z) > 0.85


def test_what_the_prior_cuts_off_is_filled_up() -> None:
    """A density that fills a box; mutant killed: no filling up (acceptance 0.63)."""
    draws = np.random.default_rng(0).uniform(2.0, 3.0, (3000, 4))

    def inside(z: np.ndarray) -> np.ndarray:
        return ((z > 2.0) & (z < 3.0)).all(axis=1)

    proposal = learn(draws, inside, np.random.RandomState(1))
    flat = lambda z: np.where(inside(z), 0.0, -np.inf)  # noqa: E731
    random = np.random.RandomState(2)
    assert expected_acceptance(proposal, flat, inside, draws, flat(draws), random) > 0.73


def test_redraws_that_run_out_keep_the_target(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draws outside the prior are then proposed, and never accepted."""
    monkeypatch.setattr(independence, "MOST_REDRAWS", 1)
    piece = walked(bent_proposal())
    assert BENT.inside(piece.z.reshape(-1, 2)).all()
    assert min(BENT.p_values(piece.state.z)) > FAIL


def test_shear_goes_back_and_keeps_volumes() -> None:
    straight = shear.fit(BENT.draw(2000, np.random.default_rng(2)))
    assert list(straight.loose) == [0]
    z = BENT.draw(50, np.random.default_rng(3)) + np.array([0.1, -0.7])
    assert np.allclose(straight.bend(straight.straighten(z)), z, rtol=1e-12)
    for point in z[:5]:
        shifts = 1e-5 * straight.scale[:, None] * np.eye(2)
        columns = straight.straighten(point + shifts) - straight.straighten(point - shifts)
        jacobian = columns.T / (2e-5 * straight.scale)
        assert np.linalg.det(jacobian) * straight.scale.prod() == pytest.approx(1.0, rel=1e-6)


def test_a_straight_target_is_left_straight() -> None:
    draws = np.random.default_rng(4).multivariate_normal(
        [3.0, -1.0], [[4.0, 1.0], [1.0, 0.3]], 2000
    )
    assert len(shear.fit(draws).loose) == 0


def test_mixture_is_a_normalised_density_that_its_draws_follow() -> None:
    proposal = bent_proposal()
    mixture, random = proposal.mixture, np.random.RandomState(4)
    y = mixture.draw(100_000, random)
    side = np.linspace(-12, 12, 1201)
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    density = np.exp(mixture.log_density(grid))
    cell = (side[1] - side[0]) ** 2
    assert density.sum() * cell == pytest.approx(1.0, abs=1e-3)
    mean = (density[:, None] * grid).sum(axis=0) * cell
    assert y.mean(axis=0) == pytest.approx(mean, abs=0.02)
    variance = (density[:, None] * (grid - mean) ** 2).sum(axis=0) * cell
    assert y.std(axis=0) == pytest.approx(np.sqrt(variance), rel=0.02)


def test_learning_is_reproducible_and_survives_few_draws() -> None:
    draws = TARGETS["wild"].draw(500, 5, np.random.default_rng(1))
    one, two = (learn(draws, everywhere, np.random.RandomState(7)) for _ in range(2))
    assert np.array_equal(one.mixture.means, two.mixture.means)
    assert np.array_equal(one.mixture.roots, two.mixture.roots)
    few = learn(draws[:40], everywhere, np.random.RandomState(7))
    assert len(few.mixture.weights) == 2  # one that is fitted, and the wide one


def test_expected_acceptance_is_that_of_the_move() -> None:
    proposal = bent_proposal()
    z = BENT.draw(4000, np.random.default_rng(8))
    expected = expected_acceptance(
        proposal, BENT.log_density, BENT.inside, z, BENT.log_density(z), np.random.RandomState(2)
    )
    piece = walked(proposal)
    assert piece.accepted.mean() / len(piece.z) == pytest.approx(expected, abs=0.02)


def test_a_forgotten_proposal_density_is_found_out() -> None:
    """The power of the exact test: without q(old)/q(new) the walkers follow p q."""

    class Forgetful:
        def propose(self, z, inside, random):
            fresh, factor = bent.propose(z, inside, random)
            return fresh, np.zeros_like(factor)

    bent = bent_proposal()
    assert min(BENT.p_values(walked(Forgetful()).state.z)) < FAIL
