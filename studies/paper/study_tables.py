"""Tabulate the paper's studies: the paper's numbers beside ours, as CSV and for pages."""

from __future__ import annotations

import dataclasses
import itertools
import string
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill.inference import hdi
from bayesdrill.report import Table as Grid
from bayesdrill.report import lines_as_csv, markdown, product
from studies.paper import printed, searches
from studies.paper.findings import NineParameterStudy, PaperFindings
from studies.paper.forward import FOLLOWED
from studies.paper.precision import ATTAINED
from studies.paper.printed import Row
from studies.paper.searches import Verification


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyTable:
    """A table of a study; `stem` names its files, `says` is its caption, `rows` those of the CSV."""

    stem: str
    title: str
    says: str
    rows: Sequence[Row]
    grids: tuple[Grid, ...]

    @property
    def csv(self) -> str:
        """The table as CSV."""
        heads = [*self.rows[0]] if self.rows else []
        return lines_as_csv([heads, *([*row.values()] for row in self.rows)])

    @property
    def markdown(self) -> str:
        """The grids below each other, in Markdown."""
        return "\n".join(map(markdown, self.grids))


def table(stem: str, title: str, says: str, rows: Sequence[Row], *layouts: str) -> StudyTable:
    """Build a table with a grid for each pair of `layouts`: heads, and what `cell` puts below each."""
    grids = []
    for layout in itertools.batched(layouts, 2):
        heads, cells = ([part.strip() for part in line.split("|")] for line in layout)
        grids.append(grid(heads, [[cell(text, row) for text in cells] for row in rows]))
    return StudyTable(stem=stem, title=title, says=says, rows=rows, grids=tuple(grids))


