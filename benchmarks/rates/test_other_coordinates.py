"""The bundled posterior against a long run in other coordinates: about a minute on two cores."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from arviz_stats.base import array_stats

from bayesdrill.basics import seeds
from bayesdrill.basics.progress import Silent
from bayesdrill.config.job import prepare
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling.convergence import autocorrelation_time
from bayesdrill.sampling.samplers.ensemble import State, advance
from bayesdrill.tasks import pipeline
from benchmarks.rates.records import points_near

CONFIG = Path(__file__).parents[2] / "configs" / "nominal_step.yaml"
WALKERS = 128
STEPS, BURN_IN, EVERY = 30_000, 3_000, 10
MOVES = {"differential_evolution": 1.0}  # no learnt proposal, no stretch


@dataclasses.dataclass(frozen=True)
class ByRatios:
    """Written for this test alone: friction as ratios u6 = rho t_f/v and u7 = rho c_m/k_e.

    With rho = r_m/k_T and d = c_m + k_e/rho: logs of v (1 - u6)/(k_e (1 + u7)), k_s/j_1,
    i_m^2 k_s/d, j_m/d, l_m/r_m, u6, u7, j_1 and r_m; |d coordinates / d logs| = 1.
    """

    v: float = 8.0
    i_m: float = 1 / 8

    between: ClassVar[tuple[tuple[int, float, float], ...]] = ()
    signed: ClassVar[tuple[tuple[int, float], ...]] = ()

    def from_physical(self, theta: np.ndarray) -> np.ndarray:
        j_m, c_m, k_e, k_t, r_m, l_m, k_s, j_1, t_f = theta.T
        rho = r_m / k_t
        u6, u7, d = rho * t_f / self.v, rho * c_m / k_e, c_m + k_e / rho
        speed = self.v * (1 - u6) / (k_e * (1 + u7))
        shaft = self.i_m**2 * k_s / d
        return np.log(
            np.stack([speed, k_s / j_1, shaft, j_m / d, l_m / r_m, u6, u7, j_1, r_m], axis=-1)
        )

    def to_physical(self, z: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            speed, rotor, shaft, inertia, electrical, u6, u7, j_1, r_m = np.exp(z).T
            k_e = self.v * (1 - u6) / (speed * (1 + u7))  # negative beyond u6 = 1: no prior there
            k_s = rotor * j_1
            d = self.i_m**2 * k_s / shaft
            rho = k_e * (1 + u7) / d
            columns = [
                inertia * d, u7 * k_e / rho, k_e, r_m / rho, r_m,
                electrical * r_m, k_s, j_1, u6 * self.v / rho,
            ]  # fmt: skip
        return np.stack(columns, axis=-1)

    def with_jacobian(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        theta = self.to_physical(z)
        with np.errstate(all="ignore"):
            return theta, np.log(theta).sum(axis=-1)


def long_run(posterior: Posterior, start: np.ndarray, ensemble: int) -> np.ndarray:
    """`(kept, W, D)` physical draws."""
    z = points_near(posterior, start, WALKERS, seeds.stream(77, "start", ensemble))
    state = State(z, posterior(z), seeds.legacy_state(77, "walk", ensemble))
    kept = []
    for step in range(0, STEPS, 1000):
        piece = advance(posterior.evaluate, state, 1000, MOVES)
        state = piece.state
        if step >= BURN_IN:
            some = piece.z[EVERY - 1 :: EVERY]
            physical = posterior.coordinates.to_physical(some.reshape(-1, some.shape[-1]))
            kept.append(physical.reshape(some.shape))
    return np.concatenate(kept)


@pytest.mark.slow
def test_agrees_with_a_long_run_in_other_coordinates(tmp_path: Path) -> None:
    """Every mean and quartile within 4 MCSE, every sd within 5 %."""
    job = prepare(CONFIG)
    ours = pipeline.run_posterior(job, tmp_path / "run", "fresh", 2, Silent())
    c = ours.sampled.convergence
    assert c.converged
    draws = ours.sampled.draws
    other = dataclasses.replace(job.problem.posterior, coordinates=ByRatios())
    start = other.space.vector(job.problem.nominal)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        theirs = np.array(list(pool.map(long_run, [other] * 2, [start] * 2, range(2))))
    tau = autocorrelation_time(theirs)
    n_tau = theirs.shape[1] / tau.max()
    print(
        f"long run: {n_tau:.0f} autocorrelation times, {theirs[..., 0].size / tau.max():.0f} draws"
    )
    assert n_tau > 200
    for d, name in enumerate(job.problem.names):
        one, two = draws[..., d], theirs[..., d]
        share = float(np.sqrt(c.ess_bulk[d] * tau[d] / two.size))  # of the errors of both runs
        mean_error = float(array_stats.mcse(one, 0, 1, method="mean")) * np.hypot(1, share)
        off = (one.mean() - two.mean()) / mean_error
        assert abs(off) <= 4, name
        for prob in (0.25, 0.75):
            error = float(array_stats.mcse(one, 0, 1, method="quantile", prob=prob))
            gap = np.quantile(one, prob) - np.quantile(two, prob)
            assert abs(gap) <= 4 * error * np.hypot(1, share), (name, prob)
        ratio = one.std() / two.std()
        print(f"{name}: mean off by {off:+.2f} MCSE, sd ratio {ratio:.4f}")
        assert ratio == pytest.approx(1.0, abs=0.05), name
