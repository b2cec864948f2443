"""Tables of the paper's nine-parameter studies: searches, misfits, Table 3, and its quantities."""

from __future__ import annotations

from collections.abc import Sequence

from bayesdrill.paper.pages.cells import Table, digits, grid, percent, table
from bayesdrill.paper.pages.lines import Line3, Said, Way, lines_3, said, ways
from bayesdrill.paper.studies import causes, simultaneous
from bayesdrill.paper.studies.causes import Cause
from bayesdrill.paper.studies.control import Control
from bayesdrill.paper.studies.findings import Findings, Misfits, Nine
from bayesdrill.report import records_as_csv


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
        f"Searches of `{found.searched}` from starts within {100 * simultaneous.WITHIN:.0f} % of the "
        "guesses: how many leave no more than noise, how many are as good as the best (within "
        f"{simultaneous.SAME:g} of its misfit), how many stopped by themselves. How those that are as "
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
        csv=records_as_csv(Control, lines, {}),
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
        csv=records_as_csv(Line3, lines, {}),
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
        f"printed, and with the digits of its percentages; of the nominal rig with j_2 = {causes.J_2:g} "
        f"kg m^2 at the output, with r_s = {causes.R_S:g} ohm in series, with both; and with k_T = k_e. "
        "Then those of this record, by heuristic and posterior (median, 94 % HDI of the logarithm); "
        "`alone`: the Cramer-Rao bound of the standard deviation without any prior, in per cent. Empty "
        "where the config gives the quantity.",
        csv=records_as_csv(Cause, nine.causes, {}),
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
