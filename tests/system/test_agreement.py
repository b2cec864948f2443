"""The bundled posterior against a long run in other coordinates: about five minutes on two cores."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from arviz_stats.base import array_stats

from bayesdrill import laplace, pipeline, seeds
from bayesdrill.convergence import autocorrelation_time, thinned
from bayesdrill.coordinates import Log
from bayesdrill.posterior import Posterior
from bayesdrill.progress import Silent
from bayesdrill.samplers.ensemble import State, advance

CONFIG = Path(__file__).parents[2] / "configs" / "nominal_step.yaml"
WALKERS = 512
STEPS, BURN_IN, EVERY = 90_000, 15_000, 50
MOVES = {"differential_evolution": 1.0}  # not the package's mixture either


def long_run(posterior: Posterior, start: np.ndarray, ensemble: int) -> np.ndarray:
    """`(kept, W, D)` physical draws, walking in plain logs."""
    z = laplace.draws(posterior, start, WALKERS, seeds.stream(77, "start", ensemble))
    state = State(z, posterior(z), seeds.legacy_state(77, "walk", ensemble))
    kept = []
    for step in range(0, STEPS, 1000):
        piece = advance(posterior.evaluate, state, 1000, MOVES)
        state = piece.state
        if step >= BURN_IN:
            kept.append(np.exp(piece.z[EVERY - 1 :: EVERY]))
    return np.concatenate(kept)


@pytest.mark.slow
def test_agrees_with_a_long_run_in_logs(tmp_path: Path) -> None:
    """Every mean within 4 MCSE, every sd within 5 %, every quartile within 4 MCSE."""
    job = pipeline.prepare(CONFIG)
    ours = pipeline.posterior(job, tmp_path / "run", "fresh", 2, Silent())
    c = ours.sampled.convergence
    assert c.converged
    draws = thinned(ours.sampled.theta, c.burn_in, c.thin)
    in_logs = dataclasses.replace(job.problem.posterior, coordinates=Log())
    start = in_logs.space.vector(job.problem.nominal)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        chains = list(pool.map(long_run, [in_logs] * 2, [start] * 2, range(2)))
    theirs = np.array(chains)
    tau = autocorrelation_time(theirs)
    print("long run: tau", np.round(tau * EVERY), "steps, ", theirs.shape[1] / tau.max(), "of them")
    assert theirs.shape[1] / tau.max() > 20
    for d, name in enumerate(job.problem.names):
        one, two = draws[..., d], theirs[..., d]
        ess = two.size / tau[d]
        for method, exact in (("mean", np.mean), ("quantile25", None), ("quantile75", None)):
            prob = None if exact else int(method[-2:]) / 100
            error = float(
                array_stats.mcse(one, 0, 1, method=method.rstrip("0123456789"), prob=prob)
            )
            a, b = (np.mean(x) if exact else np.quantile(x, prob) for x in (one, two))
            other = error * np.sqrt(float(c.ess_bulk[d]) / ess)
            assert abs(a - b) <= 4 * np.hypot(error, other), (name, method)
        ratio = one.std() / two.std()
        print(
            f"{name}: sd ratio {ratio:.4f}, mean off by {(one.mean() - two.mean()) / one.std():.4f} sd"
        )
        assert ratio == pytest.approx(1.0, abs=0.05), name
