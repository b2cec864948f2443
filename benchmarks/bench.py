"""Time the likelihood and the sampler beside the alternatives, all in this one run.

`make bench`: prints a table; ratios are of figures measured here, side by side.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy.integrate

from bayesdrill import crew, pipeline, symbols
from bayesdrill.models.motor_shaft import MotorShaft
from bayesdrill.pipeline import Job, Outcome
from bayesdrill.progress import Silent

CONFIG = Path(__file__).parents[1] / "configs" / "nominal_step.yaml"
BATCH = 64
DEFAULT_MOVE_STEPS = 20_000


def best_of(work: Callable[[], object], repeats: int = 30) -> float:
    """Shortest of several times, in seconds."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return min(times)


def by_solve_ivp(job: Job, theta: np.ndarray, method: str) -> np.ndarray:
    """The channels `(T, 4)` as one would first write them, default tolerances."""
    p = dict(zip(job.problem.names, theta, strict=True))
    rig, t = MotorShaft(), job.problem.experiment.t
    linear = rig.linear(p)
    a = np.zeros((5, 5))
    for (row, column), value in linear.A.items():
        a[rig.states.index(row), rig.states.index(column)] = value
    push = np.array([0, 0, 0, linear.c["w_2"], 8.0 * linear.B["i", "v"]])
    solved = scipy.integrate.solve_ivp(
        lambda _, x: a @ x + push, (t[0], t[-1]), np.zeros(5), method=method, t_eval=t
    )
    return solved.y[:4].T


def likelihood(job: Job) -> None:
    """One evaluation of 1001 samples x 4 channels, matrix exponential included."""
    target = job.problem.posterior
    nominal = target.space.vector(job.problem.nominal)
    theta = nominal * np.random.default_rng(1).uniform(0.9, 1.1, (BATCH, len(nominal)))
    z = target.coordinates.from_physical(theta)
    exact = target.likelihood.signals(theta[:1])[0]
    ours = best_of(lambda: target.likelihood(theta)) / BATCH
    whole = best_of(lambda: target(z)) / BATCH
    t, k = target.likelihood.response.experiment.y.shape
    print(
        f"\nlikelihood of {t} samples x {k} channels, one core, per evaluation in a batch of {BATCH}"
    )
    print(f"  bayesdrill, likelihood                {1e6 * ours:10.1f} us")
    print(f"  bayesdrill, posterior over z          {1e6 * whole:10.1f} us")
    for method in ("RK45", "LSODA", "Radau"):
        seconds = best_of(lambda m=method: by_solve_ivp(job, theta[0], m), 5)
        error = np.abs(by_solve_ivp(job, theta[0], method) - exact).max()
        print(
            f"  solve_ivp {method:6s} (error {error:.0e})      {1e6 * seconds:10.1f} us"
            f"   {seconds / ours:8.0f} x"
        )


def sampler(job: Job) -> None:
    """Effective draws per second of sampling on the bundled record."""
    print(f"\nsampling the bundled record, nine unknowns, {crew.available()} processes")
    sampling = job.config.sampler
    changes = {"moves": {"stretch": 1.0}, "max_steps": DEFAULT_MOVE_STEPS, "n_tau": 1e6}
    naive = job.config.model_copy(
        update={"coordinates": "physical", "sampler": sampling.model_copy(update=changes)}
    )
    ours = run(job)
    theirs = run(pipeline.assemble(naive, job.source))
    rates = [
        report("bayesdrill", ours),
        report("emcee's default move, physical coordinates", theirs),
    ]
    print(f"  ratio of effective draws per second: {rates[0] / rates[1]:.0f}")


def run(job: Job) -> Outcome:
    with tempfile.TemporaryDirectory() as folder:
        return pipeline.posterior(job, Path(folder) / "run", "fresh", crew.available(), Silent())


def report(name: str, outcome: Outcome) -> float:
    c, seconds = outcome.sampled.convergence, outcome.seconds["sampling"]
    rate = float(c.ess_bulk.min()) / seconds
    good = c.r_hat.max() <= 1.01 and c.n_tau >= 50
    verdict = "converged" if good else "NOT CONVERGED: its figure flatters it"
    print(
        f"  {name:44s} {rate:8.0f} effective draws/s  ({seconds:.1f} s, tau {c.tau.max():.0f} steps, "
        f"R-hat {c.r_hat.max():.3f}, {verdict})"
    )
    return rate


def main() -> None:
    print(f"{os.cpu_count()} processors; {symbols.DEFAULT_NOMINAL}; {CONFIG.name}")
    job = pipeline.prepare(CONFIG)
    likelihood(job)
    sampler(job)


if __name__ == "__main__":
    main()
