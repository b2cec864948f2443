"""Posteriors of records of the nominal rig that a drawn torque has moved."""

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray
from support.scipy_oracles import NOMINAL
from support.small_problems import vector

import bayesdrill as bd
from bayesdrill.inference.posterior import Posterior

Array = NDArray[np.float64]

BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
SIZE, TIME = 0.1, 0.3  # N m, s


def posterior_with_torque(
    t: Array,
    v: float | Array,
    sigmas: Mapping[str, float],
    rng: np.random.Generator,
    *,
    unknown_sigmas: tuple[str, ...] = (),
    at: str = "rotor_1",
    smoothness: str = "3/2",
) -> tuple[Posterior, Array, Array]:
    """Return a posterior of all parameters, its true unknowns `(D,)`, and the torque in N m `(T,)`.

    `unknown_sigmas` are those of `sigmas` that are unknown; size and time of the torque are, too.
    """
    wide = {
        name: {"prior": "log_uniform", "low": x / 50, "high": 50 * x, "start": x}
        for name, x in {"size": SIZE, "time": TIME, **sigmas}.items()
    }
    case = bd.case(
        t,
        {
            name: bd.Channel(
                np.sin(t),
                "rad" if name.startswith("theta") else "rad/s",
                wide[name] if name in unknown_sigmas else sigma,
            )
            for name, sigma in sigmas.items()
        },
        {"v": bd.Input(np.broadcast_to(v, t.shape), "V")},
        dict.fromkeys(NOMINAL, BOX),
        nominal="tables_2_3",
        missing_torque={
            "at": at, "smoothness": smoothness, "size": wide["size"], "time": wide["time"]
        },
    )  # fmt: skip
    posterior = case.job.problem.posterior
    theta = posterior.space.vector(posterior.space.start)
    kalman_filter = posterior.likelihood.observations[0].torque.kalman_filter
    row = np.append(vector(NOMINAL), [SIZE, TIME])[None]
    states, signals = kalman_filter.draw(row, np.array([[*sigmas.values()]]), rng)
    record = posterior.likelihood.signals(theta[None])[0] + signals[0]
    torque = SIZE * states[0, :, kalman_filter.augmented.states.index("torque")]
    return posterior.edit(records=[record]), theta, torque


@cache
def step_with_torque() -> tuple[Posterior, Array]:
    """Return that of a step in four channels, the sigma of the last unknown; and the truth."""
    sigmas = {"theta_1": 0.1, "theta_2": 0.1, "w_1": 0.2, "w_2": 0.2}
    t, rng = 0.03 * np.arange(151), np.random.default_rng(8)
    return posterior_with_torque(t, 8.0, sigmas, rng, unknown_sigmas=("w_2",))[:2]
