"""Tables of the paper's studies, from what was found: the paper's numbers beside ours, as CSV and
for pages.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.inference import hdi
from bayesdrill.paper import printed, searches
from bayesdrill.paper.findings import Findings, Misfits, Nine
from bayesdrill.paper.precision import Length
from bayesdrill.paper.printed import Cause
from bayesdrill.paper.searches import Control, Verification
from bayesdrill.report import Table as Grid
from bayesdrill.report import markdown, product, records_as_csv


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """`stem` names its files; `says` is its caption."""

    stem: str
    title: str
    says: str
    csv: str
    grids: tuple[Grid, ...]

    @property
    def markdown(self) -> str:
        """Grids below each other."""
        return "\n".join(map(markdown, self.grids))


def table[T](
    stem: str,
    title: str,
    says: str,
    kind: type[T],
    rows: Sequence[T],
    cells: Callable[[T], Sequence[str]],
    heads: Sequence[str],
    leave: Sequence[str] = (),
) -> Table:
    return Table(
        stem=stem,
        title=title,
        says=says,
        csv=records_as_csv(kind, rows, leave),
        grids=(grid(heads, map(cells, rows)),),
    )


def grid(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> Grid:
    cells = tuple(map(tuple, lines))
    columns = zip(heads, *cells, strict=True) if cells else ()
    words = {head for head, *column in columns if any(_is_text(cell) for cell in column)}
    return Grid(tuple(heads), cells, frozenset({*heads[:1], *words}))


def _is_text(cell: str) -> bool:
    """Words, or a unit; an interval from one number to another is none."""
    return any(letter.isalpha() for letter in cell.replace(" to ", "").replace("e", ""))


def percent(x: float) -> str:
    return f"{x:.2g}" if x < 99.5 else f"{x:.0f}"


def digits(*values: float | None) -> tuple[str, ...]:
    """Empty where there is no number."""
    return tuple("" if value is None else f"{value:.4g}" for value in values)


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


ESTIMATES = (
    *("fminsearch", "scaled", "weights_only", "weights_only_trapezoid"),
    *("trapezoid_both", "trapezoid_fit"),
)  # of `Cell`, each held against the truth


def lines_2(found: Verification) -> tuple[Line2, ...]:
    lines = []
    for cell in found.cells:
        paper = printed.TWO_PARAMETERS[cell.sigma][cell.name]
        percent = 100.0 / cell.truth
        off = {f"{n}_percent": percent * abs(getattr(cell, n) - cell.truth) for n in ESTIMATES}
        lines.append(
            Line2(
                **off,
                sigma=cell.sigma,
                parameter=cell.name,
                printed=paper.value,
                printed_percent=paper.deviation,
                fminsearch=cell.fminsearch,
                scaled=cell.scaled,
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


def tables(found: Findings) -> tuple[Table, ...]:
    return (
        _simultaneous(found),
        _misfits([nine.misfits for nine in found.nines]),
        _control(found.control),
        *(_table_3(nine) for nine in found.nines),
        *(_causes(nine) for nine in found.nines),
        *(_verdict(nine) for nine in found.nines),
    )


def _simultaneous(found: Findings) -> Table:
    factors = " and on ".join(", ".join(names) for names in found.symmetries)
    return table(
        "simultaneous",
        "All parameters at once",
        f"Searches of `{found.searched}` from starts within {100 * searches.WITHIN:.0f} % of the "
        "guesses: how many leave no more than noise, how many are as good as the best (within "
        f"{searches.SAME:g} of its misfit), how many stopped by themselves. How those that are as "
        f"good scatter: standard deviations of the log of a common factor on {factors}, and root mean "
        "square distance off both, all relative to the truth.",
        Way,
        ways(found),
        lambda w: (
            *(w.way, str(w.searches), str(w.reached), str(w.best), str(w.settled)),
            *digits(w.misfit_median, w.misfit_worst, w.scale_1, w.scale_2, w.rest),
        ),
        (
            *("way", "searches", "noise only", "best", "stopped", "misfit median", "worst"),
            *("factor 1", "factor 2", "off both"),
        ),
    )


def _misfits(found: Sequence[Misfits]) -> Table:
    return table(
        "misfits",
        "Misfit per measured number",
        "1 is what the noise leaves; at the truth 95 % of records have it between `low` and `high`. "
        "`other starts`: the largest of the heuristic's. `ode23t`: the heuristic with the paper's "
        "integrator, its misfit computed with that (empty with a measured input, which the paper has "
        "not).",
        Misfits,
        found,
        lambda m: (
            *(m.record, str(m.numbers), *digits(m.guess, m.heuristic, m.others, m.stepped)),
            *digits(m.map, m.truth, m.low, m.high),
        ),
        (
            *("record", "numbers", "guess", "heuristic", "other starts", "ode23t", "MAP", "truth"),
            *("low", "high"),
        ),
    )


def _control(lines: Sequence[Control]) -> Table:
    """In Markdown a column for each noise."""
    sigmas = list(dict.fromkeys(line.sigma for line in lines))
    cells = {(line.parameter, line.sigma): line.largest_percent for line in lines}
    parameters = dict.fromkeys(line.parameter for line in lines)
    return Table(
        stem="control",
        title="A rig that is as the table says",
        says=f"The heuristic on {lines[0].records} records of the nominal rig at each noise (in rad and "
        "rad/s), searched from its true values: largest distance of an estimate from them, in per cent. "
        "0: it never moved.",
        csv=records_as_csv(Control, lines),
        grids=(
            grid(
                ("", *(f"noise {sigma:g}" for sigma in sigmas)),
                ((name, *(percent(cells[name, sigma]) for sigma in sigmas)) for name in parameters),
            ),
        ),
    )


def _table_3(nine: Nine) -> Table:
    """In Markdown two tables: the paper's layout, and what is true."""
    lines = lines_3(nine)
    layout = grid(
        ("", "guess", "paper", "dev. %", "heuristic", "dev. %", "ode23t", "dev. %"),
        (
            (
                *(n.parameter, *digits(n.guess, n.printed), _signed(n.printed_percent)),
                *(*digits(n.heuristic), _signed(n.heuristic_percent)),
                *(*digits(n.stepped), _signed(n.stepped_percent)),
            )
            for n in lines
        ),
    )
    judged = grid(
        (
            *("", "truth", "heuristic off %", "ode23t off %", "other starts %", "posterior"),
            *("94 % HDI", "the table"),
        ),
        (
            (
                *(n.parameter, *digits(n.truth), _signed(n.off_percent)),
                *(_signed(n.stepped_off_percent), f"{n.starts_percent:.3g}"),
                *(*digits(n.posterior), f"{n.hdi_low:.3g} to {n.hdi_high:.3g}", n.verdict),
            )
            for n in lines
        ),
    )
    return Table(
        stem=f"table_3_{nine.name}",
        title=f"Table 3, record `{nine.name}`",
        says=f"{_doubts(nine)}First the paper's layout, deviations in per cent of the initial guess, "
        "with their signs: the paper's estimates and its deviations from its own guesses, the "
        f"heuristic's here, and the heuristic's with the paper's integrator.{_given(nine)} Then the "
        "truth, where it is known, and how far off it both are; the standard deviation of the estimates "
        "from other starts, over the guess; and the posterior: median, 94 % HDI of the logarithm, and "
        "what the record says of the nominal value.",
        csv=records_as_csv(Line3, lines),
        grids=(layout, judged),
    )


