"""Profile likelihoods of unknowns that the record bounds, and of one that it does not show."""

import numpy as np
import pytest
from support.scipy_oracles import NOMINAL, ORDER
from support.small_problems import noisy_step, posterior

from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.identifiability.profile import THRESHOLD, Fitter, profile
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform

SIGMA = np.array([0.02, 0.01, 0.05, 0.03])  # unequal


def fitter_of(target: Posterior, theta: np.ndarray | None = None) -> Fitter:
    at = target.space.vector(target.space.start) if theta is None else theta
    return Fitter(target, SensitivityStudy(target.likelihood), at)


def test_the_profile_of_a_gaussian_problem_is_a_parabola() -> None:
    """The 95 % interval of a well-known unknown is its best value +- 1.96 sd."""
    names, small = ("k_s", "j_m"), np.full(4, 1e-3)
    fitter = fitter_of(posterior(noisy_step(small), small, free=names))
    result, sd = profile(fitter, names, 0), fitter.sds()[0]
    assert result.shape == "bounded"
    width = 2 * np.sqrt(2 * THRESHOLD) * sd
    assert np.log(result.high / result.low) == pytest.approx(width, rel=0.01)
    away = np.log(result.values / result.best) / sd
    near = np.abs(away) < 3.5
    assert result.loss[near] == pytest.approx(0.5 * away[near] ** 2, abs=0.05)


def test_the_profile_of_an_unknown_that_the_record_does_not_show_is_flat() -> None:
    names = tuple(name for name in ORDER if name != "j_1")
    fitter = fitter_of(posterior(noisy_step(SIGMA), SIGMA, free=names))
    flat = profile(fitter, names, names.index("l_m"))
    assert flat.shape == "flat"
    assert flat.loss.max() < THRESHOLD
    assert profile(fitter, names, names.index("k_s")).shape == "bounded"


def test_a_profile_whose_best_fit_is_an_end_of_its_prior_has_each_value_once() -> None:
    names, high = ("k_s", "j_m"), 0.9 * NOMINAL["k_s"]  # below what fits
    priors = {"k_s": Uniform(0.5 * high, high)}
    target = posterior(noisy_step(SIGMA), SIGMA, free=names, priors=priors)
    theta = target.space.vector({"k_s": high, "j_m": NOMINAL["j_m"]})
    result = profile(fitter_of(target, theta), names, 0)
    assert result.best == pytest.approx(high)
    assert np.diff(result.values).min() > 1e-6 * high
