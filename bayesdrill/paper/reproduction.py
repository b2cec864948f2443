"""The files of the paper's reproduction: tables in its order, figures, and a report that shows
them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesdrill import output_files
from bayesdrill.basics import software, symbols
from bayesdrill.paper import printed, study_tables
from bayesdrill.paper.findings import Findings
from bayesdrill.paper.forward import FOLLOWED, Error, Reading
from bayesdrill.paper.plugins import ORDER, circle
from bayesdrill.paper.precision import Implied, Length
from bayesdrill.paper.printed import Inconsistency, Nominal, Tone
from bayesdrill.paper.searches import Verification
from bayesdrill.paper.study_tables import (
    Line2,
    LineLength,
    Table,
    digits,
    grid,
    lengths,
    lines_2,
    lines_3,
    percent,
    table,
)
from bayesdrill.report import (
    Drawing,
    Note,
    Picture,
    Section,
    Sentences,
    as_html,
    as_markdown,
    draw,
    made_of,
    records_as_csv,
)
from bayesdrill.results import Folder
from bayesdrill.sampling import Crew

if TYPE_CHECKING:
    from matplotlib.figure import Figure


ATTAINED = printed.TWO_PARAMETERS[1.0]["c_m"].deviation


def tables(found: Findings) -> tuple[Table, ...]:
    """In the order of the paper."""
    return (
        _table_1(),
        _inconsistencies(),
        _matrix(found.readings),
        _integrator(found.errors),
        _table_2(found.verification),
        _implied(found.implied),
        _lengths(found.lengths),
        *study_tables.tables(found),
        _shaft(found.tones),
    )


def _table_1() -> Table:
    return table(
        "table_1",
        "Table 1: nominal values",
        "As printed, and what is the nominal value here.",
        Nominal,
        printed.table_1(),
        lambda n: (n.parameter, n.unit, *digits(n.printed, n.nominal), n.says),
        ("", "unit", "Table 1", "here", "why"),
    )


def _inconsistencies() -> Table:
    return table(
        "inconsistencies",
        "What the paper says twice",
        "Numbers of the paper that contradict each other, and our reading.",
        Inconsistency,
        printed.inconsistencies(),
        lambda i: (i.what, f"{i.printed:.4g} {i.unit}", f"{i.implied:.3g} {i.unit}", i.says),
        ("what", "printed", "implied", "our reading"),
    )


def _matrix(readings: Sequence[Reading]) -> Table:
    return table(
        "matrix",
        "The printed matrix",
        f"Speed of theta_2 [rad/s] {FOLLOWED:g} s after the step, by the reading of the printed "
        "matrix; the same by the paper's integrator; and where it settles.",
        Reading,
        readings,
        lambda r: (r.matrix, *digits(r.w_2, r.w_2_trapezoid, r.w_end), str(r.steps)),
        ("matrix", f"after {FOLLOWED:g} s", "trapezoidal rule", "in the end", "steps"),
        leave=("t", "curve"),
    )


def _integrator(errors: Sequence[Error]) -> Table:
    return table(
        "integrator",
        "The paper's integrator",
        "Distance of the trapezoidal rule with adaptive steps (relative tolerance 1e-3) from the "
        "exact response, in rad and rad/s.",
        Error,
        errors,
        lambda e: (e.channel, *digits(e.largest, e.rms), str(e.steps)),
        ("channel", "largest", "rms", "steps"),
    )


def _table_2(found: Verification) -> Table:
    """In Markdown two tables: the paper's layout, and what an estimate can attain."""
    lines = lines_2(found)
    layout = grid(
        ("sigma_n", "", *(head for name in found.names for head in (name, "dev. %"))),
        (
            (
                *(f"{sigma:g}" if by == "paper" else "", by),
                *(cell for n in lines if n.sigma == sigma for cell in _estimate(n, by)),
            )
            for sigma in found.sigmas
            for by in ("paper", "fminsearch", "scaled")
        ),
    )
    attained = grid(
        (
            *("sigma_n", "", "Cramer-Rao %", "spread fminsearch %", "spread scaled %"),
            *("posterior sd %", "weights only %", "weights only, ode23t %"),
            *("ode23t, exact record %", "ode23t, own record %"),
        ),
        (
            (
                *(f"{n.sigma:g}", n.parameter, *digits(n.bound_percent)),
                *digits(n.spread_fminsearch_percent, n.spread_scaled_percent),
                *digits(n.posterior_sd_percent, n.weights_only_percent),
                *digits(n.weights_only_trapezoid_percent),
                *digits(n.trapezoid_fit_percent, n.trapezoid_both_percent),
            )
            for n in lines
        ),
    )
    return Table(
        stem="table_2",
        title="Table 2: two parameters",
        says="First the paper's layout: its estimates, and those of one record here. Then, in per cent "
        f"of the true value: Cramer-Rao bound, spread of the estimates over {found.records} records, "
        "standard deviation of the posterior of one; and deviations where sigma is but a weight and the "
        "record has no noise, and with the paper's integrator (of an exact record, of its own).",
        csv=records_as_csv(Line2, lines),
        grids=(layout, attained),
    )


def _estimate(line: Line2, by: str) -> tuple[str, str]:
    """With the power of ten that the paper writes."""
    value, deviation = {
        "paper": (line.printed, line.printed_percent),
        "fminsearch": (line.fminsearch, line.fminsearch_percent),
        "scaled": (line.scaled, line.scaled_percent),
    }[by]
    power = {"c_m": 5, "k_e": 4}[line.parameter]
    return f"{value * 10**power:.1f}e-{power}", percent(deviation)


