"""What one evaluation of the likelihood costs, beside SciPy's integrators."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from bayesdrill.rig.kernels.exponential import present
from bayesdrill.rig.simulators.long_record import input_layout
from benchmarks import floor, problem

BATCH = 64


def best_of(work: Callable[[], object], repeats: int = 30) -> float:
    """Shortest of several times, in seconds."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return min(times)


def table(job: problem.Job) -> list[str]:
    """Markdown: one evaluation, matrix exponential included, one core."""
    target = job.problem.posterior
    nominal = target.space.vector(job.problem.nominal)
    theta = nominal * np.random.default_rng(1).uniform(0.9, 1.1, (BATCH, len(nominal)))
    z = target.coordinates.from_physical(theta)
    exact = target.likelihood.signals(theta[:1])[0]
    ours = best_of(lambda: target.likelihood(theta)) / BATCH
    walked = best_of(lambda: target(z)) / BATCH
    single = best_of(lambda: target.density(theta[:1]))
    response = target.likelihood.only_observation.response
    full = target.space.full(theta)
    own, record = input_layout(response.model, response.experiment), response.experiment
    numbers = [*full[0], *(record.constant[name] for name in present(record.constant))]
    weights = record.weights(response.model.states)
    lowest = floor.seconds_per_evaluation(own, weights, record.dt, len(record.t), np.array(numbers))
    rows = [
        ("arithmetic floor, see below", lowest, 0.0),
        (f"likelihood, batch of {BATCH}", ours, 0.0),
        (f"posterior over the walkers' coordinates, batch of {BATCH}", walked, 0.0),
        ("posterior over physical parameters, one at a time", single, 0.0),
    ]
    for method, tolerances in (
        ("RK45", {}),
        ("RK45", {"rtol": 1e-5}),
        ("LSODA", {}),
        ("Radau", {}),
    ):
        solve = lambda m=method, t=tolerances: problem.by_solve_ivp(job, theta[0], m, **t)  # noqa: E731
        shown = f"`solve_ivp`, {method}, rtol {tolerances.get('rtol', 1e-3):.0e}"
        rows.append((shown, best_of(solve, 5), float(np.abs(solve() - exact).max())))
    lines = [
        "| evaluation | us | ratio | largest error [rad, rad/s] |",
        "| --- | ---: | ---: | ---: |",
    ]
    for name, seconds, error in rows:
        shown = f"{error:.0e}" if error else "rounding"
        lines.append(f"| {name} | {1e6 * seconds:.1f} | {seconds / ours:.1f} | {shown} |")
    return lines
