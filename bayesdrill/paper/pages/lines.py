"""Lines of the paper's tables, from what the studies found: the paper's numbers beside ours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.insight import hdi
from bayesdrill.paper.studies import printed
from bayesdrill.paper.studies.bounds import Length
from bayesdrill.paper.studies.findings import Findings, Nine
from bayesdrill.paper.studies.verification import Verification
from bayesdrill.report import product


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
    records: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Line3:
    """A line of Table 3.  Deviations are relative to the initial guess, with their signs, the printed
    one to the paper's; those off the truth, `*off_percent`, to that.

    `stepped`: the heuristic with the paper's integrator; None with a measured input.
    `starts_percent`: standard deviation of the estimates from other starts, over the guess.
    `posterior`: its median; HDI: of the logarithm, 94 %; `holds`: whether the truth is in it.
    """

    parameter: str
    unit: str
    guess: float
    printed: float | None
    printed_percent: float | None
    heuristic: float
    heuristic_percent: float
    stepped: float | None
    stepped_percent: float | None
    starts_percent: float
    truth: float | None
    true_percent: float | None
    off_percent: float | None
    stepped_off_percent: float | None
    posterior: float
    hdi_low: float
    hdi_high: float
    holds: bool | None
    verdict: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """All searches of one way: how many are as good as the best, and how those lie apart.

    `scale_*`: standard deviation along a symmetry, `rest`: off both, of the logs; 0.01 is 1 %.  None
    where there is none.
    """

    way: str
    searches: int
    reached: int
    best: int
    settled: int
    misfit_median: float
    misfit_worst: float
    scale_1: float | None
    scale_2: float | None
    rest: float | None
    distance: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class LineLength:
    """Cramer-Rao bounds of a record at sigma 0.001, and how many such records at sigma 1 attain c_m."""

    duration: float
    rate: float
    c_m_percent: float
    k_e_percent: float
    repeats: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """A product in the verdict on one record."""

    product: str
    deviation_percent: float
    sigmas: float
    says: str


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
                records=found.records,
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
    ours = [name for name in nine.names if name not in printed.NINE_PARAMETERS]
    for name in (*(n for n in printed.NINE_PARAMETERS if n in nine.names), *ours):
        paper = printed.NINE_PARAMETERS.get(name)
        k = nine.names.index(name)
        found = nine.heuristic
        guess, estimate = float(found.guess[k]), float(found.estimate[k])
        stepped = None if found.stepped is None else float(found.stepped[k])
        truth = None if nine.truth is None else float(nine.truth[k])
        low, high = np.exp(hdi(np.log(nine.draws[:, k])))
        lines.append(
            Line3(
                parameter=name,
                unit=nine.units[k],
                guess=guess,
                printed=None if paper is None else paper.value,
                printed_percent=None if paper is None else printed.signed_deviation(name),
                heuristic=estimate,
                heuristic_percent=100 * (estimate / guess - 1),
                stepped=stepped,
                stepped_percent=_off(stepped, guess),
                starts_percent=100 * float(found.others[:, k].std(ddof=1)) / guess,
                truth=truth,
                true_percent=_off(truth, guess),
                off_percent=_off(estimate, truth),
                stepped_off_percent=_off(stepped, truth),
                posterior=float(np.median(nine.draws[:, k])),
                hdi_low=float(low),
                hdi_high=float(high),
                holds=None if truth is None else bool(low <= truth <= high),
                verdict=says.get(name, ""),
            )
        )
    return tuple(lines)


def _off(value: float | None, reference: float | None) -> float | None:
    """In per cent, with its sign."""
    return None if value is None or reference is None else 100 * (value / reference - 1)


def ways(found: Findings) -> tuple[Way, ...]:
    lines = []
    for way in dict.fromkeys(end.way for end in found.ends):
        ends = [end for end in found.ends if end.way == way]
        there = [end for end in ends if end.best]
        scales = [_spread([end.scales[k] for end in there if len(end.scales) > k]) for k in (0, 1)]
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
                scale_1=scales[0],
                scale_2=scales[1],
                rest=_rms([end.rest for end in there]),
                distance=_rms([end.distance for end in there]),
            )
        )
    return tuple(lines)


def lengths(found: Sequence[Length], attained: float) -> tuple[LineLength, ...]:
    """`attained`: per cent of c_m at sigma 1."""
    return tuple(
        LineLength(
            duration=line.duration,
            rate=line.rate,
            c_m_percent=0.1 * line.bounds["c_m"],  # 100 % at a thousandth
            k_e_percent=0.1 * line.bounds["k_e"],
            repeats=(100 * line.bounds["c_m"] / attained) ** 2,
        )
        for line in found
    )


def said(nine: Nine) -> tuple[Said, ...]:
    return tuple(
        Said(
            product=product(nine.verdict.names, q.exponents),
            deviation_percent=100 * q.deviation,
            sigmas=q.tension,
            says=q.says,
        )
        for q in nine.verdict.products
    )


def _spread(values: Sequence[float]) -> float | None:
    return float(np.std(values)) if values else None


def _rms(values: Sequence[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if values else None
