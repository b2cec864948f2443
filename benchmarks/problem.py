"""The problem that all peers solve: the bundled record, and where their chains begin."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import scipy.integrate
from numpy.typing import NDArray

from bayesdrill.basics.progress import Silent
from bayesdrill.config import job
from bayesdrill.config.job import Job
from bayesdrill.inference import laplace
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.tasks import find_map
from benchmarks import modal

Array = NDArray[np.float64]

CONFIG = Path(__file__).parents[1] / "configs" / "nominal_step.yaml"
CHAINS = 4
PROCESSES = 2
START_SPREAD = 1.5  # chains start wider than the Gaussian approximation, so that R-hat can tell
VOLT = 8.0


def load() -> Job:
    return job.prepare(CONFIG)


def mode(job: Job) -> Array:
    """The MAP, `(D,)`: its search is part of no peer's time."""
    return job.problem.posterior.space.vector(find_map.find_mode(job, 1, Silent()).values)


def starts(job: Job, centre: Array, n: int, seed: int) -> Array:
    """`(n, D)` physical points around the MAP `centre`, on its ridge."""
    straight: Any = modal.of(job)
    posterior = dataclasses.replace(job.problem.posterior, coordinates=straight)
    rng = np.random.default_rng(seed)
    z = posterior.coordinates.from_physical(centre[None])[0]
    # The covariance in logs of the parameters, and by complex steps d coordinate / d log parameter.
    turned = centre * np.exp(1e-20j * np.eye(len(centre)))
    slopes = straight.from_physical(turned).imag.T / 1e-20
    root = slopes @ laplace.matrix_root(laplace.covariance(job.problem.posterior, centre))
    steps = START_SPREAD * root
    kept = np.empty((0, len(centre)))
    while len(kept) < n:
        around = z + rng.standard_normal((n, len(centre))) @ steps.T
        kept = np.concatenate([kept, around[np.isfinite(posterior(around))]])
    return posterior.coordinates.to_physical(kept[:n])


def by_solve_ivp(job: Job, theta: Array, method: str, **tolerances: float) -> Array:
    """The channels `(T, 4)` as one would first write them."""
    p = dict(zip(job.problem.names, theta, strict=True))
    rig, t = MotorShaft(), job.problem.experiment.t
    linear = rig.linear(p)
    a = np.zeros((5, 5))
    for (row, column), value in linear.A.items():
        a[rig.states.index(row), rig.states.index(column)] = value
    push = np.array([0, 0, 0, linear.c["w_2"], VOLT * linear.B["i", "v"]])
    solved = scipy.integrate.solve_ivp(
        lambda _, x: a @ x + push,
        (t[0], t[-1]),
        np.zeros(5),
        method=method,
        t_eval=t,
        **tolerances,
    )
    return solved.y[:4].T