def _implied(lines: Sequence[Implied]) -> Table:
    return table(
        "implied",
        "Which noise Table 2 has",
        "Deviations of Table 2 in per cent, their ratio, and for each the sigma_n at which it is the "
        "Cramer-Rao bound; then their root mean square, and the bounds at 0.001.",
        Implied,
        lines,
        lambda n: (
            *(n.row, *digits(n.c_m_percent, n.k_e_percent), f"{n.ratio:.3g}"),
            *(f"{n.noise_c_m:.2g}", f"{n.noise_k_e:.2g}"),
        ),
        ("sigma_n", "c_m %", "k_e %", "ratio", "noise by c_m", "noise by k_e"),
    )


def _lengths(found: Sequence[Length]) -> Table:
    return table(
        "lengths",
        "For which record length",
        "Cramer-Rao bounds at sigma_n 0.001 (they grow with sigma_n), and how many such records at "
        f"sigma_n 1 it takes to know c_m to the {ATTAINED:g} % of Table 2.",
        LineLength,
        lengths(found, ATTAINED),
        lambda n: (
            *(f"{n.duration:g}", f"{n.rate:g}"),
            *(*digits(n.c_m_percent, n.k_e_percent), f"{n.repeats:.2g}"),
        ),
        ("duration s", "rate Hz", "c_m % at 0.001", "k_e % at 0.001", "records at 1"),
    )


def _shaft(tones: Sequence[Tone]) -> Table:
    return table(
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


def in_words(found: Findings) -> tuple[str, ...]:
    """What a reader of the paper wants to know first, and what must not be believed."""
    said = []
    for line in lines_2(found.verification):
        if line.parameter == "c_m":
            said.append(
                f"Table 2, sigma_n {line.sigma:g}: c_m can be known to "
                f"{percent(line.bound_percent)} %; the paper reports {line.printed_percent:g} %"
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
        said += [text, *(f"{nine.name}: {doubt}" for doubt in study_tables.doubts(nine))]
    if not found.verification.converged:
        said.append("Table 2: a posterior did not converge: do not use `posterior sd`")
    return tuple(said)


TITLE = "The paper, repeated"
Wanted = tuple[str, str, Callable[..., "Figure"], tuple[Any, ...]]
ITERATIONS = 10  # of each pair, in the paper


def write(found: Findings, folder: Folder, crew: Crew) -> None:
    figures = folder.path / output_files.FIGURES
    figures.mkdir(exist_ok=True)
    note = {"Title": "paper", "Creator": software.creator()}
    wanted = _figures(found)
    tasks = [
        crew.submit(draw, stem, Drawing(figure, arguments), figures, note)
        for stem, _, figure, arguments in wanted
    ]
    made = tables(found)
    for one in made:
        folder.write_text(f"{one.stem}.csv", one.csv)
        folder.write_text(f"{one.stem}.md", f"{one.says}\n\n{one.markdown}")
    for task in tasks:
        task.result()
    said = sections(in_words(found), made, {stem: says for stem, says, *_ in wanted})
    folder.write_text("report.md", as_markdown(TITLE, said))
    every = (*said, made_of((("versions", software.versions_in_words()),), folder.path))
    folder.write_text("report.html", as_html(TITLE, "the paper", every, figures))


def sections(
    first: Sequence[str], made: Sequence[Table], figures: Mapping[str, str]
) -> tuple[Section, ...]:
    """`first`: what is said before all tables."""
    tables = (Section(table.title, (Note(table.says), *table.grids)) for table in made)
    pictures = tuple(Picture(stem, says) for stem, says in figures.items())
    return (
        Section("What comes out", (Sentences("\n".join(first)),)),
        *tables,
        Section("Figures", pictures),
    )


def _paper(name: str) -> float:
    """What Table 3 prints; NaN of what is not in it."""
    return printed.NINE_PARAMETERS[name].value if name in printed.NINE_PARAMETERS else np.nan


def _figures(found: Findings) -> list[Wanted]:
    from bayesdrill.paper import plots
    from bayesdrill.report import heuristic_figure, rig_figure

    heuristics = [(nine.name, nine.heuristic) for nine in found.nines]
    latex = [
        ", ".join(symbols.PARAMETERS[name].latex for name in names) for names in found.symmetries
    ]
    wanted: list[Wanted] = []

    def want(stem: str, says: str, figure: Callable[..., Figure], *arguments: Any) -> None:
        wanted.append((stem, says, figure, arguments))

    want("rig", "The rig.", rig_figure)
    pairs = circle(ORDER)
    want("heuristic", "The heuristic, as in the paper.", heuristic_figure, pairs, ITERATIONS)
    says = "Speed of theta_2 with four readings of the printed matrix."
    want("matrix", says, plots.readings_figure, found.readings)
    says, paper = "Error of the two-parameter estimates against the noise.", printed.TWO_PARAMETERS
    want("table_2", says, plots.verification_figure, found.verification, dict(paper))
    says = "Where searches for all unknowns at once end."
    want("simultaneous", says, plots.simultaneous_figure, found.ends, latex)
    says = "Misfit after each iteration of the heuristic."
    want("convergence", says, plots.convergence_figure, heuristics)
    for nine in found.nines:
        says = f"Record `{nine.name}` and the heuristic's fit."
        want(f"fit_{nine.name}", says, plots.fit_paper_figure, nine.experiment, nine.signals)
        h, estimates = nine.heuristic, np.array([_paper(name) for name in nine.names])
        values = (nine.names, h.guess, h.estimate, h.others, nine.truth, nine.draws, estimates)
        says = f"Record `{nine.name}`: the heuristic's estimates and the posterior."
        want(f"table_3_{nine.name}", says, plots.table_3_figure, *values)
    return wanted
