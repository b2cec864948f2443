"""What a missing torque costs, beside the same rig without it in the same run.

`python -m benchmarks.torque` prints microseconds for one evaluation of 1001 samples of four channels in
a batch of 64, one core, and the most by which it differs from the filter that takes every sample.
"""

from __future__ import annotations

import numpy as np

from bayesdrill.rig.models.latent_torque import MissingTorque, Smoothness, TorqueLocation
from bayesdrill.rig.simulators.kalman import KalmanFilter
from bayesdrill.rig.simulators.linear import Response
from benchmarks import problem
from benchmarks.likelihood import BATCH, best_of

REPEATS = 200
CASES: tuple[tuple[TorqueLocation, Smoothness], ...] = (
    ("motor", "1/2"),
    ("motor", "3/2"),
    ("rotor_1", "1/2"),
    ("rotor_1", "3/2"),
)


def main() -> None:
    job = problem.load()
    posterior = job.problem.posterior
    nominal = posterior.space.vector(job.problem.nominal)
    rng = np.random.default_rng(1)
    theta = nominal * rng.uniform(0.9, 1.1, (BATCH, len(nominal)))
    plain = best_of(lambda: posterior.likelihood(theta), REPEATS) / BATCH
    print(f"without: {1e6 * plain:.2f} us")
    response = posterior.likelihood.only_observation.response
    assert isinstance(response, Response)
    sigmas = np.full((BATCH, len(response.experiment.channels)), 0.1)
    size = rng.uniform(0.01, 0.1, BATCH)
    rows = np.column_stack([theta, size, rng.uniform(0.1, 1.0, BATCH)])
    left = response.experiment.y - response.signals(theta)
    for at, smoothness in CASES:
        of = KalmanFilter(
            response.model, MissingTorque(at=at, smoothness=smoothness), response.experiment
        )
        white, variances = of.whiten(rows, sigmas, left)
        each = -0.5 * (np.log(2 * np.pi * variances) + white**2)
        off = np.abs(
            of.log_density(rows, sigmas, response.record).sum(axis=1) - each.sum(axis=(1, 2))
        )
        spent = (
            best_of(lambda of=of: of.log_density(rows, sigmas, response.record), REPEATS) / BATCH
        )
        print(
            f"{at}, {smoothness}: {1e6 * spent:.2f} us, {spent / plain:.1f} times as much; "
            f"differs by {off.max():.0e} of {np.abs(each.sum(axis=(1, 2))).max():.0f}"
        )


if __name__ == "__main__":
    main()
