"""How often `compare` names what is wrong: a hundred records of each of four kinds, the truth known.

`python -m benchmarks.compare [RECORDS [KIND ...]]` makes each record of another rig, drawn from the
priors, and prints how often the verdict is right, and how large what is wrong was over the noise.
The rig that made a record is among its contenders, beside the config as given and the same with
noise that remembers; of a coloured sensor there is one with other physics.  Each is sampled as a
run is.  40 minutes of one core.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bayesdrill as bd
from bayesdrill.analysis.comparison import ModelDecision, RunSummary, decide
from bayesdrill.config.job import Job
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.sampling.fit import FitPlan, fit
from bayesdrill.sampling.gauss_newton import gauss_newton
from bayesdrill.tasks import comparison, find_map
from bayesdrill.tasks.conclusions import SampledRun

Array = NDArray[np.float64]

RECORDS, SEED = 100, 19
T = 0.04 * np.arange(200)  # s
SPEEDS = ("w_1", "w_2")
HOLD, VOLTS = 10, 8.0  # samples, V: the supply is drawn anew, one way or the other
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
SIGMA = {"prior": "log_uniform", "low": 1e-3, "high": 10}  # rad/s
RIG = {
    "j_m": BOX,
    "k_e": BOX,
    "k_s": BOX,
    **dict.fromkeys(("c_m", "k_T", "r_m", "l_m", "j_1"), "nominal"),
    "t_f": 0.0,
}
SHORT = {"walkers": 24, "ess": 400, "n_tau": 10, "max_steps": 100}
GIVEN, RED = "as_given", "ar1"
PHYSICS = ("friction", "gear", "lag")
GEAR = 1 / 8  # true where the gear is wrong
SHOWS = (0.3, 3.0)  # rms of what is wrong over that of the noise
MEMORY = (0.5, 0.95)  # correlation of neighbours, of a coloured sensor
LEVELS = (0.03, 0.3)  # rad/s, of its noise


def contenders() -> dict[str, Job]:
    """The config as given, with a wrong gear, and what may be right instead; of no record yet."""
    return {
        GIVEN: _job(),
        RED: _job(noise="ar1"),
        "friction": _job(t_c1={"prior": "uniform", "low": 0.0, "high": 0.1}),
        "gear": _job(gear=GEAR),
        "lag": _job(lag={"prior": "uniform", "low": 0.0, "high": 0.1}),
    }


def _job(
    gear: float = 1 / 7.5, noise: str = "white", lag: Any = None, sigma: Any = SIGMA, **own: Any
) -> Job:
    """`lag`: of the sensor at the gearbox."""
    signs = np.random.default_rng(SEED).choice([-1.0, 1.0], len(T))
    volts = VOLTS * np.repeat(signs, HOLD)[: len(T)]
    channels = {
        name: bd.Channel(np.sin(T), "rad/s", sigma, noise=noise, lag=late)
        for name, late in zip(SPEEDS, (None, lag), strict=True)
    }
    made = bd.case(
        T,
        channels,
        {"v": bd.Input(volts, "V")},
        {**RIG, **own},
        rig=MotorShaft(i_m=gear),
        nominal="tables_2_3",
        map={"starts": 1, "evaluations": 300},
        sampler=SHORT,
    )
    return made.job


@dataclass(frozen=True)
class Kind:
    """What is wrong with its records: `right` is the contender that made them, `sizes` those of the
    unknown that makes it wrong, where there is one.
    """

    name: str
    right: str
    word: str
    unknown: str = ""
    sizes: tuple[float, float] = (0.0, 0.0)

    def rivals(self, index: int) -> list[str]:
        """All that a record is fitted with, the config as given first."""
        rig = PHYSICS[index % len(PHYSICS)] if self.right == RED else self.right
        return [GIVEN, RED, rig]


KINDS = (
    Kind("coloured sensor", RED, "noise"),
    Kind("dry friction", "friction", "model", "t_c1", (0.002, 0.02)),
    Kind("wrong gear", "gear", "model"),
    Kind("lag", "lag", "model", "lag_w_2", (0.001, 0.01)),
)


@dataclass(frozen=True)
class Found:
    """Of one record: what is wrong over the noise (the correlation, of a coloured sensor), what was
    decided, and the log odds of what is right against the best that is not.
    """

    index: int
    size: float
    word: str
    best: str
    ahead: float
    converged: bool
    seconds: float


@dataclass(frozen=True)
class Bench:
    """All contenders, compiled once."""

    jobs: Mapping[str, Job]

    @cached_property
    def known(self) -> Job:
        """As given, of a known noise: for what the rig alone leaves."""
        return _job(sigma=0.1)

    def record(self, kind: Kind, index: int) -> tuple[Array, float]:
        """`(T, K)`, and the size of what is wrong."""
        rng = np.random.default_rng([SEED, KINDS.index(kind), index])
        posterior = self.jobs[kind.right].problem.posterior
        one, space = posterior.likelihood.observations[0], posterior.space
        theta = space.draw(1, rng)
        if kind.unknown:
            theta[:, space.free.index(kind.unknown)] = rng.uniform(*kind.sizes)
        clean = one.signals(space.full(theta))[0]
        if kind.right == RED:
            size = float(rng.uniform(*MEMORY))
            return clean + np.exp(rng.uniform(*np.log(LEVELS))) * _red(size, rng), size
        size = float(np.exp(rng.uniform(*np.log(SHOWS))))
        sigma = self.wrong(clean, theta[0]) / size
        return clean + sigma * rng.standard_normal(clean.shape), size

    def wrong(self, clean: Array, theta: Array) -> float:
        """Root mean square of what the rig as given leaves of signals without noise."""
        posterior = of(self.known, clean).problem.posterior
        surface = LogDensity(posterior, physical=True)
        start = posterior.coordinates.from_physical(theta[None, : len(posterior.space.free)])
        best = posterior.coordinates.to_physical(gauss_newton(surface, start, 60).u)
        left = clean - posterior.likelihood.signals(best)[0]
        return float(np.sqrt(np.mean(left**2)))

    def compared(self, kind: Kind, index: int) -> tuple[list[RunSummary], float]:
        """As runs are, and the size of what is wrong."""
        y, size = self.record(kind, index)
        found = []
        for name in kind.rivals(index):
            job = of(self.jobs[name], y)
            mode, sampled = fit(job.problem.posterior, plan(job, index))
            run = comparison.NamedRun(name, None, SampledRun(job, mode, sampled))
            found.append(comparison.contender(run, job.problem.units))
        return found, size

    def found(self, kind: Kind, index: int) -> Found:
        begun = time.process_time()
        models, size = self.compared(kind, index)
        decision: ModelDecision = decide(models)
        right = next(one for one in models if one.name == kind.right)
        others = max(one.log_z for one in models if one is not right)
        return Found(
            index=index,
            size=size,
            word=decision.word,
            best=models[decision.best].name,
            ahead=right.log_z - others,
            converged=all(one.converged for one in models),
            seconds=time.process_time() - begun,
        )


def _red(rho: float, rng: np.random.Generator) -> Array:
    """By its own recurrence, no noise of the house: `(T, K)` of unit variance."""
    fresh = rng.standard_normal((len(T), len(SPEEDS)))
    out = [fresh[0]]
    for row in fresh[1:]:
        out.append(rho * out[-1] + np.sqrt(1.0 - rho**2) * row)
    return np.array(out)


def of(job: Job, y: Array) -> Job:
    """Of another record."""
    posterior = job.problem.posterior.edit(records=[y])
    return replace(job, problem=replace(job.problem, posterior=posterior))


def plan(job: Job, seed: int) -> FitPlan:
    own = find_map.fit_plan(job)
    return replace(own, chains=replace(own.chains, seed=seed))


def rightly(kind: Kind, one: Found) -> bool:
    """Whether the verdict is the word, and the most probable is what made the record."""
    return one.word == kind.word and one.best == kind.right


def line(kind: Kind, every: Sequence[Found]) -> str:
    """Of the table in `docs/compare.md`."""
    sizes = np.quantile([one.size for one in every], [0.0, 0.5, 1.0])
    ahead = np.quantile([one.ahead for one in every], [0.0, 0.05, 0.5])
    right = sum(rightly(kind, one) for one in every)
    size = f"{sizes[1]:.2f} ({sizes[0]:.2f} to {sizes[2]:.2f})"
    odds = ", ".join(f"{x:.0f}" for x in ahead)
    seconds = sum(one.seconds for one in every)
    return f"| {kind.name} | {size} | {right} of {len(every)} | {odds} | {seconds:.0f} s |"


def main() -> None:
    records = int(sys.argv[1]) if len(sys.argv) > 1 else RECORDS
    bench, wanted = Bench(contenders()), sys.argv[2:]
    for kind in KINDS:
        if wanted and kind.right not in wanted:
            continue
        every = []
        for index in range(records):
            every.append(bench.found(kind, index))
            if not rightly(kind, every[-1]) or not every[-1].converged:
                print(f"  {every[-1]}", file=sys.stderr)
        print(line(kind, every), flush=True)


if __name__ == "__main__":
    main()
