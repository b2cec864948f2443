"""Where samples lie in their own prediction: exact for a mean, outside the band where wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr
from support.case_tables import run_cases
from support.small_problems import likelihood_of

from bayesdrill.analysis.prediction import leave_one_out_check, prediction_checks
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.posterior import Likelihood
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import ParameterSpace, Unknown
from bayesdrill.record.experiment import Channel, Experiment

Array = NDArray[np.float64]

SIGMA = 0.3


@dataclass(frozen=True)
class Constant:
    """A rig that stands at its only parameter."""

    experiment: Experiment

    def signals(self, full: Array) -> Array:
        return np.asarray(np.broadcast_to(full[:, None, :1], (len(full), *self.experiment.y.shape)))


def likelihood(y: Array, sigma: float = SIGMA) -> Likelihood:
    """Of one channel `y (T,)` about an unknown mean."""
    channel = Channel(name="w_1", weights={}, unit="rad/s", latex="w_1", latex_unit="rad/s")
    given: dict[str, Any] = {"constant": {}, "series": {}, "first_order": False, "start": {}}
    t = np.arange(float(len(y)))
    experiment = Experiment(t=t, y=y[:, None], channels=(channel,), t_start=0.0, **given)
    mean = Unknown(
        symbol=Symbol("mu", "rad/s", r"\mu", "rad/s", "the mean"),
        role="rig",
        prior=Uniform(0.1, 10.0),
        start=1.0,
    )
    space = ParameterSpace(model=("mu",), unknowns=(mean,), fixed={})
    noise = White(n_samples=len(y), known={0: sigma}, n_channels=1)
    return likelihood_of(space, (Constant(experiment), noise))  # type: ignore[arg-type]


def record(n: int, seed: int = 5) -> Array:
    return 2.0 + SIGMA * np.random.default_rng(seed).standard_normal(n)


def posterior(y: Array, sigma: float, n: int) -> Array:
    """Exact draws of the mean `(n, 1)`."""
    rng = np.random.default_rng(6)
    return y.mean() + sigma / np.sqrt(len(y)) * rng.standard_normal((n, 1))


def alone(y: Array, theta: Array) -> Array:
    target = likelihood(y)
    return leave_one_out_check(target, target.only_observation, theta)


def test_each_sample_is_predicted_without_itself() -> None:
    """Oracle: the mean of the others, and its own uncertainty.  With the sample it would be off."""
    y = record(8)
    theta = posterior(y, SIGMA, 40_000)
    others = (y.sum() - y) / 7
    exact = ndtr((y - others) / (SIGMA * np.sqrt(1 + 1 / 7)))
    found = alone(y, theta)[:, 0]
    assert found == pytest.approx(exact, abs=0.01)
    with_itself = ndtr((y[None] - theta) / SIGMA).mean(axis=0)
    assert np.abs(with_itself - exact).max() > 0.03


@run_cases(
    "believed, moved, says",
    [
        (SIGMA, 0.0, ""),
        (0.7 * SIGMA, 0.0, "prediction too narrow"),
        (1.4 * SIGMA, 0.0, "prediction too wide"),
        (SIGMA, 0.1, "measured lies above"),
        (SIGMA, -0.1, "measured lies below"),
    ],
)
def test_a_wrong_prediction_leaves_the_band_and_is_named(
    believed: float, moved: float, says: str
) -> None:
    y = record(1000)
    theta = posterior(y, believed, 400) - moved
    (found,) = prediction_checks(likelihood(y, believed), theta)
    assert found.holds is (says == "")
    assert found.says == says


def test_a_long_record_is_looked_at_from_end_to_end() -> None:
    y = record(5000)
    (found,) = prediction_checks(likelihood(y), posterior(y, SIGMA, 50))
    assert len(found.pit) == 2000
    assert found.holds
    assert found.band.counts(found.ranks)[-1] <= 2000


def test_samples_that_all_draws_predict_alike_are_no_trouble() -> None:
    y = record(50)
    theta = np.full((30, 1), 2.0)
    assert alone(y, theta)[:, 0] == pytest.approx(ndtr((y - 2.0) / SIGMA))
