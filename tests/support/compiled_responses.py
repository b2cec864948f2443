"""Responses of the nominal rig with records, compiled once for all tests."""

from functools import cache
from typing import Any

import numpy as np
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment, noisy_step, posterior, vector

from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.linear import Response

SIGMA = np.array([0.1, 0.07, 0.2, 0.15])  # of the four channels of a step
SEEN = {"twist": {"theta_1": 1.0, "theta_2": -1.0}, "speed": {"w_2": 8.0}, "current": {"i": 1.0}}


@cache
def response(name: str) -> Response:
    """Return the response to a step, or to measured inputs with a first sample after the start."""
    if name == "step":
        return Response(MotorShaft(), noisy_step(SIGMA, n=60))
    rng, n = np.random.default_rng(8), 60
    record = experiment(
        n,
        0.013,
        constant={},
        series={"v": 6.0 + rng.standard_normal(n), "t_1": 0.05 * rng.standard_normal(n)},
        first_order=True,
        measures=SEEN,
        first=0.137,
        t_start=0.05,
        start={"theta_1": 0.4, "w_2": 1.0},
    )
    made = Response(MotorShaft(), record)
    clean = made.signals(vector(NOMINAL)[None])[0]
    return made.with_record(clean + SIGMA[:3] * rng.standard_normal(clean.shape))


def seen(name: str, sigma: np.ndarray | None, **own: Any) -> Posterior:
    """See `small_problems.posterior`."""
    return posterior(response(name).experiment, sigma, response=response(name), **own)
