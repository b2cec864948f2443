"""What a peer achieved, judged by one yardstick: effective draws per second of the worst parameter.

R-hat (rank-normalised, split) compares independent runs.  The walkers of one ensemble are not
independent runs: for ensemble samplers an ensemble is a chain, of draws thinned by the
autocorrelation time, as bayesdrill itself judges them.
"""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from arviz_stats.base import array_stats
from numpy.typing import NDArray

from bayesdrill.sampling.convergence import BURN_IN_TAUS, autocorrelation_time, thinned

Array = NDArray[np.float64]

R_HAT = 1.01
LEAST_ESS = 400.0  # 100 for each of four chains: below it neither R-hat nor ESS is to be trusted
LEAST_TAUS = 50.0  # length of an ensemble below which tau comes out too short


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """`seconds` are counted, `setup` (compiling) are not; `mean` and `sd` of each parameter.

    `tau` in steps of an ensemble, None for other samplers.  `work` counts evaluations of the
    likelihood, or of its gradient where the sampler uses that.
    """

    name: str
    coordinates: str
    seconds: float
    setup: float
    work: float
    ess: float
    rate: float
    r_hat: float
    tau: float | None
    converged: bool
    mean: tuple[float, ...]
    sd: tuple[float, ...]
    note: str

    def save(self, path: Path) -> None:
        path.write_text(json.dumps(dataclasses.asdict(self), indent=1) + "\n", encoding="utf-8")


def read(path: Path) -> Result:
    stored = json.loads(path.read_text(encoding="utf-8"))
    return Result(**stored | {name: tuple(stored[name]) for name in ("mean", "sd")})


def off(result: Result, reference: Result) -> float:
    """How far the means of two results are apart at most, in standard deviations."""
    if not result.mean:
        return math.nan
    distance = np.abs(np.array(result.mean) - reference.mean) / np.array(reference.sd)
    return float(distance.max())


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """`tau`: as in `Result`; `enough` says whether the run converged."""

    ess: float
    r_hat: float
    tau: float | None
    enough: bool
    mean: tuple[float, ...]
    sd: tuple[float, ...]


def nothing() -> Verdict:
    """Of a run that has no draws to show."""
    return Verdict(ess=0.0, r_hat=math.nan, tau=None, enough=False, mean=(), sd=())


def judge(draws: Array) -> Verdict:
    """Independent chains `(chains, draws, D)`."""
    columns = [np.ascontiguousarray(draws[..., d]) for d in range(draws.shape[-1])]
    ess = min(float(array_stats.ess(c, chain_axis=0, draw_axis=1, method="bulk")) for c in columns)
    r_hat = max(
        float(array_stats.rhat(c, chain_axis=0, draw_axis=1, method="rank")) for c in columns
    )
    flat = draws.reshape(-1, draws.shape[-1])
    return Verdict(
        ess=ess,
        r_hat=r_hat,
        tau=None,
        enough=r_hat <= R_HAT and ess >= LEAST_ESS,
        mean=tuple(flat.mean(axis=0).tolist()),
        sd=tuple(flat.std(axis=0).tolist()),
    )


def judge_ensembles(chains: Array, every: int) -> Verdict:
    """Ensembles `(E, S, W, D)` of which every `every`-th step was kept."""
    half = chains.shape[1] // 2
    early = float(autocorrelation_time(chains[:, half:]).max())
    burn_in = min(int(np.ceil(BURN_IN_TAUS * early)), half)
    tau = float(autocorrelation_time(chains[:, burn_in:]).max())
    length = chains.shape[1] - burn_in
    thin = max(1, min(int(np.ceil(tau)), length // 4))
    verdict = judge(thinned(chains, burn_in, thin))
    enough = verdict.enough and length >= LEAST_TAUS * tau
    return dataclasses.replace(verdict, tau=tau * every, enough=enough)


def result(
    name: str,
    coordinates: str,
    verdict: Verdict,
    *,
    seconds: float,
    work: float,
    setup: float = 0.0,
    note: str = "",
) -> Result:
    return Result(
        name=name,
        coordinates=coordinates,
        seconds=seconds,
        setup=setup,
        work=work,
        ess=verdict.ess,
        rate=verdict.ess / seconds,
        r_hat=verdict.r_hat,
        tau=verdict.tau,
        converged=verdict.enough,
        mean=verdict.mean,
        sd=verdict.sd,
        note=note,
    )


def with_tau(found: Result, tau: float, *, converged: bool) -> Result:
    """For an ensemble sampler that has judged itself: both judgements must be good."""
    return dataclasses.replace(found, tau=tau, converged=found.converged and converged)
