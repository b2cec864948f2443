"""Tables of the paper's studies: each as records (CSV), as Markdown, and the whole in sentences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bayesdrill.report.paper_lines import Line2, Line3, Way, lines_2, lines_3, ways
from bayesdrill.report.tables import markdown, records_as_csv
from bayesdrill.reproduction import printed
from bayesdrill.reproduction.bounds import Length
from bayesdrill.reproduction.causes import Cause
from bayesdrill.reproduction.control import Control
from bayesdrill.reproduction.findings import Findings, Misfits, Nine
from bayesdrill.reproduction.forward import FOLLOWED, Error, Reading
from bayesdrill.reproduction.printed import Inconsistency
from bayesdrill.reproduction.shaft import Tone
from bayesdrill.reproduction.verification import Verification

ATTAINED = 0.82  # per cent: what Table 2 reports of c_m at sigma_n 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """`stem` names its files; `says` is its caption."""

    stem: str
    title: str
    says: str
    csv: str
    markdown: str


def tables(found: Findings) -> tuple[Table, ...]:
    """In the order of the paper."""
    return (
        _inconsistencies(),
        _matrix(found.readings),
        _integrator(found.errors),
        _table_2(found.verification),
        _lengths(found.lengths),
        _simultaneous(found),
        _misfits([nine.misfits for nine in found.nines]),
        _control(found.control),
        *(_table_3(nine) for nine in found.nines),
        *(_causes(nine) for nine in found.nines),
        _shaft(found.tones),
    )


def _inconsistencies() -> Table:
    return _table(
        "inconsistencies",
        "What the paper says twice",
        "Numbers of the paper that contradict each other, and our reading.",
        Inconsistency,
        printed.inconsistencies(),
        lambda i: (i.what, f"{i.printed:.4g} {i.unit}", f"{i.implied:.3g} {i.unit}", i.says),
        ("what", "printed", "implied", "our reading"),
    )


def _matrix(readings: Sequence[Reading]) -> Table:
    return _table(
        "matrix",
        "The printed matrix",
        f"Speed of theta_2 [rad/s] {FOLLOWED:g} s after the 8 V step, by the reading of the printed "
        "matrix; the same by the paper's integrator; and where it settles.",
        Reading,
        readings,
        lambda r: (r.matrix, *_digits(r.w_2, r.w_2_trapezoid, r.w_end), str(r.steps)),
        ("matrix", f"after {FOLLOWED:g} s", "trapezoidal rule", "in the end", "steps"),
        leave=("t", "curve"),
    )


def _integrator(errors: Sequence[Error]) -> Table:
    return _table(
        "integrator",
        "The paper's integrator",
        "Distance of the trapezoidal rule with adaptive steps (relative tolerance 1e-3) from the "
        "exact response, in rad and rad/s.",
        Error,
        errors,
        lambda e: (e.channel, *_digits(e.largest, e.rms), str(e.steps)),
        ("channel", "largest", "rms", "steps"),
    )


def _table_2(found: Verification) -> Table:
    """In Markdown two tables: the paper's layout, and what an estimate can attain."""
    lines = lines_2(found)
    layout = markdown(
        ("sigma_n", "", "paper", "dev. %", "fminsearch", "dev. %", "scaled", "dev. %"),
        (
            (
                *(f"{n.sigma:g}", n.parameter, *_estimate(n, n.printed, n.printed_percent)),
                *_estimate(n, n.fminsearch, n.fminsearch_percent),
                *_estimate(n, n.scaled, n.scaled_percent),
            )
            for n in lines
        ),
    )
    attained = markdown(
        (
            *("sigma_n", "", "Cramer-Rao %", "spread fminsearch %", "spread scaled %"),
            *("posterior sd %", "weights only %", "weights only, ode23t %"),
            *("ode23t, exact record %", "ode23t, own record %"),
        ),
        (
            (
                *(f"{n.sigma:g}", n.parameter, *_digits(n.bound_percent)),
                *_digits(n.spread_fminsearch_percent, n.spread_scaled_percent),
                *_digits(n.posterior_sd_percent, n.weights_only_percent),
                *_digits(n.weights_only_trapezoid_percent),
                *_digits(n.trapezoid_fit_percent, n.trapezoid_both_percent),
            )
            for n in lines
        ),
    )
    return Table(
        stem="table_2",
        title="Table 2: two parameters",
        says="First the paper's layout: its estimates, and those of one record here.  Then, in per cent "
        f"of the true value: Cramer-Rao bound, spread of the estimates over {found.records} records, "
        "standard deviation of the posterior of one; and deviations where sigma is but a weight and the "
        "record has no noise, and with the paper's integrator (of an exact record, of its own).",
        csv=records_as_csv(Line2, lines, {}),
        markdown=f"{layout}\n{attained}",
    )