def grid(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> Grid:
    """Build a grid; columns of words begin at the left."""
    cells = tuple(map(tuple, lines))
    columns = zip(heads, *cells, strict=True) if cells else ()
    words = {head for head, *column in columns if any(_is_text(cell) for cell in column)}
    return Grid(tuple(heads), cells, frozenset({*heads[:1], *words}))


def _is_text(cell: str) -> bool:
    """Words, or a unit; an interval from one number to another is none."""
    return any(letter.isalpha() for letter in cell.replace(" to ", "").replace("e", ""))


class _Numbers(string.Formatter):
    """Formats texts: numbers have four digits; `%` as `percent`, `share`: of a share in per cent."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if format_spec == "%":
            return percent(value)
        if format_spec == "share":  # a linear bound beyond ten says no more than that
            return percent(100 * value) if value <= 10 else "> 1000"
        return format(value, format_spec or (".4g" if isinstance(value, float) else ""))


_NUMBERS = _Numbers()


def cell(text: str, row: Row) -> str:
    """Fill a text with values of the row; it is empty where one of them is None."""
    names = [name for _, name, _, _ in _NUMBERS.parse(text) if name]
    return "" if any(row[name] is None for name in names) else _NUMBERS.vformat(text, (), row)


def percent(x: float) -> str:
    """Return a number as text in per cent."""
    return f"{x:.2g}" if x < 99.5 else f"{x:.0f}"


# Of these only the deviation is told.
ESTIMATES = ("weights_only", "weights_only_trapezoid", "trapezoid_both", "trapezoid_fit")


def lines_2(verification: Verification) -> list[Row]:
    """Return lines of Table 2, one for each unknown at each sigma; `*_percent`: of the truth."""

    def line(sigma: float, k: int, name: str) -> Row:
        x = {what: float(each[k]) for what, each in verification.values[sigma].items()}
        paper, scale = printed.TWO_PARAMETERS[sigma][name], 100.0 / x["truth"]
        off = {what: scale * abs(value - x["truth"]) for what, value in x.items()}
        return {
            "sigma": sigma,
            "parameter": name,
            "printed": paper.value,
            "printed_percent": paper.deviation,
            "fminsearch": x["fminsearch"],
            "fminsearch_percent": off["fminsearch"],
            "scaled": x["scaled"],
            "scaled_percent": off["scaled"],
            **{f"{what}_percent": off[what] for what in ESTIMATES},
            "bound_percent": scale * x["bound"],
            "posterior": x["posterior"],
            "posterior_sd_percent": scale * x["posterior_sd"],
            "spread_fminsearch_percent": scale * x["sd_fminsearch"],
            "spread_scaled_percent": scale * x["sd_scaled"],
            "efficiency_scaled": x["sd_scaled"] / x["bound"],
            "records": verification.records,
        }

    names = enumerate(verification.names)
    return [line(sigma, *k) for sigma, k in itertools.product(verification.values, names)]


def lines_3(nine: NineParameterStudy) -> list[Row]:
    """Return lines of Table 3; `stepped`: with the paper's integrator, None with a measured input.

    Deviations are relative to the initial guess, with their signs, the printed one to the paper's;
    `*off_percent` to the truth. `starts_percent`: sd of the estimates from other starts, over the
    guess. `posterior`: its median; HDI: of the logarithm, 94 %; `holds`: whether the truth is inside.
    """
    heuristic, ours = nine.heuristic, [n for n in nine.names if n not in printed.NINE_PARAMETERS]
    says = {
        nine.names[np.flatnonzero(q.exponents)[0]]: q.says
        for q in nine.verdict.parameters
        if np.count_nonzero(q.exponents) == 1
    }

    def line(name: str) -> Row:
        paper, k = printed.NINE_PARAMETERS.get(name), nine.names.index(name)
        guess, estimate = float(heuristic.guess[k]), float(heuristic.estimate[k])
        stepped = None if heuristic.stepped is None else float(heuristic.stepped[k])
        truth = None if nine.truth is None else float(nine.truth[k])
        low, high = map(float, np.exp(hdi(np.log(nine.draws[:, k]))))
        return {
            "parameter": name,
            "unit": nine.units[k],
            "guess": guess,
            "printed": None if paper is None else paper.value,
            "printed_percent": None if paper is None else printed.signed_deviation(name),
            "heuristic": estimate,
            "heuristic_percent": _off(estimate, guess),
            "stepped": stepped,
            "stepped_percent": _off(stepped, guess),
            "starts_percent": 100 * float(heuristic.others[:, k].std(ddof=1)) / guess,
            "truth": truth,
            "true_percent": _off(truth, guess),
            "off_percent": _off(estimate, truth),
            "stepped_off_percent": _off(stepped, truth),
            "posterior": float(np.median(nine.draws[:, k])),
            "hdi94_low": low,
            "hdi94_high": high,
            "holds": None if truth is None else bool(low <= truth <= high),
            "verdict": says.get(name, ""),
        }

    return [*map(line, (*(n for n in printed.NINE_PARAMETERS if n in nine.names), *ours))]


def _off(value: float | None, reference: float | None) -> float | None:
    """In per cent, with its sign."""
    return None if value is None or reference is None else 100 * (value / reference - 1)


def ways(findings: PaperFindings) -> list[Row]:
    """Sum up all searches of one way: how many are as good as the best, and how those differ."""

    def line(way: str) -> Row:
        ends = [end for end in findings.ends if end.way == way]
        there = [end for end in ends if end.best]
        misfits = np.array([end.misfit for end in ends])
        return {
            "way": way,
            "searches": len(ends),
            "reached": sum(end.reached for end in ends),
            "best": len(there),
            "settled": sum(end.settled for end in ends),
            "misfit_median": float(np.median(misfits)),
            "misfit_worst": float(misfits.max()),
            "scale_1": _spread([end.scales[0] for end in there if end.scales]),
            "scale_2": _spread([end.scales[1] for end in there if len(end.scales) > 1]),
            "rest": _rms([end.rest for end in there]),
            "distance": _rms([end.distance for end in there]),
        }

    return [*map(line, dict.fromkeys(end.way for end in findings.ends))]


def _spread(values: Sequence[float]) -> float | None:
    return float(np.std(values)) if values else None


def _rms(values: Sequence[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


def products(nine: NineParameterStudy) -> list[Row]:
    """Return products in the verdict on one record."""
    return [
        {
            "product": product(nine.verdict.names, q.exponents),
            "deviation_percent": 100 * q.deviation,
            "sigmas": q.tension,
            "says": q.says,
        }
        for q in nine.verdict.products
    ]


def tables(findings: PaperFindings) -> tuple[StudyTable, ...]:
    """Return all tables, in the order of the paper."""
    of_records = itertools.chain(*zip(*map(_of_record, findings.nines), strict=True))
    return (*_of_paper(findings), *_of_searches(findings), *of_records, _shaft(findings))


def _of_paper(findings: PaperFindings) -> tuple[StudyTable, ...]:
    """What it prints, and its study of two parameters."""
    return (
        table(
            "table_1",
            "Table 1: nominal values",
            "As printed, and what is the nominal value here.",
            printed.table_1(),
            " | unit | Table 1 | here | why",
            "{parameter} | {unit} | {printed} | {nominal} | {says}",
        ),
        table(
            "inconsistencies",
            "What the paper says twice",
            "Numbers of the paper that contradict each other, and our reading.",
            printed.inconsistencies(),
            "what | printed | implied | our reading",
            "{what} | {printed} {unit} | {implied:.3g} {unit} | {says}",
        ),
        table(
            "matrix",
            "The printed matrix",
            f"Speed of theta_2 [rad/s] {FOLLOWED:g} s after the step, by the reading of the printed "
            "matrix. Then the same by the paper's integrator, and where it settles.",
            [reading.row for reading in findings.readings],
            f"matrix | after {FOLLOWED:g} s | trapezoidal rule | in the end | steps",
            "{matrix} | {w_2} | {w_2_trapezoid} | {w_end} | {steps}",
        ),
        table(
            "integrator",
            "The paper's integrator",
            "Distance of the trapezoidal rule with adaptive steps (relative tolerance 1e-3) from the "
            "exact response, in rad and rad/s.",
            findings.errors,
            "channel | largest | rms | steps",
            "{channel} | {largest} | {rms} | {steps}",
        ),
        _table_2(findings.verification),
        table(
            "implied",
            "Which noise Table 2 has",
            "Deviations of Table 2 in per cent, their ratio, and for each the sigma_n at which it is "
            "the Cramer-Rao bound. Then their root mean square, and the bounds at 0.001.",
            findings.implied,
            "sigma_n | c_m % | k_e % | ratio | noise by c_m | noise by k_e",
            "{row} | {c_m_percent} | {k_e_percent} | {ratio:.3g} | {noise_c_m:.2g} | {noise_k_e:.2g}",
        ),
        table(
            "lengths",
            "For which record length",
            "Cramer-Rao bounds at sigma_n 0.001; they grow with sigma_n. Then how many such records at "
            f"sigma_n 1 it takes to know c_m to the {ATTAINED:g} % of Table 2.",
            findings.lengths,
            "duration s | rate Hz | c_m % at 0.001 | k_e % at 0.001 | records at 1",
            "{duration:g} | {rate:g} | {c_m_percent} | {k_e_percent} | {repeats:.2g}",
        ),
    )


def _table_2(verification: Verification) -> StudyTable:
    """In Markdown two tables: the paper's layout, and what an estimate can attain."""
    lines = lines_2(verification)
    layout = grid(
        ("sigma_n", "", *(head for name in verification.names for head in (name, "dev. %"))),
        (
            (
                *(f"{sigma:g}" if by == "paper" else "", by),
                *(part for n in lines if n["sigma"] == sigma for part in _estimate(n, by)),
            )
            for sigma in verification.values
            for by in ("paper", "fminsearch", "scaled")
        ),
    )
    attained = table(
        "table_2",
        "Table 2: two parameters",
        "First the paper's layout: its estimates, and those of one record here. Then, in per cent "
        f"of the true value: Cramer-Rao bound, spread of the estimates over {verification.records} "
        "records, and standard deviation of the posterior of one. Last come deviations of a record "
        "without noise, where sigma is but a weight. They are computed here, and with the paper's "
        "integrator (of an exact record, of its own).",
        lines,
        "sigma_n |  | Cramer-Rao % | spread fminsearch % | spread scaled % | posterior sd % | "
        "weights only % | weights only, ode23t % | ode23t, exact record % | ode23t, own record %",
        "{sigma:g} | {parameter} | {bound_percent} | {spread_fminsearch_percent} | "
        "{spread_scaled_percent} | {posterior_sd_percent} | {weights_only_percent} | "
        "{weights_only_trapezoid_percent} | {trapezoid_fit_percent} | {trapezoid_both_percent}",
    )
    return dataclasses.replace(attained, grids=(layout, *attained.grids))


def _estimate(line: Row, by: str) -> tuple[str, str]:
    """With the power of ten that the paper writes."""
    what = "printed" if by == "paper" else by
    power = {"c_m": 5, "k_e": 4}[line["parameter"]]
    return f"{line[what] * 10**power:.1f}e-{power}", percent(line[f"{what}_percent"])


def _of_searches(findings: PaperFindings) -> tuple[StudyTable, ...]:
    """All parameters at once, and the heuristic."""
    factors = " and on ".join(", ".join(names) for names in findings.symmetries)
    return (
        table(
            "simultaneous",
            "All parameters at once",
            f"Searches of `{findings.searched}` from starts within {100 * searches.WITHIN:.0f} % of the "
            "guesses. Counted are those that leave only noise, those as good as the best (to "
            f"{searches.SAME:g} of its misfit), and those that stopped by themselves. Last comes how "
            "the good ones scatter, relative to the truth. These are standard deviations of the log "
            f"of a common factor on {factors}, and the root mean square distance off both.",
            ways(findings),
            "way | searches | noise only | best | stopped | misfit median | worst | factor 1 | "
            "factor 2 | off both",
            "{way} | {searches} | {reached} | {best} | {settled} | {misfit_median} | {misfit_worst} | "
            "{scale_1} | {scale_2} | {rest}",
        ),
        table(
            "misfits",
            "Misfit per measured number",
            "1 is what the noise leaves; at the truth 95 % of records have it between `low` and "
            "`high`. `other starts`: the largest of the heuristic's. `ode23t`: the heuristic with the "
            "paper's integrator, its misfit computed with that (empty with a measured input, which the "
            "paper has not).",
            [nine.misfits for nine in findings.nines],
            "record | numbers | guess | heuristic | other starts | ode23t | MAP | truth | low | high",
            "{record} | {numbers} | {guess} | {heuristic} | {others} | {stepped} | {map} | {truth} | "
            "{low} | {high}",
        ),
        _control(findings.control),
    )


def _control(lines: Sequence[Row]) -> StudyTable:
    """In Markdown a column for each noise."""
    sigmas = list(dict.fromkeys(line["sigma"] for line in lines))
    cells = {(line["parameter"], line["sigma"]): line["largest_percent"] for line in lines}
    parameters = dict.fromkeys(line["parameter"] for line in lines)
    by_sigma = grid(
        ("", *(f"noise {sigma:g}" for sigma in sigmas)),
        ((name, *(percent(cells[name, sigma]) for sigma in sigmas)) for name in parameters),
    )
    return StudyTable(
        stem="control",
        title="A rig that is as the table says",
        says=f"The heuristic on {lines[0]['records']} records of the nominal rig at each noise (in rad "
        "and rad/s), searched from its true values. Shown is the largest distance of an estimate from "
        "them, in per cent. 0: it never moved.",
        rows=lines,
        grids=(by_sigma,),
    )


def _of_record(nine: NineParameterStudy) -> tuple[StudyTable, StudyTable, StudyTable]:
    """Return Table 3 of one record beside what is true, what could be behind it, and the verdict."""
    careful = "".join(f"**Careful: {doubt}.** " for doubt in doubts(nine))
    given = f"Not searched: {', '.join(nine.given)}. " if nine.given else ""
    return (
        table(
            f"table_3_{nine.name}",
            f"Table 3, record `{nine.name}`",
            f"{careful}First the paper's layout: deviations in per cent of the initial guess, with "
            "their signs. They are the paper's from its own guesses, the heuristic's here, and the "
            f"heuristic's with the paper's integrator. {given}Then the truth, where it is known, "
            "and how far off it both are. `other starts` is the standard deviation of the estimates "
            "from them, over the guess. Last comes the posterior: median, 94 % HDI of the logarithm, "
            "and what the record says of the nominal value.",
            lines_3(nine),
            " | guess | paper | dev. % | heuristic | dev. % | ode23t | dev. %",
            "{parameter} | {guess} | {printed} | {printed_percent:+.3g} | {heuristic} | "
            "{heuristic_percent:+.3g} | {stepped} | {stepped_percent:+.3g}",
            " | truth | heuristic off % | ode23t off % | other starts % | posterior | 94 % HDI | "
            "the table",
            "{parameter} | {truth} | {off_percent:+.3g} | {stepped_off_percent:+.3g} | "
            "{starts_percent:.3g} | {posterior} | {hdi94_low:.3g} to {hdi94_high:.3g} | {verdict}",
        ),
        table(
            f"products_{nine.name}",
            f"What a record can show, record `{nine.name}`",
            f"{careful}Quantities that no symmetry changes, over their values at the paper's initial "
            "guesses (w_end: the steady speed; zeta: the damping ratio). First those of Table 3 as "
            "printed, and with the digits of its percentages. Next the nominal rig with "
            f"j_2 = {printed.J_2:g} kg m^2 at the output, r_s = {printed.R_S:g} ohm in series, "
            "both, or k_T = k_e. Then those of this record, by heuristic and posterior (median, "
            "94 % HDI of the logarithm). `alone` is the Cramer-Rao bound of the standard deviation "
            "without any prior, in per cent. Empty where the config gives the quantity.",
            nine.causes,
            " | Table 3 | with digits | j_2 | r_s | j_2 and r_s | k_T = k_e",
            "{quantity} | {table_3} | {table_3_digits} | {j_2} | {r_s} | {both} | {k_T}",
            " | heuristic | posterior | 94 % HDI | alone %",
            "{quantity} | {heuristic} | {posterior} | {hdi94_low} to {hdi94_high} | {alone:share}",
        ),
        table(
            f"verdict_{nine.name}",
            f"The verdict, record `{nine.name}`",
            f"{careful}Independent products of the parameters that such a record can show. First the "
            "deviation of the mean of the posterior from the nominal table. Then how many standard "
            "deviations that is, beyond a tolerance if there is one. Above "
            f"{nine.verdict.limit:.2f} the record disagrees with the table.",
            products(nine),
            " | dev. % | sigmas | the table",
            "{product} | {deviation_percent:+.3g} | {sigmas:%} | {says}",
        ),
    )


def _shaft(findings: PaperFindings) -> StudyTable:
    return table(
        "shaft",
        "The shaft as a continuum",
        "Natural frequencies [Hz] of a steel shaft with both inertias, and of the model's spring.",
        findings.tones,
        "mode | distributed | spring",
        "{mode} | {distributed:.7g} | {lumped:.7g}",
    )


def doubts(nine: NineParameterStudy) -> Iterator[str]:
    """Yield what takes the worth away from all that is said of a record."""
    m = nine.misfits
    if not m["map"] <= m["high"]:
        yield (
            f"even the MAP leaves a misfit of {m['map']:.4g} per number, where noise leaves at most "
            f"{m['high']:.3g}. A unit, the voltage, a sigma or the model does not fit this record: "
            "estimates and intervals say little"
        )
    if not nine.converged:
        yield f"the posterior did not converge (`{nine.name}/run.json` says why): do not use its numbers"
