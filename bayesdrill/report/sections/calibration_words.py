"""What the terminal and the summary say of a calibration."""

from __future__ import annotations

from collections.abc import Sequence

from bayesdrill.analysis.calibration import (
    FALSE_ALARM,
    MAX_NOT_CONVERGED,
    CalibrationVerdict,
    Refit,
)
from bayesdrill.config.schema.config import Config
from bayesdrill.inference.posterior import Problem
from bayesdrill.report.section import (
    Badge,
    Badges,
    Note,
    Picture,
    Section,
    Table,
    Tone,
    build,
    lines_as_csv,
)

MOST_NAMED = 20  # refits that did not converge


def opening(problem: Problem, config: Config) -> str:
    """What is repeated, and how often."""
    records = " and one of ".join(
        f"{len(observation.experiment.t)} samples of {', '.join(observation.experiment.names)}"
        for observation in problem.observations
    )
    return (
        f"calibration: {config.calibration.refits} times, unknowns from their priors, a record of "
        f"{records} made from them, and its "
        f"posterior\nunknown: {', '.join(problem.names)}"
    )


def verdict(verdict: CalibrationVerdict) -> str:
    """One sentence."""
    if verdict.faults:
        return f"not calibrated: {'; '.join(verdict.faults)}"
    if verdict.doubts:
        return f"no verdict: {'; '.join(verdict.doubts)}"
    return (
        f"calibrated: over {verdict.refits} refits the truth ranks among the draws as chance has it"
    )


def rule(verdict: CalibrationVerdict) -> str:
    """What the verdict is worth."""
    return (
        f"A right posterior would be found not calibrated in at most {100 * FALSE_ALARM:g} % of such "
        f"studies, all {len(verdict.quantities)} quantities and all intervals taken together. With more "
        f"than {100 * MAX_NOT_CONVERGED:g} % of the refits not converged nothing is called calibrated; "
        "they stay in the ranks."
    )


def refits(verdict: CalibrationVerdict, every: Sequence[Refit]) -> str:
    """How many went wrong, which, and how."""
    if not verdict.not_converged:
        return f"all {verdict.refits} refits converged"
    first = next(refit for refit in every if not refit.converged)
    listed = ", ".join(map(str, verdict.not_converged[:MOST_NAMED]))
    more = ", ..." if len(verdict.not_converged) > MOST_NAMED else ""
    return (
        f"{len(verdict.not_converged)} of {verdict.refits} refits did not converge: {listed}{more}\n"
        f"  refit {first.index}: {first.reasons[0]}"
    )


def sections(
    judged: CalibrationVerdict, every: Sequence[Refit], ending: str
) -> tuple[Section, ...]:
    """The verdict first; `ending`: of the file of the figure that a page shows."""
    says = verdict(judged)
    tone: Tone = "bad" if judged.faults else "doubt" if judged.doubts else "good"
    marks = Badges((Badge(says.split(":")[0], tone),))
    read = Note(
        f"Ranks are among {judged.n_draws} draws. `departure / band` is the farthest departure of their "
        "distribution from uniform, above 1 outside of what chance allows; the same for intervals in "
        "brackets. Exact values: `ranks.csv`."
    )
    seen = "Ranks of the truths among the draws, with what chance allows."
    return (
        build("Verdict", marks, f"{says[0].upper()}{says[1:]}.", Note(rule(judged))),
        build("Ranks", table(judged), read, Picture("calibration", seen, ending)),
        build("Refits", refits(judged, every)),
    )


def table(verdict: CalibrationVerdict) -> Table:
    """The shares of truths in credible intervals with what chance allows."""
    shares = [f"in {100 * i.share:.3g} % interval" for i in verdict.quantities[0].intervals]
    n, lines = max(verdict.band.n, 1), []
    for q in verdict.quantities:
        word = "as by chance" if q.holds else q.shape or "leave the band"
        covered = [
            f"{100 * i.inside / n:.0f} % ({100 * i.low / n:.0f} to {100 * i.high / n:.0f})"
            + ("" if i.holds else " **outside**")
            for i in q.intervals
        ]
        known = (q.name, f"{q.reach:.2f}", word if verdict.band.n else "none")
        lines.append((*known, *(covered or [""] * len(shares))))
    heads = ("", "departure / band", "ranks", *shares)
    return Table(heads, tuple(lines), frozenset(("", "ranks")))


def ranks_csv(names: Sequence[str], refits: Sequence[Refit]) -> str:
    """A line for each refit: all digits, SI; nothing that depends on when or where it ran."""
    keys = [name.replace(" ", "_") for name in names]
    heads = ["refit", "converged", "r_hat", "ess", "steps"]
    heads += [f"{what}_{key}" for what in ("true", "rank") for key in keys]
    lines: list[Sequence[object]] = [heads]
    for refit in refits:
        first = (refit.index, int(refit.converged), refit.r_hat, refit.ess, refit.steps)
        lines.append([*first, *refit.truth, *(refit.ranks or [None] * len(names))])
    return lines_as_csv(lines)
