"""Sensitivities and information: slopes of the response, bounds by algebra, what nuisances hide."""

import numpy as np
import pytest
from support import two_experiments
from support.scipy_oracles import NOMINAL
from support.small_problems import noisy_step, posterior, vector

from bayesdrill.analysis.identifiability.information import (
    AS_RECORDED,
    DesignVariant,
    Information,
    SensitivityStudy,
    root_of,
)
from bayesdrill.inference import laplace

SIGMA = np.array([0.02, 0.01, 0.05, 0.03])  # unequal
NEAR, FAR = vector(NOMINAL), vector(NOMINAL) * np.linspace(0.8, 1.2, 9)


def test_sensitivities_are_the_slopes_of_the_response() -> None:
    """Against Richardson differences of the response."""
    likelihood = posterior(noisy_step(SIGMA), SIGMA).likelihood
    exact = SensitivityStudy(likelihood).sensitivities(FAR).reshape(-1, 4, 9)

    def slopes(h: float) -> np.ndarray:
        factors = np.exp(h * np.eye(9))
        signals = likelihood.signals(np.concatenate([FAR * factors, FAR / factors]))
        return (signals[:9] - signals[9:]) / (2 * h)

    numeric = np.moveaxis((4 * slopes(1e-3) - slopes(2e-3)) / 3, 0, -1) / SIGMA[:, None]
    assert np.abs(exact - numeric).max() < 1e-7 * np.abs(exact).max()


def test_a_point_or_an_input_that_was_left_is_forgotten() -> None:
    likelihood, half = (
        posterior(noisy_step(SIGMA), SIGMA).likelihood,
        DesignVariant(factors={"v": 0.5}),
    )
    study = SensitivityStudy(likelihood)
    points = [(NEAR, half), (NEAR, AS_RECORDED), (NEAR, half), (FAR, half), (FAR, AS_RECORDED)]
    for theta, variant in [*points, (NEAR, AS_RECORDED)]:
        fresh = SensitivityStudy(likelihood).with_nuisances(theta, variant)
        assert np.array_equal(study.with_nuisances(theta, variant), fresh)
    assert not np.array_equal(study.with_nuisances(NEAR), study.with_nuisances(FAR))


def test_bounds_of_products_follow_by_algebra() -> None:
    """The record knows a/b to 0.1 and b to 0.5, and nothing of c."""
    rows = np.diag([10.0, 2.0, 0.0]) @ np.array([[1, -1, 0], [0, 1, 0], [0, 0, 1]])
    known = Information(("a", "b", "c"), root_of(rows))
    assert known.n_blind == 1
    assert known.bound(np.array([1.0, -1.0, 0.0])) == pytest.approx(0.1)
    assert known.bound(np.array([0.0, 1.0, 0.0])) == pytest.approx(0.5)
    assert known.bound(np.array([1.0, 0.0, 0.0])) == pytest.approx(np.hypot(0.1, 0.5))
    assert known.bound(np.array([1.0, 0.0, 1.0])) == np.inf
    joint = known.with_priors(np.array([np.inf, np.inf, 0.25]))
    assert joint.bound(np.array([1.0, 0.0, 1.0])) == pytest.approx(np.sqrt(0.01 + 0.25 + 0.25**2))


def test_nuisances_are_taken_out_as_freely_as_their_priors_allow() -> None:
    """The information of the rig is the Schur complement of that of sensors and starts."""
    target = two_experiments.rich_job().problem.posterior
    theta = target.space.draw(1, np.random.default_rng(4))[0]
    study = SensitivityStudy(target.likelihood)
    assert study.unknowns == ("k_e", "k_s", "t_f_late", "t_f_moving")
    root, rows, m = study.sensitivities(theta), study.with_nuisances(theta), len(study.unknowns)
    joint = rows.T @ rows
    nuisances = target.space.unknowns[m : rows.shape[1]]
    joint[m:, m:] += np.diag([1 / laplace.natural_sd(u) ** 2 for u in nuisances])
    a, b, d = joint[:m, :m], joint[:m, m:], joint[m:, m:]
    expected = a - b @ np.linalg.solve(d, b.T)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert root.T @ root / scale == pytest.approx(expected / scale, abs=1e-7)
    assert (np.diag(a) / np.diag(expected)).max() > 1.5  # the sensors hide something