def _causes(nine: Nine) -> Table:
    """In Markdown two tables: what could be behind Table 3, and what this record shows."""
    behind = grid(
        ("", "Table 3", "with digits", "j_2", "r_s", "j_2 and r_s", "k_T = k_e"),
        (
            (c.quantity, *digits(c.table_3, c.table_3_digits, c.j_2, c.r_s, c.both, c.k_T))
            for c in nine.causes
        ),
    )
    shown = grid(
        ("", "heuristic", "posterior", "94 % HDI", "alone %"),
        (
            (
                *(c.quantity, *digits(c.heuristic, c.posterior)),
                *(_interval(c.hdi_low, c.hdi_high), _share(c.alone)),
            )
            for c in nine.causes
        ),
    )
    return Table(
        stem=f"products_{nine.name}",
        title=f"What a record can show, record `{nine.name}`",
        says=f"{_doubts(nine)}Quantities that no symmetry changes, over their values at the paper's "
        "initial guesses (w_end: the steady speed; zeta: the damping ratio). First those of Table 3 as "
        f"printed, and with the digits of its percentages; of the nominal rig with j_2 = "
        f"{printed.J_2:g} kg m^2 at the output, with r_s = {printed.R_S:g} ohm in series, with both; "
        "and with k_T = k_e. "
        "Then those of this record, by heuristic and posterior (median, 94 % HDI of the logarithm); "
        "`alone`: the Cramer-Rao bound of the standard deviation without any prior, in per cent. Empty "
        "where the config gives the quantity.",
        csv=records_as_csv(Cause, nine.causes),
        grids=(behind, shown),
    )


def _verdict(nine: Nine) -> Table:
    return table(
        f"verdict_{nine.name}",
        f"The verdict, record `{nine.name}`",
        f"{_doubts(nine)}Independent products of the parameters that such a record can show: deviation "
        "of the mean of the posterior from the nominal table, how many standard deviations that is, "
        f"beyond a tolerance if there is one (above {nine.verdict.limit:.2f} the record disagrees), and "
        "what the record says of the table.",
        Said,
        said(nine),
        lambda q: (q.product, _signed(q.deviation_percent), percent(q.sigmas), q.says),
        ("", "dev. %", "sigmas", "the table"),
    )


def doubts(nine: Nine) -> list[str]:
    """What takes the worth away from all that is said of a record."""
    found, m = [], nine.misfits
    if not m.explained:
        found.append(
            f"even the MAP leaves a misfit of {m.map:.4g} per number, where noise leaves at most "
            f"{m.high:.3g}: a unit, the voltage, a sigma or the model does not fit this record, and "
            "estimates and intervals say little"
        )
    if not nine.converged:
        found.append(
            f"the posterior did not converge (`{nine.name}/run.json` says why): do not use its numbers"
        )
    return found


def _doubts(nine: Nine) -> str:
    return "".join(f"**Careful: {doubt}.** " for doubt in doubts(nine))


def _given(nine: Nine) -> str:
    return f" Not searched: {', '.join(nine.given)}." if nine.given else ""


def _interval(low: float | None, high: float | None) -> str:
    return "" if low is None or high is None else f"{low:.4g} to {high:.4g}"


def _share(x: float | None) -> str:
    """In per cent; a linear bound beyond ten says no more than that."""
    if x is None:
        return ""
    return percent(100 * x) if x <= 10 else "> 1000"


def _signed(percent: float | None) -> str:
    return "" if percent is None else f"{percent:+.3g}"
