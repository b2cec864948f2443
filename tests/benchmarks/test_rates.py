"""A few records of each rate, which show already what hundreds show."""

import numpy as np
import pytest
from support.case_tables import run_cases

from bayesdrill.analysis.latent_torque import torque_estimates
from bayesdrill.report.sections.torque import HARMLESS
from bayesdrill.rig.simulators.stepped import Stepped
from benchmarks.rates import noise, rubbing_torque, torque
from benchmarks.rates.records import TORQUE, observed, of


def test_intervals_hold_the_truth_and_friction_is_named() -> None:
    results = [torque.told(seed) for seed in range(3)]
    assert sum(torque.held(results).values()) >= 0.75 * len(results) * len(results[0].below)
    assert torque.named(results) == len(results)
    assert min(result.within for result in results) > 0.85


@pytest.mark.slow  # `make rates` has many of them
def test_beside_friction_a_small_torque_is_estimated_and_a_large_one_said_to_stray() -> None:
    result = rubbing_torque.told(1)
    assert sum(rubbing_torque.held([result]).values()) >= 5
    assert result.alike > 0.8
    assert rubbing_torque.strayed(rubbing_torque.LARGE, 2) > HARMLESS


def test_intervals_of_correlated_noise_need_a_likelihood_that_knows_of_it() -> None:
    white, ar1 = noise.held("white", 12), noise.held("ar1", 12)
    assert sum(white[name] for name in noise.FREE) < 0.6 * 12 * len(noise.FREE)
    assert sum(ar1[name] for name in noise.FREE) > 0.8 * 12 * len(noise.FREE)


@run_cases("at", ["rotor_1", "motor"])
def test_without_friction_the_rig_goes_where_the_torque_moves_it(at: str) -> None:
    """The courses of a torque have its sign and its gear, and hold it in the middle of each step."""
    missing = {**TORQUE, "at": at, "smoothness": "3/2"}
    target = observed(rubs={"t_c1": 0.0}, missing_torque=missing)
    observation, rng = target.likelihood.observations[0], np.random.default_rng(3)
    assert isinstance(observation.response, Stepped)
    space = target.space
    theta = space.vector({**space.start, "s_d": 0.1, "tau_d": 1.0})
    full = space.full(theta[None])
    y = observation.draw(observation.signals(full), theta[None], rng)[0]
    (estimate,) = torque_estimates(of(target, observation.with_record(y)), theta[None], rng)
    assert max(course.moved for course in estimate.courses) > 0.5
    assert max(course.strayed for course in estimate.courses) < 0.1
