"""Find delays of inputs or channels that can hardly be distinguished from a time constant of the rig."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayesdrill.analysis.plausibility import poles
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.findings import Finding
from bayesdrill.inference.laplace import information_root
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior

MIN_CORRELATION = 0.9  # correlation of a delay and a time constant, above which the pair is named
STEP = 1e-6  # step of an unknown on its natural scale, for derivatives of time constants


def delays_and_time_constants(posterior: Posterior, theta: Array) -> Iterator[Finding]:
    """Yield each delay that is strongly correlated with a time constant at the MAP `theta (D,)`."""
    names = posterior.space.free
    observations = posterior.likelihood.observations
    wanted = [(each, [name for name in _delays(each) if name in names]) for each in observations]
    if not any(delays for _, delays in wanted):
        return
    half = np.linalg.inv(information_root(posterior, theta))
    steps = posterior.coordinates.natural(theta[None])[0]
    named = set[str]()
    for observation, delays in wanted:
        constants = _time_constants(observation, posterior, theta, STEP * np.diag(steps))
        for name in delays:
            at = names.index(name)
            sd = float(np.linalg.norm(half[at]))
            best, size = 0.0, (np.nan, np.nan)
            for tau, slopes in constants:
                spread = slopes @ half
                width = float(np.linalg.norm(spread))
                rho = float(half[at] @ spread) / (sd * width) if width > 0 else 0.0
                if abs(rho) > abs(best):
                    best, size = rho, (tau, width)
            if abs(best) > MIN_CORRELATION and name not in named:
                named.add(name)
                numbers = {"correlation": best, "delay": 1e3 * theta[at], "tau": 1e3 * size[0]}
                numbers |= {"delay_sd": 1e3 * sd * steps[at], "tau_sd": 1e3 * size[0] * size[1]}
                yield Finding("delay and time constant", {"delay_name": name}, numbers)


def _delays(observation: Observation) -> Iterator[str]:
    """Yield the names that the delays of an experiment have in the parameter space."""
    sensing = observation.response.sensing
    called = observation.named(observation.response.parameters)
    every = (sensing.delay, *sensing.input_lags.values(), *sensing.lags.values())
    yield from (called[name] for name in every if name is not None)


def _time_constants(
    observation: Observation, posterior: Posterior, theta: Array, moves: Array
) -> list[tuple[float, Array]]:
    """Return time constants [s] and derivatives `(D,)` of their logs, by differences `moves (D, D)`."""
    full = posterior.space.full(np.vstack([theta, theta + moves]))
    every = poles(observation.response.model, observation.rig_parameters(full))
    constants = []
    for pole in every[0]:
        if pole.real < 0 and abs(pole.imag) < 1e-9 * abs(pole):
            moved = [row[np.argmin(np.abs(row - pole))].real for row in every[1:]]
            constants.append((-1 / pole.real, -(np.array(moved) / pole.real - 1) / STEP))
    return constants
