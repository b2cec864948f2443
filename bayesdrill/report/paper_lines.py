"""Lines of the paper's tables, from what the studies found: the paper's numbers beside ours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill import symbols
from bayesdrill.diagnostics import hdi
from bayesdrill.reproduction import printed
from bayesdrill.reproduction.findings import Findings, Nine
from bayesdrill.reproduction.verification import Verification


@dataclass(frozen=True, slots=True, kw_only=True)
class Line2:
    """A line of Table 2: one unknown at one sigma.  `*_percent` are relative to the truth."""

    sigma: float
    parameter: str
    printed: float
    printed_percent: float
    fminsearch: float
    fminsearch_percent: float
    scaled: float
    scaled_percent: float
    weights_only_percent: float
    weights_only_trapezoid_percent: float
    trapezoid_both_percent: float
    trapezoid_fit_percent: float
    bound_percent: float
    posterior: float
    posterior_sd_percent: float
    spread_fminsearch_percent: float
    spread_scaled_percent: float
    efficiency_scaled: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Line3:
    """A line of Table 3.  Deviations are relative to the initial guess, `off_percent` to the truth.

    `starts_percent`: standard deviation of the estimates from other starts.  `posterior`: its median;
    HDI: of the logarithm, 94 %; `holds`: whether the truth is in it.
    """

    parameter: str
    unit: str
    guess: float
    printed: float
    printed_percent: float
    heuristic: float
    heuristic_percent: float
    starts_percent: float
    truth: float | None
    off_percent: float | None
    posterior: float
    hdi_low: float
    hdi_high: float
    holds: bool | None
    verdict: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """All searches of one way: how many are as good as the best, and how those lie apart.

    `scale_*`: standard deviation along a symmetry, `rest`: off both, of the logs; 0.01 is 1 %.
    """

    way: str
    searches: int
    reached: int
    best: int
    settled: int
    misfit_median: float
    misfit_worst: float
    scale_1: float
    scale_2: float
    rest: float
    distance: float


def lines_2(found: Verification) -> tuple[Line2, ...]:
    lines = []
    for cell in found.cells:
        paper = printed.TWO_PARAMETERS[cell.sigma][cell.name]
        percent = 100.0 / cell.truth
        lines.append(
            Line2(
                sigma=cell.sigma,
                parameter=cell.name,
                printed=paper.value,
                printed_percent=paper.deviation,
                fminsearch=cell.fminsearch,
                fminsearch_percent=percent * abs(cell.fminsearch - cell.truth),
                scaled=cell.scaled,
                scaled_percent=percent * abs(cell.scaled - cell.truth),
                weights_only_percent=percent * abs(cell.weights_only - cell.truth),
                weights_only_trapezoid_percent=percent
                * abs(cell.weights_only_trapezoid - cell.truth),
                trapezoid_both_percent=percent * abs(cell.trapezoid_both - cell.truth),
                trapezoid_fit_percent=percent * abs(cell.trapezoid_fit - cell.truth),
                bound_percent=percent * cell.bound,
                posterior=cell.posterior,
                posterior_sd_percent=percent * cell.posterior_sd,
                spread_fminsearch_percent=percent * cell.sd_fminsearch,
                spread_scaled_percent=percent * cell.sd_scaled,
                efficiency_scaled=cell.sd_scaled / cell.bound,
            )
        )
    return tuple(lines)


def lines_3(nine: Nine) -> tuple[Line3, ...]:
    says = {
        nine.names[np.flatnonzero(q.exponents)[0]]: q.says
        for q in nine.verdict.parameters
        if np.count_nonzero(q.exponents) == 1
    }
    lines = []
    for name, paper in printed.NINE_PARAMETERS.items():
        if name not in nine.names:
            continue
        k = nine.names.index(name)
        guess, estimate = float(nine.heuristic.guess[k]), float(nine.heuristic.estimate[k])
        truth = None if nine.truth is None else float(nine.truth[k])
        low, high = np.exp(hdi(np.log(nine.draws[:, k])))
        lines.append(
            Line3(
                parameter=name,
                unit=symbols.PARAMETERS[name].plain_unit,
                guess=guess,
                printed=paper.value,
                printed_percent=paper.deviation,
                heuristic=estimate,
                heuristic_percent=100 * abs(estimate / guess - 1),
                starts_percent=100 * float(nine.heuristic.others[:, k].std(ddof=1)) / guess,
                truth=truth,
                off_percent=None if truth is None else 100 * (estimate / truth - 1),
                posterior=float(np.median(nine.draws[:, k])),
                hdi_low=float(low),
                hdi_high=float(high),
                holds=None if truth is None else bool(low <= truth <= high),
                verdict=says.get(name, ""),
            )
        )
    return tuple(lines)


def ways(found: Findings) -> tuple[Way, ...]:
    lines = []
    for way in dict.fromkeys(end.way for end in found.ends):
        ends = [end for end in found.ends if end.way == way]
        there = [end for end in ends if end.best] or ends
        scales = np.array([(*end.scales, np.nan, np.nan)[:2] for end in there])
        misfits = np.array([end.misfit for end in ends])
        lines.append(
            Way(
                way=way,
                searches=len(ends),
                reached=sum(end.reached for end in ends),
                best=sum(end.best for end in ends),
                settled=sum(end.settled for end in ends),
                misfit_median=float(np.median(misfits)),
                misfit_worst=float(misfits.max()),
                scale_1=float(scales[:, 0].std()),
                scale_2=float(scales[:, 1].std()),
                rest=_rms([end.rest for end in there]),
                distance=_rms([end.distance for end in there]),
            )
        )
    return tuple(lines)


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
