"""How time and memory grow: with samples, unknowns, channels, walkers, ensembles and processes.

`make bench-growth`; the table and the figure go into `docs/`.
"""

from __future__ import annotations

import copy
import dataclasses
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bayesdrill.basics.progress import Silent
from bayesdrill.config import loading
from bayesdrill.config.assembly.problem import build_problem
from bayesdrill.inference import compression
from bayesdrill.inference.posterior import Problem
from bayesdrill.report import scales, style
from bayesdrill.tasks import pipeline
from benchmarks import problem, tables
from benchmarks.likelihood import best_of

SAMPLES = (1_000, 10_000, 100_000, 1_000_000)
UNKNOWNS = tuple(range(1, 10))
CHANNELS = tuple(range(1, 6))
BATCHES = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512)
RUNS = ((4, 1), (4, 2), (8, 2), (16, 2))  # ensembles, processes
MEMORY = ((1_000, 64), (100_000, 64), (100_000, 512), (100_000, 4096), (1_000_000, 64))
BATCH = 64
MIB = 1024.0

Points = Mapping[int, float]


def variant(
    job: problem.Job, *, samples: int = 1001, unknowns: int = 9, channels: int = 4
) -> Problem:
    """The bundled problem with another size; the record is simulated anew at nominal values."""
    original, data = job.problem.experiment, copy.deepcopy(job.source.data)
    data["parameters"] |= dict.fromkeys(job.problem.names[unknowns:], "nominal")
    specs = data["record"]["channels"]
    specs["i"] = {**specs["w_2"], "unit": "A", "column": "i"}
    data["record"]["channels"] = dict(list(specs.items())[:channels])
    case = loading.validate(dataclasses.replace(job.source, data=data))
    entries = [entry.channel for entry in case.experiments[0].channels]
    t = np.linspace(original.t[0], original.t[-1], samples)
    empty = dataclasses.replace(
        original, t=t, y=np.zeros((samples, channels)), channels=tuple(entries)
    )
    quiet = build_problem(case, [empty]).posterior
    truth = quiet.space.vector({name: job.problem.nominal[name] for name in quiet.space.free})
    y = quiet.likelihood.signals(truth[None])[0]
    y = y + 0.1 * np.random.default_rng(2).standard_normal(y.shape)
    return build_problem(case, [dataclasses.replace(empty, y=y)])


def cost(made: Problem, batch: int = BATCH) -> float:
    """Seconds of one evaluation of the posterior in a batch."""
    space = made.posterior.space
    nominal = space.vector({name: made.nominal[name] for name in space.free})
    theta = nominal * np.random.default_rng(1).uniform(0.95, 1.05, (batch, len(nominal)))
    large = len(made.experiment.t) * batch > 1_000_000
    return best_of(lambda: made.posterior.density(theta), 3 if large else 30) / batch


@dataclass(frozen=True)
class CompressedCost:
    """Of a compressed record: seconds of an evaluation and of one with all slopes, in a batch; seconds
    to compress it; `error`: the most by which log likelihoods of a batch differ from the exact ones."""

    functions: int
    value: float
    slopes: float
    build: float
    error: float


def compressed_cost(job: problem.Job, samples: int) -> CompressedCost:
    """Where the record itself has them: at rigs that it cannot tell from the nominal one."""
    made = variant(job, samples=samples)
    posterior, space = made.posterior, made.posterior.space
    nominal = space.vector({name: made.nominal[name] for name in space.free})[None]
    first = compression.excerpt(posterior) or posterior
    begun = time.perf_counter()
    points = compression.points_about(first, nominal)
    short = compression.compressed(posterior, compression.compressions(posterior, points, 0))
    points = compression.points_about(short, nominal)
    known = compression.compressions(posterior, points, 0)
    build = time.perf_counter() - begun
    compressed = compression.compressed(posterior, known)
    theta = points[2::3][:BATCH]  # those within a standard deviation or so
    observation = compressed.likelihood.observations[0]
    rigs = observation.simulator_parameters(space.full(theta))
    along = np.repeat(np.eye(rigs.shape[1])[None], BATCH, axis=0)
    weights = np.full((BATCH, len(observation.experiment.channels), 1), 100.0)
    normal = best_of(lambda: observation.response.normal(rigs, along, weights), 30)
    check = compression.check_draws(compressed, theta)
    assert check is not None
    return CompressedCost(
        functions=check.functions,
        value=best_of(lambda: compressed.density(theta), 30) / BATCH,
        slopes=normal / BATCH,
        build=build,
        error=check.difference,
    )


def costs(job: problem.Job) -> dict[str, Points]:
    usual = variant(job)
    return {
        "samples": {n: cost(variant(job, samples=n)) for n in SAMPLES},
        "unknowns": {n: cost(variant(job, unknowns=n)) for n in UNKNOWNS},
        "channels": {n: cost(variant(job, channels=n)) for n in CHANNELS},
        "batch": {n: cost(usual, n) for n in BATCHES},
    }


def sampling(job: problem.Job, ensembles: int, processes: int) -> tuple[float, int]:
    """Seconds of sampling until converged, and the steps of every ensemble."""
    sampler = job.config.sampler.model_copy(update={"ensembles": ensembles})
    job = job.with_settings(sampler=sampler)
    with tempfile.TemporaryDirectory() as folder:
        outcome = pipeline.run_posterior(job, Path(folder) / "run", "fresh", processes, Silent())
    return outcome.seconds["sampling"], outcome.sampled.convergence.steps


