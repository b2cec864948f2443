"""bayesdrill itself: its main job on the bundled config, judged from the tree that it leaves."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import xarray

from bayesdrill.basics.progress import Silent
from bayesdrill.tasks import pipeline
from benchmarks import problem, verdict
from benchmarks.verdict import Result


def run(job: problem.Job) -> Result:
    """Time is that of all sampling: learning, checks, and compiling (0.2 s) as well."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "run"
        outcome = pipeline.run_posterior(job, output, "fresh", problem.PROCESSES, Silent())
        with xarray.open_datatree(output / "posterior.nc") as tree:
            columns = [np.asarray(tree["posterior"][name]) for name in job.problem.names]
    found = verdict.judge(np.stack(columns, axis=-1))
    convergence = outcome.sampled.convergence
    return verdict.with_tau(
        verdict.result(
            "bayesdrill",
            "learnt",
            found,
            seconds=outcome.seconds["sampling"],
            work=float(
                convergence.steps * job.config.sampler.ensembles * job.config.sampler.walkers
            ),
            note=f"{convergence.steps} steps of every ensemble",
        ),
        float(convergence.tau.max()),
        converged=convergence.converged,
    )