def _estimate(line: Line2, value: float, deviation: float) -> tuple[str, str]:
    """With the power of ten that the paper writes."""
    power = {"c_m": 5, "k_e": 4}[line.parameter]
    return f"{value * 10**power:.1f}e-{power}", _percent(deviation)


def _lengths(found: Sequence[Length]) -> Table:
    """`repeats`: records of this length that it takes to know c_m at sigma 1 as Table 2 reports."""
    names = tuple(found[0].bounds)
    keys = ("duration", "rate", *(f"{name}_percent" for name in names), "repeats")
    heads = ("duration s", "rate Hz", *(f"{n} % at 0.001" for n in names), "records at 1")
    rows = []
    for line in found:
        bounds = [0.1 * line.bounds[name] for name in names]
        repeats = (100 * line.bounds["c_m"] / ATTAINED) ** 2
        rows.append((f"{line.duration:g}", f"{line.rate:g}", *_digits(*bounds, repeats)))
    return Table(
        stem="lengths",
        title="For which record length",
        says="Cramer-Rao bounds at sigma_n 0.001 (they grow with sigma_n), and how many such records "
        f"at sigma_n 1 it takes to know c_m to the {ATTAINED:g} % of Table 2.",
        csv="".join(",".join(row) + "\n" for row in (keys, *rows)),
        markdown=markdown(heads, rows),
    )


def _simultaneous(found: Findings) -> Table:
    return _table(
        "simultaneous",
        "Nine parameters at once",
        f"Searches of the record `{found.searched}` from starts within 50 % of the guesses, inside a "
        "quarter to four times those: how many leave no more than noise, how many are as good as the "
        "best (within 4 of its misfit), how many stopped by themselves; and how those as good as the "
        "best scatter: standard deviations of the log of a common factor on "
        f"{' and on '.join(found.symmetries)}, and root mean square distance off both.",
        Way,
        ways(found),
        lambda w: (
            *(w.way, str(w.searches), str(w.reached), str(w.best), str(w.settled)),
            *_digits(w.misfit_median, w.misfit_worst, w.scale_1, w.scale_2, w.rest),
        ),
        (
            *("way", "searches", "noise only", "best", "stopped", "misfit median", "worst"),
            *("factor 1", "factor 2", "off both"),
        ),
    )


def _control(lines: Sequence[Control]) -> Table:
    return _table(
        "control",
        "A rig that is as the table says",
        f"The heuristic on {lines[0].records} records of the nominal rig, searched from its true "
        "values: largest distance of an estimate from them, in per cent.",
        Control,
        lines,
        lambda c: (c.parameter, *_digits(c.largest_percent)),
        ("", "largest %"),
    )


def _misfits(found: Sequence[Misfits]) -> Table:
    return _table(
        "misfits",
        "Misfit per measured number",
        "1 is what the noise leaves; at the truth 95 % of records have it between `low` and `high`.",
        Misfits,
        found,
        lambda m: (
            *(m.record, str(m.numbers), *_digits(m.guess, m.heuristic, m.map)),
            *("" if m.truth is None else f"{m.truth:.4g}", *_digits(m.low, m.high)),
        ),
        ("record", "numbers", "guess", "heuristic", "MAP", "truth", "low", "high"),
    )


