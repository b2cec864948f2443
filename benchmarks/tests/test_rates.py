"""A few records of each rate, which show already what hundreds show."""

import numpy as np

from bayesdrill.analysis.latent_torque import torque_estimates
from bayesdrill.rig.simulators.stepped import Stepped
from benchmarks.rates.records import TORQUE, observed, of


def test_without_friction_the_rig_goes_where_the_torque_moves_it() -> None:
    """The courses of a torque have its sign and its gear, and hold it in the middle of each step."""
    missing = {**TORQUE, "at": "motor", "smoothness": "3/2"}
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