def peak_memory(samples: int, walkers: int) -> tuple[float, float]:
    """MiB before and at the peak of an evaluation of all walkers, in a fresh process."""
    command = [sys.executable, "-m", "benchmarks.growth", str(samples), str(walkers)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    before, peak = json.loads(done.stdout)
    return before, peak


def report_memory(samples: int, walkers: int) -> None:
    """Run by `peak_memory`; a first evaluation of few walkers is part of `before`."""
    made = variant(problem.load(), samples=samples)
    theta = made.posterior.space.vector(made.nominal) * np.ones((walkers, 1))
    made.posterior.density(theta[:8])
    before = _peak()
    made.posterior.density(theta)
    print(json.dumps([before, _peak()]))


def _peak() -> float:
    """MiB.  Linux hands `ru_maxrss` down from parent to child, so that the kernel's own mark of
    this process is read where there is one."""
    status = Path("/proc/self/status")
    if status.exists():
        (line,) = (row for row in status.read_text().splitlines() if row.startswith("VmHWM"))
        return float(line.split()[1]) / MIB
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / MIB / (MIB if sys.platform == "darwin" else 1.0)


def markdown(
    every: Mapping[str, Points],
    runs: Mapping[tuple[int, int], tuple[float, int]],
    memory: Mapping[tuple[int, int], tuple[float, float]],
    compressed: Mapping[int, CompressedCost],
) -> list[str]:
    lines = [tables.where(), ""]
    titles = {
        "samples": "samples",
        "unknowns": "unknowns",
        "channels": "channels",
        "batch": "batch",
    }
    for name, title in titles.items():
        points = every[name]
        lines += [
            tables.row((title, *map(str, points))),
            tables.row(("---", *["---:"] * len(points))),
            tables.row(("us per evaluation", *(f"{1e6 * x:.3g}" for x in points.values()))),
            "",
        ]
    lines += [
        "| samples, compressed | functions | us per evaluation | us with all slopes | s to compress | "
        "largest difference of log L from the exact simulator |",
        "| ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for samples, cost_ in compressed.items():
        numbers = f"{1e6 * cost_.value:.1f} | {1e6 * cost_.slopes:.0f} | {cost_.build:.1f}"
        lines.append(f"| {samples} | {cost_.functions} | {numbers} | {cost_.error:.0e} |")
    lines += [
        "",
        "| ensembles | processes | seconds of sampling | steps |",
        "| ---: | ---: | ---: | ---: |",
    ]
    lines += [f"| {e} | {p} | {s:.1f} | {n} |" for (e, p), (s, n) in runs.items()]
    lines += [
        "",
        "| samples | walkers | peak memory [MiB] | of it for walkers | a response each would be |",
        "| ---: | ---: | ---: | ---: | ---: |",
    ]
    for (samples, walkers), (before, peak) in memory.items():
        copies = samples * walkers * 4 * 8 / MIB**2
        lines.append(f"| {samples} | {walkers} | {peak:.0f} | {peak - before:.1f} | {copies:.0f} |")
    return lines


def figure(
    every: Mapping[str, Points], compressed: Mapping[int, CompressedCost], folder: Path
) -> None:
    """Cost of one evaluation against each size."""
    labels = {
        "samples": "samples",
        "unknowns": "unknowns",
        "channels": "channels",
        "batch": "walkers in a batch",
    }
    with style.styled():
        made = Figure(figsize=(scales.DOUBLE, 1.9))
        panels = made.subplots(1, 4)
        made.subplots_adjust(left=0.075, right=0.99, bottom=0.24, top=0.95, wspace=0.35)
        for panel, (name, label) in zip(panels, labels.items(), strict=True):
            x, y = list(every[name]), [1e6 * s for s in every[name].values()]
            panel.plot(x, y, color=style.BLACK, marker="o", markersize=3)
            if name == "samples":
                flat = [1e6 * cost_.value for cost_ in compressed.values()]
                panel.plot(
                    [*compressed], flat, color=style.BLACK, marker="s", markersize=3, ls="--"
                )
            panel.set_xlabel(label)
            if name in ("samples", "batch"):
                panel.set_xscale("log")
                panel.set_yscale("log")
            else:
                panel.set_ylim(0, 1.25 * max(y))
                panel.set_xticks(x[:: 2 if len(x) > 5 else 1])
        panels[0].set_ylabel(r"one evaluation [$\mathrm{\mu s}$]")
        style.save(made, folder, "growth", {"Title": "Cost of one evaluation"})


def main(job: problem.Job, *, dry: bool = False) -> None:
    print("growth: cost of one evaluation", flush=True)
    every = costs(job)
    compressed = {n: compressed_cost(job, n) for n in SAMPLES}
    if not dry:
        figure(every, compressed, tables.FIGURES)
    runs = {}
    for ensembles, processes in RUNS:
        print(f"growth: sampling, {ensembles} ensembles, {processes} processes", flush=True)
        runs[ensembles, processes] = sampling(job, ensembles, processes)
    memory = {size: peak_memory(*size) for size in MEMORY}
    lines = markdown(every, runs, memory, compressed)
    print(*lines, sep="\n", flush=True)
    if not dry:
        tables.insert(tables.PAGE, "growth", lines)


if __name__ == "__main__":
    if len(sys.argv) == 3:
        report_memory(*map(int, sys.argv[1:]))
    else:
        main(problem.load())