def _shaft(tones: Sequence[Tone]) -> Table:
    return _table(
        "shaft",
        "The shaft as a continuum",
        "Natural frequencies [Hz] of a steel shaft with both inertias, and of the model's spring.",
        Tone,
        tones,
        lambda t: (
            *(str(t.mode), f"{t.distributed:.7g}"),
            "" if t.lumped is None else f"{t.lumped:.7g}",
        ),
        ("mode", "distributed", "spring"),
    )


def _table_3(nine: Nine) -> Table:
    return _table(
        f"table_3_{nine.name}",
        f"Table 3: nine parameters, record `{nine.name}`",
        "The paper's guess, estimate and deviation; the heuristic's estimate here, its deviation from "
        "the guess, standard deviation over other starts (`starts`) and distance from the truth "
        "(`off`), all three in per cent; and the posterior: median, 94 % HDI of the logarithm, verdict.",
        Line3,
        lines_3(nine),
        lambda n: (
            *(n.parameter, *_digits(n.guess, n.printed), f"{n.printed_percent:g}"),
            *_digits(n.heuristic, n.heuristic_percent, n.starts_percent),
            *(("", "") if n.truth is None else (f"{n.truth:.4g}", f"{n.off_percent:+.3g}")),
            *(f"{n.posterior:.4g}", f"{n.hdi_low:.3g} to {n.hdi_high:.3g}", n.verdict),
        ),
        (
            *("", "guess", "paper", "dev. %", "heuristic", "dev. %", "starts %", "truth"),
            *("off %", "posterior", "94 % HDI", "verdict"),
        ),
    )


def _causes(nine: Nine) -> Table:
    return _table(
        f"products_{nine.name}",
        f"What a record can show, record `{nine.name}`",
        "Products of the parameters over their values at the initial guesses: of Table 3 as printed "
        "and with the digits of its percentages, of the nominal rig with 7e-3 kg m^2 at the output, "
        "with 0.2 ohm in series, with both, with k_T = k_e; and of this record, by heuristic and "
        "posterior (median, 94 % HDI of the logarithm).",
        Cause,
        nine.causes,
        lambda c: (
            *(c.product, *_digits(c.table_3, c.table_3_digits, c.j_2, c.r_s, c.both, c.k_T)),
            *(*_digits(c.heuristic, c.posterior), f"{c.hdi_low:.4g} to {c.hdi_high:.4g}"),
        ),
        (
            *("product", "Table 3", "with digits", "j_2", "r_s", "both", "k_T", "heuristic"),
            *("posterior", "94 % HDI"),
        ),
    )


def _table[T](
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
        csv=records_as_csv(kind, rows, {}, leave),
        markdown=markdown(heads, map(cells, rows)),
    )


def _percent(x: float) -> str:
    return f"{x:.2g}" if x < 99.5 else f"{x:.0f}"


def _digits(*values: float) -> tuple[str, ...]:
    return tuple(f"{value:.4g}" for value in values)


def in_words(found: Findings) -> str:
    """What a reader of the paper wants to know first."""
    said = []
    for line in lines_2(found.verification):
        if line.parameter == "c_m":
            said.append(
                f"Table 2, sigma_n {line.sigma:g}: c_m can be known to "
                f"{_percent(line.bound_percent)} %; the paper reports {line.printed_percent:g} %"
            )
    for nine in found.nines:
        lines = [line for line in lines_3(nine) if line.truth is not None]
        text = f"{nine.name}: the heuristic ends at a misfit of {nine.misfits.heuristic:.3f} per number"
        if lines:
            worst = max(lines, key=lambda line: abs(line.off_percent or 0.0))
            inside = sum(bool(line.holds) for line in lines)
            text += (
                f", {worst.parameter} {worst.off_percent:+.0f} % off; the posterior's 94 % intervals "
                f"hold the truth of {inside} of {len(lines)} parameters"
            )
        said.append(text)
    return "\n".join(said)
